from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flight_log.reader import FlightError, open_flight
from flight_log.schema import CLOCK_OFFSET, RecordType
from flight_log.writer import FlightLogWriter

TICK = RecordType("onboard/tick", (("position_n", "m"), ("weight_norm", "")))
TRUTH = RecordType("sim_vehicle/truth", (("position_n", "m"),))
PERIOD_NS = 5_000_000


def write_flight(folder: Path, records: int = 400, *, skip: range = range(0), lockstep: bool = True) -> None:
    with FlightLogWriter(folder / "onboard.mcap", "onboard", {"clock": "a"}, threaded=not lockstep) as log:
        for i in range(records):
            if i not in skip:
                log.write(TICK, 10**9 + i * PERIOD_NS, np.array([i, 2.0]))
        log.event(10**9 + 7, "armed")
        log.write_bytes("onboard/received", 10**9, b"abc")
    with FlightLogWriter(folder / "sim_vehicle.mcap", "sim_vehicle", {"clock": "a"}, threaded=False) as log:
        log.write(TRUTH, 10**9 - 5, np.array([0.25]))
        log.event(10**9 + 3, "rotor chip")


def test_a_flight_has_columns_units_events_and_bytes(tmp_path: Path) -> None:
    write_flight(tmp_path)
    (tmp_path / "summary.json").write_text('{"survived": true}', encoding="utf-8")
    flight = open_flight(tmp_path)
    tick = flight["onboard/tick"]
    assert flight.topics == ("onboard/tick", "sim_vehicle/truth")
    assert flight.processes == ("onboard", "sim_vehicle")
    assert (len(tick), tick.units) == (400, {"position_n": "m", "weight_norm": ""})
    np.testing.assert_array_equal(tick["position_n"], np.arange(400.0))
    np.testing.assert_array_equal(tick.columns["weight_norm"], np.full(400, 2.0))
    np.testing.assert_array_equal(tick.vector("weight_norm", "position_n")[3], [2.0, 3.0])
    np.testing.assert_allclose(tick.seconds(flight.start_ns)[:2], [0.0, 0.005], rtol=1e-12)
    assert (flight.start_ns, flight.first_ns) == (10**9, 10**9 - 5)
    assert [(event.process, event.text) for event in flight.events] == [
        ("sim_vehicle", "rotor chip"),
        ("onboard", "armed"),
    ]
    assert flight.messages("onboard/received") == [(10**9, b"abc")]
    assert flight.summary == {"survived": True}
    assert (flight.faults, flight.gaps) == ((), ())
    assert flight.duration_s == pytest.approx(399 * 0.005, abs=1e-6)


def test_unknown_topics_and_columns_raise_and_list_the_known_ones(tmp_path: Path) -> None:
    write_flight(tmp_path)
    flight = open_flight(tmp_path)
    with pytest.raises(KeyError, match="it has onboard/tick, sim_vehicle/truth"):
        flight["onboard/tock"]
    with pytest.raises(KeyError, match="it has position_n, weight_norm"):
        flight["onboard/tick"]["position_x"]
    with pytest.raises(KeyError, match="it has onboard/received"):
        flight.messages("x")
    assert flight.get("x") is None
    assert "position_n" in flight["onboard/tick"]


def test_a_log_truncated_anywhere_is_read_up_to_the_cut(tmp_path: Path) -> None:
    write_flight(tmp_path)
    file = tmp_path / "onboard.mcap"
    whole, seen = file.read_bytes(), []
    for end in range(0, len(whole), 997):
        file.write_bytes(whole[:end])
        flight = open_flight(tmp_path)
        tick = flight.get("onboard/tick")
        rows = 0 if tick is None else len(tick)
        seen.append(rows)
        if tick is not None:
            np.testing.assert_array_equal(tick["position_n"], np.arange(float(rows)))
        assert any("onboard.mcap: " in fault for fault in flight.faults)
    assert seen == sorted(seen)
    assert seen[0] == 0
    assert seen[-1] == 400


@settings(max_examples=150, deadline=None)
@given(place=st.floats(0, 1, exclude_max=True), value=st.integers(0, 255))
def test_a_damaged_byte_is_reported_as_a_fault_and_raises_nothing_else(
    tmp_path_factory: pytest.TempPathFactory, place: float, value: int
) -> None:
    folder = tmp_path_factory.mktemp("flight")
    write_flight(folder, records=80)
    file = folder / "onboard.mcap"
    data = bytearray(file.read_bytes())
    data[int(place * len(data))] = value
    file.write_bytes(bytes(data))
    try:
        flight = open_flight(folder)
    except FlightError:
        return
    values = {topic: flight[topic].values for topic in flight.topics}
    assert all(np.isfinite(table).all() for table in values.values())


def test_a_gap_is_reported_with_its_times(tmp_path: Path) -> None:
    write_flight(tmp_path, skip=range(100, 140))
    [gap] = open_flight(tmp_path).gaps
    assert gap.describe(10**9) == "onboard/tick: silent from 0.495 s to 0.700 s"


def test_a_missed_tick_is_not_a_gap(tmp_path: Path) -> None:
    write_flight(tmp_path, skip=range(100, 108))
    assert open_flight(tmp_path).gaps == ()


DRIFT_NS = 20_000
"""Drift of offboard's clock against onboard's, per second."""


def two_clocks(folder: Path, aheads: tuple[int, ...], *, measured: bool) -> None:
    """One mark per second from each process, at the same true times.

    aheads: ns by which offboard's clock is ahead; of two, offboard comes back on a second machine half-way.
    """
    summary = {"started_utc": "2026-01-01T00:00:00+00:00"}
    logs = [FlightLogWriter(folder / "onboard.mcap", "onboard", summary | {"clock": "a", "started_monotonic_ns": "0"})]
    for ahead in aheads:
        about = summary | {"clock": str(ahead), "started_monotonic_ns": str(ahead)}
        logs.append(FlightLogWriter(folder / "offboard.mcap", "offboard", about))
    for second in range(100):
        run = second * len(aheads) // 100
        own_ns, offset_ns = second * 10**9, aheads[run] + second * DRIFT_NS
        marks = (RecordType("onboard/mark", (("x", ""),)), RecordType("offboard/mark", (("x", ""),)))
        logs[0].write(marks[0], own_ns, np.array([float(second)]))
        logs[1 + run].write(marks[1], own_ns + offset_ns, np.array([float(second)]))
        if measured:
            logs[0].write(CLOCK_OFFSET, own_ns, np.array([offset_ns, 400_000.0]))
    for log in logs:
        log.close()


@pytest.mark.parametrize(
    ("aheads", "measured", "tolerance_ns", "faults"),
    [
        ((7 * 10**9,), True, 10, 0),
        ((7 * 10**9, 10**12), True, 10, 0),
        ((10**12, 7 * 10**9), True, 10, 0),
        ((7 * 10**9,), False, 3_000_000, 1),
    ],
)
def test_times_of_two_machines_are_mapped_to_one_clock(
    tmp_path: Path, aheads: tuple[int, ...], measured: bool, tolerance_ns: int, faults: int
) -> None:
    two_clocks(tmp_path, aheads, measured=measured)
    flight = open_flight(tmp_path)
    difference = flight["offboard/mark"].time_ns - flight["onboard/mark"].time_ns
    assert np.abs(difference).max() <= tolerance_ns
    assert np.diff(flight["offboard/mark"].time_ns).min() > 0
    assert len(flight.faults) == faults


def test_a_summary_that_is_not_json_raises_with_its_name(tmp_path: Path) -> None:
    write_flight(tmp_path)
    (tmp_path / "summary.json").write_text("{", encoding="utf-8")
    with pytest.raises(FlightError, match=r"summary\.json: not a flight summary"):
        _ = open_flight(tmp_path).summary
