"""Recordings of the motions, made through the library: each mistake of the firmware's sensors is found and named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.command_line import main
from configs.loader import ConfigError
from flight_log.reader import open_flight
from mambo.board import board_config
from mambo.build import Built
from mambo.check import MOTORS, Fault, faults_of, motor_faults, require_certificate, write_certificate
from mambo.fake.wire import Sensors
from mambo.recording import Recording, in_body_axes, read_recording
from mambo.recording_log import write_flight_log
from tests.mambo.motions import record

Spoiled = Callable[[Sensors], Sensors]


@pytest.fixture(scope="module")
def good_file(native: Built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(native, tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def good(good_file: Path) -> Recording:
    return read_recording(good_file)


def changed(recording: Recording, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    """The recording with a field of all samples changed, as another firmware would give it."""
    values = recording.samples.values.copy()
    values[name] = change(values[name])
    return recording._replace(samples=recording.samples._replace(values=values))


def faults(recording: Recording, *assignments: str) -> list[Fault]:
    return faults_of(recording, board_config(assignments=assignments))


def turned_over(axis: int) -> Callable[[np.ndarray], np.ndarray]:
    def change(values: np.ndarray) -> np.ndarray:
        values = values.copy()
        values[..., axis] *= -1
        return values

    return change


def test_a_good_vehicle_passes(good: Recording) -> None:
    assert faults(good) == []
    assert len(good.samples.time_s) >= 14_390  # the last ones wait for the thread that writes
    assert len(good.whole) == 360
    assert len(good.whole[0]) == 2432


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_a_wrong_sign_is_found_and_its_setting_corrects_it(good: Recording, sensor: str, axis: int) -> None:
    wrong = good
    for name in (sensor, f"fifo_{sensor}"):
        wrong = changed(wrong, name, turned_over(axis))
    found = faults(wrong)
    assert any(fault.what == sensor and f"body {'xyz'[axis]}" in fault.text for fault in found), found
    axes = [1, 2, 3]
    axes[axis] *= -1
    assert faults(wrong, f"sensors.{sensor}_axes={axes}") == []


@pytest.mark.parametrize("sensor", ["accelerometer", "gyroscope"])
def test_swapped_axes_are_found(good: Recording, sensor: str) -> None:
    wrong = good
    for name in (sensor, f"fifo_{sensor}"):
        wrong = changed(wrong, name, lambda values: values[..., [1, 0, 2]])
    assert any(fault.what == sensor for fault in faults(wrong))
    assert faults(wrong, f"sensors.{sensor}_axes=[2, 1, 3]") == []


@pytest.mark.parametrize(
    ("sensor", "factor", "setting"),
    [
        ("accelerometer", 1 / 9.80665, "accelerometer_scale=9.80665"),
        ("gyroscope", 57.2958, "gyroscope_scale=0.0174533"),
        ("pressure", 0.01, "pressure_scale=100.0"),
        ("altitude", 100.0, "altitude_scale=0.01"),
    ],
)
def test_a_wrong_unit_is_found(good: Recording, sensor: str, factor: float, setting: str) -> None:
    wrong = changed(good, sensor, lambda values: values * np.float32(factor))
    if sensor in ("accelerometer", "gyroscope"):
        wrong = changed(wrong, f"fifo_{sensor}", lambda values: values * np.float32(factor))
    assert any(fault.what == sensor for fault in faults(wrong))
    assert faults(wrong, f"sensors.{setting}") == []


@pytest.mark.parametrize("sensor", ["altitude", "pressure"])
def test_a_stuck_sensor_is_found(good: Recording, sensor: str) -> None:
    found = faults(changed(good, sensor, lambda values: np.full_like(values, values[0])))
    assert any(fault.what == sensor and "never changes" in fault.text for fault in found)


def test_a_stuck_axis_is_found(good: Recording) -> None:
    wrong = good
    for name in ("gyroscope", "fifo_gyroscope"):
        wrong = changed(wrong, name, lambda values: values * np.array([1, 0, 1], np.float32))
    assert any("gyroscope y never changes" in fault.text for fault in faults(wrong))


def test_another_place_of_the_fifo_is_found(good: Recording) -> None:
    found = faults(changed(good, "fifo_accelerometer", np.zeros_like))
    assert any("layout.fifo_accelerometer" in fault.text for fault in found)
    assert any("stuck" in fault.text for fault in found)


@pytest.mark.parametrize(("index", "name"), [(0, "forward"), (1, "to the right")])
def test_a_wrong_sign_of_the_flow_is_found(good: Recording, index: int, name: str) -> None:
    values = good.flows.values.copy()
    values["velocity"][:, index] *= -1
    found = faults(good._replace(flows=good.flows._replace(values=values)))
    assert [fault.text for fault in found] == [f"moved {name}: wrong sign of body {'xy'[index]}"]


def test_a_battery_elsewhere_is_found(good: Recording) -> None:
    assert [one.what for one in faults(changed(good, "battery_v", lambda values: values * 1000))] == ["battery"]
    assert [one.what for one in faults(changed(good, "battery_percent", lambda values: values + 900))] == ["battery"]


def test_a_firmware_of_100_hz_and_one_without_flow_are_found(native: Built, tmp_path: Path) -> None:
    path = record(native, tmp_path, spoil_flow=lambda _: None, period_ns=10_000_000)
    texts = [fault.text for fault in faults(read_recording(path))]
    assert "the firmware calls at 100 Hz, expected 200" in texts
    assert "the firmware never called RSEDU_optical_flow" in texts


def test_a_firmware_that_stops_calling_is_found(good: Recording) -> None:
    keep = (good.samples.time_s < 20.0) | (good.samples.time_s > 21.0)
    samples = good.samples._replace(time_s=good.samples.time_s[keep], values=good.samples.values[keep])
    assert any("a gap of 1" in fault.text for fault in faults(good._replace(samples=samples)))


def test_a_short_recording_is_refused(good: Recording) -> None:
    samples = good.samples._replace(time_s=good.samples.time_s[:2000], values=good.samples.values[:2000])
    with pytest.raises(ConfigError, match="recording of 10 s, the motions of dmrac mambo check take 72 s"):
        faults(good._replace(samples=samples))


def test_a_swapped_motor_is_found() -> None:
    assert motor_faults(["front left", "front right", "rear right", "rear left"]) == []
    (first, second) = motor_faults(["front right", "front left", "rear right", "rear left"])
    assert first.text == "motor 1 of the firmware is front right, expected front left: motors.order"
    assert second.text == "motor 2 of the firmware is front left, expected front right: motors.order"


def test_only_a_passed_check_of_the_same_settings_clears(tmp_path: Path) -> None:
    board, path = board_config(), tmp_path / "check.json"
    with pytest.raises(ConfigError, match="run dmrac mambo check first"):
        require_certificate(path, board)
    write_certificate(path, board, [Fault("flow", "wrong")], tmp_path / "dmrac.rec")
    with pytest.raises(ConfigError, match="has not passed"):
        require_certificate(path, board)
    write_certificate(path, board, [], tmp_path / "dmrac.rec")
    require_certificate(path, board)
    with pytest.raises(ConfigError, match="other settings"):
        require_certificate(path, board_config(assignments=["sensors.flow_scale=2.0"]))
    path.write_text("[]")
    with pytest.raises(ConfigError, match="is not a result"):
        require_certificate(path, board)


def test_the_command_checks_the_sensors_before_the_motors(
    good_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without `--motors` it says what the sensors have, and writes nothing that could clear a vehicle."""
    out = tmp_path / "check.json"

    def check(*words: str) -> int:
        return main(["mambo", "check", str(good_file), "--out", str(out), *words])

    assert check() == 1
    assert "sensors: passed; nothing written" in capsys.readouterr().out
    assert check("--set", "sensors.accelerometer_axes=[-1, 2, 3]") == 1
    shown = capsys.readouterr().out
    assert "FAULT  accelerometer: nose down: wrong sign of body x" in shown
    assert "sensors: 1 fault; nothing written" in shown
    assert not out.exists()
    for answers in ("front left, front right", "front left, front right, rear right, left rear"):
        assert check("--motors", answers) == 2
        assert "expected 4 of front left" in capsys.readouterr().err
    assert check("--motors", ", ".join(MOTORS)) == 0
    require_certificate(out, board_config())


def test_a_damaged_recording_is_named(tmp_path: Path) -> None:
    path = tmp_path / "dmrac.rec"
    path.write_bytes(b"something else")
    with pytest.raises(ConfigError, match="not a recording of the library"):
        read_recording(path)
    path.write_bytes(b"DMRR\x01\0\0\0" + bytes([99]) + bytes(11))
    with pytest.raises(ConfigError, match="the file is damaged"):
        read_recording(path)


def test_the_end_of_a_recording_may_be_missing(good: Recording, native: Built, tmp_path: Path) -> None:
    path = tmp_path / "dmrac.rec"
    header = b"DMRR\x01\0\0\0"
    event = bytes([4, 0, 2, 0]) + (5).to_bytes(8, "little") + b"ok"
    path.write_bytes(header + event + event[:-1])
    assert read_recording(path).events == [(0.0, "ok")]
    assert in_body_axes(good, board_config()).force.shape[1] == 3


def test_a_recording_becomes_a_flight_log(good: Recording, tmp_path: Path) -> None:
    write_flight_log(good, tmp_path)
    flight = open_flight(tmp_path)
    sample, motors = flight.get("mambo/sample"), flight.get("mambo/motors")
    assert sample is not None
    assert motors is not None
    assert len(sample) == len(good.samples.time_s)
    assert np.allclose(sample["pressure"], good.samples.values["pressure"])
    assert np.allclose(sample["gyroscope_2"], good.samples.values["fifo_gyroscope"].mean(axis=1)[:, 1])
    assert set(motors["word"]) == {2.0}
    assert sample.time_ns[0] == good.start_ns
