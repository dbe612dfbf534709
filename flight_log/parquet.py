"""Writes a flight's tables as Parquet files, for pandas, polars and others."""

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from flight_log.export import file_stem
from flight_log.reader import Flight, Table


def export_parquet(flight: Flight, folder: Path) -> list[Path]:
    """Write one file per topic, such as `onboard_tick.parquet`, and `events.parquet`; returns their paths.

    Columns: `time_s` since the flight's t = 0, `time_ns` on the flight's clock, and the topic's own. Each field's
    metadata has its `unit`. Raises OSError.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for table in flight:
        path = folder / f"{file_stem(table.topic)}.parquet"
        pq.write_table(as_arrow(table, flight.start_ns), path)
        written.append(path)
    events = pa.table(
        {
            "time_s": [(event.time_ns - flight.start_ns) * 1e-9 for event in flight.events],
            "process": [event.process for event in flight.events],
            "event": [event.text for event in flight.events],
        },
        schema=pa.schema([("time_s", pa.float64()), ("process", pa.string()), ("event", pa.string())]),
    )
    pq.write_table(events, folder / "events.parquet")
    return [*written, folder / "events.parquet"]


def as_arrow(table: Table, start_ns: int) -> pa.Table:
    """The table of a topic with its units."""
    fields = [pa.field("time_s", pa.float64(), metadata={"unit": "s"})]
    fields.append(pa.field("time_ns", pa.int64(), metadata={"unit": "ns"}))
    fields += [pa.field(name, pa.float64(), metadata={"unit": unit}) for name, unit in table.units.items()]
    columns = [table.seconds(start_ns), table.time_ns, *table.columns.values()]
    return pa.table(columns, schema=pa.schema(fields, metadata={"topic": table.topic}))
