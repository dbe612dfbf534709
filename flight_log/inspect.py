"""The content of a flight's logs, and their faults, as lines of text."""

import json

from flight_log.reader import TICK_TOPIC, Flight

EVENTS_SHOWN_MAX = 30


def describe(flight: Flight) -> list[str]:
    """The logs, topics and first events of a flight, as lines."""
    lines = [f"{flight.path}: {flight.duration_s:.1f} s, {', '.join(flight.processes)}", _zero(flight), "", "logs"]
    for log in flight.logs:
        state = "complete" if log.complete else "not closed"
        size = log.path.stat().st_size / 1e6
        version = log.metadata.get("async-dmrac", "?")
        clock, attached = log.metadata.get("clock", "?"), ", ".join(log.attachments) or "nothing"
        lines.append(
            f"  {log.path.name:<20} {size:8.1f} MB  {log.record_count:>8} records  {state}; "
            f"version {version}, clock {clock}, attached {attached}"
        )
    lines += ["", "topics"]
    for table in flight:
        span_s = (table.time_ns[-1] - table.time_ns[0]) * 1e-9
        rate = f"{(len(table) - 1) / span_s:7.1f} Hz" if span_s > 0 else "         "
        lines.append(f"  {table.topic:<28} {len(table):>8} records  {rate}  {len(table.names)} columns")
    for topic in flight.byte_topics:
        lines.append(f"  {topic:<28} {len(flight.messages(topic)):>8} messages of bytes")
    lines += ["", f"events ({len(flight.events)})"]
    for event in flight.events[:EVENTS_SHOWN_MAX]:
        lines.append(f"  {(event.time_ns - flight.start_ns) * 1e-9:8.3f} s  {event.process}: {event.text}")
    if len(flight.events) > EVENTS_SHOWN_MAX:
        lines.append(f"  ... and {len(flight.events) - EVENTS_SHOWN_MAX} more")
    return lines


def _zero(flight: Flight) -> str:
    """A line that states what t = 0 is."""
    before_s = (flight.start_ns - flight.first_ns) * 1e-9
    what = "onboard's first tick" if TICK_TOPIC in flight else "the first record (no tick of onboard was logged)"
    earlier = f"; the first record of any process is {before_s:.3f} s earlier" if before_s > 0 else ""
    return f"t = 0 is {what}{earlier}"


def columns(flight: Flight) -> list[str]:
    """Every column with its unit, as lines."""
    return [f"{table.topic}.{name}  {unit}".rstrip() for table in flight for name, unit in table.units.items()]


def check(flight: Flight) -> list[str]:
    """The faults and gaps of a flight's logs, one line each."""
    return [*flight.faults, *(gap.describe(flight.start_ns) for gap in flight.gaps)]


def as_json(flight: Flight) -> str:
    """Topics, columns, events, metadata and faults as JSON."""
    return json.dumps(
        {
            "path": str(flight.path),
            "duration_s": flight.duration_s,
            "topics": {table.topic: {"records": len(table), "columns": table.units} for table in flight},
            "events": [
                {"time_s": (event.time_ns - flight.start_ns) * 1e-9, "process": event.process, "text": event.text}
                for event in flight.events
            ],
            "metadata": flight.metadata,
            "faults": check(flight),
        },
        indent=2,
    )
