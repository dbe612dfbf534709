import csv
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from pyulog import ULog

from flight_log.export import export_csv, export_npz, merge
from flight_log.inspect import as_json, check, columns, describe
from flight_log.reader import FlightError, open_flight
from flight_log.ulog import write_ulog
from flight_log.writer import FlightLogWriter


def test_csv_holds_columns_units_and_events(flight_folder: Path, tmp_path: Path) -> None:
    written = export_csv(open_flight(flight_folder), tmp_path / "csv")
    assert [path.name for path in written] == ["onboard_tick.csv", "sim_vehicle_truth.csv", "events.csv"]
    with written[0].open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["time [s]", "position_n [m]", "position_e [m]", "position_d [m]", "mode [FlightMode, a number]"]
    assert len(rows) == 1001
    assert rows[3] == ["0.010000", "0.2", "-1e-07", "nan", "4"]
    with written[2].open(encoding="utf-8", newline="") as file:
        assert list(csv.reader(file))[1] == ["1.000000", "onboard", 'took off, "well"']


def test_npz_holds_columns_units_and_events(flight_folder: Path, tmp_path: Path) -> None:
    flight = open_flight(flight_folder)
    export_npz(flight, tmp_path / "flight.npz")
    with np.load(tmp_path / "flight.npz") as arrays:
        np.testing.assert_array_equal(arrays["onboard/tick.position_n"], flight["onboard/tick"]["position_n"])
        np.testing.assert_array_equal(arrays["onboard/tick.time_ns"], flight["onboard/tick"].time_ns)
        assert arrays["start_ns"] == flight.start_ns
        assert arrays["onboard/tick.units"].tolist() == ["m", "m", "m", "FlightMode, a number"]
        assert arrays["events.text"].tolist() == ['onboard: took off, "well"', "sim_vehicle: rotor chip"]


def test_pyulog_reads_the_ulog(flight_folder: Path, tmp_path: Path) -> None:
    flight = open_flight(flight_folder)
    write_ulog(flight, tmp_path / "flight.ulg")
    ulog = ULog(str(tmp_path / "flight.ulg"))
    assert not ulog.file_corruption
    tick = ulog.get_dataset("onboard_tick").data
    np.testing.assert_allclose(tick["position_n"], flight["onboard/tick"]["position_n"], rtol=1e-6)
    assert (tick["timestamp"][0], tick["timestamp"][-1]) == (1_000_000, 1_000_000 + 999 * 5000)
    assert len(ulog.get_dataset("sim_vehicle_truth").data["position_d"]) == 500
    assert [(message.timestamp, message.message) for message in ulog.logged_messages] == [
        (2_000_000, 'onboard: took off, "well"'),
        (3_000_000, "sim_vehicle: rotor chip"),
    ]
    assert ulog.msg_info_dict["onboard_seed"] == "3"


def test_records_before_the_first_tick_have_negative_times(flight_folder: Path, tmp_path: Path) -> None:
    with FlightLogWriter(flight_folder / "offboard.mcap", "offboard", {"clock": "a"}, threaded=False) as log:
        log.event(10**9 - 700_000_000, "early")
    flight = open_flight(flight_folder)
    assert flight.duration_s == pytest.approx(4.995)
    text = "\n".join(describe(flight))
    assert "t = 0 is onboard's first tick; the first record of any process is 0.700 s earlier" in text
    assert "  -0.700 s  offboard: early" in text
    export_csv(flight, tmp_path)
    assert "-0.700000,offboard" in (tmp_path / "events.csv").read_text(encoding="utf-8")
    write_ulog(flight, tmp_path / "flight.ulg")
    ulog = ULog(str(tmp_path / "flight.ulg"))
    assert ulog.msg_info_dict["time_zero_us"] == "2000000"
    assert ulog.logged_messages[0].timestamp == 1_300_000
    assert ulog.get_dataset("onboard_tick").data["timestamp"][0] == 2_000_000


def test_merged_logs_are_one_flight(flight_folder: Path) -> None:
    flight = open_flight(flight_folder)
    target = flight_folder / "merged.mcap"
    merge(flight, target)
    merged = open_flight(target)
    assert merged.topics == flight.topics
    for topic in flight.topics:
        np.testing.assert_array_equal(merged[topic].values, flight[topic].values)
        np.testing.assert_array_equal(merged[topic].time_ns, flight[topic].time_ns)
        assert merged[topic].units == flight[topic].units
    assert merged.messages("onboard/received") == flight.messages("onboard/received")
    assert [event.text for event in merged.events] == [event.text for event in flight.events]
    assert check(merged) == []
    assert merged.attachments["merged"] == {"onboard/config.yaml": b"a: 1\n"}
    with target.open("rb") as file:
        times = [message.log_time for _, _, message in make_reader(file).iter_messages()]
    assert len(times) == 1512
    with pytest.raises(FlightError, match="exists already"):
        merge(flight, target)


def test_a_merged_copy_next_to_its_sources_is_not_counted_twice(flight_folder: Path) -> None:
    merge(open_flight(flight_folder), flight_folder / "merged.mcap")
    flight = open_flight(flight_folder)
    assert len(flight["onboard/tick"]) == 1000
    assert flight.processes == ("onboard", "sim_vehicle")


def test_describe_lists_logs_topics_and_events(flight_folder: Path) -> None:
    flight = open_flight(flight_folder)
    text = "\n".join(describe(flight))
    for part in ("5.0 s, onboard, sim_vehicle", "onboard/tick", "200.0 Hz", "1.000 s  onboard: took off", "complete"):
        assert part in text
    assert "sim_vehicle/truth.position_n  m" in columns(flight)
    found = json.loads(as_json(flight))
    assert found["topics"]["onboard/tick"]["records"] == 1000
    assert found["faults"] == []


def test_check_names_every_fault(flight_folder: Path) -> None:
    log = flight_folder / "onboard.mcap"
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    flight = open_flight(flight_folder)
    end_s = flight["onboard/tick"].seconds(flight.start_ns)[-1]
    assert 0.3 < end_s < 4.0
    assert check(flight) == [f"onboard.mcap: not closed (killed, still flying, or disk full); read up to {end_s:.3f} s"]
