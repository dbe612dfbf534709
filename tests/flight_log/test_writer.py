import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from flight_log import mcap_file, writer
from flight_log.export import merge
from flight_log.reader import Table, open_flight
from flight_log.schema import RecordType, vector_fields
from flight_log.writer import FLUSH_PERIOD_NS, RING_ROWS, FlightLogWriter

TICK = RecordType("onboard/tick", (*vector_fields("position", "ned", "m"), ("weight_norm", "")))
PERIOD_NS = 5_000_000


def vector(i: int) -> np.ndarray:
    return np.array([i, -i, 0.5 * i, 1.0])


def test_the_mcap_library_reads_every_message_of_a_merged_log(tmp_path: Path) -> None:
    with FlightLogWriter(tmp_path / "own.mcap", "onboard", {"seed": "7"}, {"config.yaml": b"a: 1\n"}) as log:
        for i in range(300):
            log.write(TICK, i * PERIOD_NS, vector(i))
        log.event(17, "armed")
        log.write_bytes("onboard/received", 18, b"\x01\x02")
    merge(open_flight(tmp_path / "own.mcap"), tmp_path / "all.mcap")
    with (tmp_path / "all.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 302
        messages = list(reader.iter_messages(topics=["onboard/tick"]))
        assert [message.log_time for _, _, message in messages] == [i * PERIOD_NS for i in range(300)]
        assert [message.sequence for _, _, message in messages] == list(range(300))
        schema, channel, message = messages[10]
        assert schema is not None
        assert (schema.name, schema.encoding) == ("async_dmrac/msg/OnboardTick", "ros2msg")
        assert schema.data.decode().splitlines()[0] == "float64 position_n # m"
        assert channel.message_encoding == "cdr"
        assert message.data == b"\x00\x01\x00\x00" + vector(10).tobytes()
        [attachment] = reader.iter_attachments()
        assert (attachment.name, attachment.data) == ("onboard/config.yaml", b"a: 1\n")
        [metadata] = reader.iter_metadata()
        assert metadata.metadata["onboard.seed"] == "7"
        late = list(reader.iter_messages(topics=["onboard/tick"], starting_at=299 * PERIOD_NS))
        assert len(late) == 1


def test_records_come_back_from_the_lockstep_writer(tmp_path: Path) -> None:
    count = 3 * RING_ROWS
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False) as log:
        for i in range(count):
            log.write(TICK, i * PERIOD_NS, vector(i))
        assert log.dropped == 0
    flight = open_flight(tmp_path)
    np.testing.assert_array_equal(flight["onboard/tick"].values, [vector(i) for i in range(count)])
    assert flight.faults == ()
    assert flight.gaps == ()


def test_lockstep_records_reach_the_file_within_the_flush_period(tmp_path: Path) -> None:
    log = FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False)
    for i in range(1000):
        log.write(TICK, i * PERIOD_NS, vector(i))
    on_disk = open_flight(tmp_path)["onboard/tick"]
    assert 999 * PERIOD_NS - on_disk.time_ns[-1] <= FLUSH_PERIOD_NS
    log.close()


LOGGING_PROCESS = """
import sys, time
from pathlib import Path
import numpy as np
from flight_log.schema import RecordType
from flight_log.writer import FlightLogWriter
log = FlightLogWriter(Path(sys.argv[1]), "onboard")
kind = RecordType("onboard/tick", (("written_ns", "ns"),))
print("ready", flush=True)
while True:
    now = time.monotonic_ns()
    log.write(kind, now, np.array([float(now)]))
    time.sleep(0.005)
"""


def test_a_killed_process_loses_little(tmp_path: Path) -> None:
    command = [sys.executable, "-c", LOGGING_PROCESS, str(tmp_path / "onboard.mcap")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    with process, process.stdout:
        process.stdout.readline()
        time.sleep(1.5)
        killed_ns = time.monotonic_ns()
        process.send_signal(signal.SIGKILL)
    flight = open_flight(tmp_path)
    tick = flight["onboard/tick"]
    assert killed_ns - tick.time_ns[-1] < 700_000_000
    assert tick.time_ns[-1] - tick.time_ns[0] > 700_000_000
    [fault] = flight.faults
    assert fault == f"onboard.mcap: not closed (killed, still flying, or disk full); read up to {seconds(tick)} s"


def seconds(tick: Table) -> str:
    return f"{(tick.time_ns[-1] - tick.time_ns[0]) * 1e-9:.3f}"


FULL_DISK_PROCESS = """
import resource, sys
from pathlib import Path
import numpy as np
from flight_log.schema import RecordType
from flight_log.writer import FlightLogWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), int(sys.argv[2])))
log = FlightLogWriter(Path(sys.argv[1]), "onboard", threaded=sys.argv[3] == "True")
kind = RecordType("onboard/tick", (("i", ""),))
for i in range(8000):
    log.write(kind, i * 5_000_000, np.array([float(i)]))
    if i % 500 == 0 and sys.argv[3] == "True":
        log._wake.set(); import time; time.sleep(0.01)
log.close()
log.write(kind, 1, np.array([1.0]))
print("flew on:", log.failure)
"""


@pytest.mark.parametrize(("limit", "threaded"), [(100, True), (8_000, True), (8_000, False)])
def test_a_full_disk_stops_the_log_and_not_the_flight(tmp_path: Path, limit: int, threaded: bool) -> None:
    command = [sys.executable, "-c", FULL_DISK_PROCESS, str(tmp_path / "onboard.mcap"), str(limit), str(threaded)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stdout == "flew on: File too large\n"
    [line] = result.stderr.splitlines()
    assert re.match(
        r"the flight log stopped after \d+\.\d s, the flight goes on: .*/onboard\.mcap: File too large", line
    )
    assert (tmp_path / "onboard.mcap").stat().st_size <= limit
    if limit > 1000:
        flight = open_flight(tmp_path)
        assert len(flight["onboard/tick"]) > 100
        assert flight.logs[0].damage == ""
        after_s = (flight["onboard/tick"].time_ns[-1] - flight["onboard/tick"].time_ns[0]) * 1e-9
        assert f"stopped after {after_s:.1f} s" in line


def test_a_slow_disk_drops_records_counts_and_reports_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stuck = threading.Event()
    real_write = os.write

    def slow_write(descriptor: int, data: bytes) -> int:
        stuck.wait(10)
        return real_write(descriptor, data)

    log = FlightLogWriter(tmp_path / "onboard.mcap", "onboard")
    monkeypatch.setattr(mcap_file.os, "write", slow_write)
    log.write(TICK, 0, vector(0))
    log._wake.set()
    time.sleep(0.2)
    for i in range(1, RING_ROWS + 101):
        log.write(TICK, i * PERIOD_NS, vector(i))
    assert log.dropped == 100
    stuck.set()
    log._wake.set()
    time.sleep(0.2)
    log.write(TICK, (RING_ROWS + 101) * PERIOD_NS, vector(0))
    log.close()
    assert log.failure == ""
    flight = open_flight(tmp_path)
    assert [event.text for event in flight.events] == [
        "flight log: 100 records of onboard/tick lost, the disk was too slow"
    ]
    [gap] = flight.gaps
    assert (gap.topic, gap.lost) == ("onboard/tick", 100)
    assert gap.describe(0) == "onboard/tick: 100 records lost from 5.120 s to 5.625 s"


def test_an_error_in_the_log_does_not_affect_the_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    log = FlightLogWriter(tmp_path / "onboard.mcap", "onboard", threaded=False, on_failure=messages.append)
    monkeypatch.setattr(writer, "vector_block", lambda *_: 1 / 0)
    log.write(TICK, 0, vector(0))
    log.write(TICK, PERIOD_NS, vector(0))
    log.close()
    assert log.failure == "ZeroDivisionError: division by zero"
    assert len(messages) == 1


def test_a_vector_of_wrong_length_raises(tmp_path: Path) -> None:
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard") as log, pytest.raises(ValueError, match="broadcast"):
        log.write(TICK, 0, np.zeros(3))


def test_a_restarted_process_keeps_its_earlier_log(tmp_path: Path) -> None:
    for run in range(2):
        with FlightLogWriter(tmp_path / "offboard.mcap", "offboard") as log:
            log.write(TICK, run, vector(run))
    flight = open_flight(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["offboard.mcap", "offboard_2.mcap"]
    np.testing.assert_array_equal(flight["onboard/tick"]["position_n"], [0.0, 1.0])


def test_unusual_times_and_texts_are_accepted(tmp_path: Path) -> None:
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard") as log:
        log.write(TICK, -5, np.full(4, np.nan))
        log.event(-1, "Γ ⋅ \ud800 #\n")
    flight = open_flight(tmp_path)
    assert flight["onboard/tick"].time_ns.tolist() == [0]
    assert flight.events[0].text == "Γ ⋅ ? #\n"


def test_topics_declared_while_the_thread_writes_are_all_logged(tmp_path: Path) -> None:
    with FlightLogWriter(tmp_path / "onboard.mcap", "onboard") as log:
        for i in range(60):
            log.write(RecordType(f"onboard/topic_{i}", (("x", "m"),)), i, np.array([float(i)]))
            log._wake.set()
            time.sleep(0.001)
    flight = open_flight(tmp_path)
    assert len(flight.topics) == 60
    assert all(flight[f"onboard/topic_{i}"]["x"].tolist() == [float(i)] for i in range(60))


def test_only_the_owner_can_read_a_log(tmp_path: Path) -> None:
    path = tmp_path / "onboard.mcap"
    before = os.umask(0o022)
    try:
        FlightLogWriter(path, "onboard", {}, {}).close()
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o600
