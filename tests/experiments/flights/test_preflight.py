"""The preflight check, a simulated vehicle in a person's hands: a good one passes, each mistake is found and named."""

import pytest

from async_dmrac import command_line
from async_dmrac.commands.preflight import PersonAtTerminal, table_of, verdict, write_certificate_file
from experiments.flights.preflight_session import PreflightSession
from onboard.links.vehicle import VehicleLinkConfig
from onboard.preflight.certificate import arming_refusal, read_certificate
from onboard.preflight.checks import MotorAnswer, PreflightConfig, Result, Step, check_still
from onboard.preflight.motion_checks import check_motion
from onboard.preflight.recorder import StepRecorder
from runtime.errors import StartError
from tests.experiments.flights.preflight_vehicle import HeldVehicle


def session_with(vehicle, with_pose=False):
    return PreflightSession(vehicle, vehicle, StepRecorder(VehicleLinkConfig()), PreflightConfig(), with_pose)


def checked(*mistakes, with_pose=True, motion=True, motors=True, consent=True):
    vehicle = HeldVehicle(mistakes, consent)
    return session_with(vehicle, with_pose).run(motion, motors), vehicle


def rows_of(step, *mistakes):
    """The rows of one step alone."""
    data, config = session_with(HeldVehicle(mistakes), True)._record(step, 6.0), PreflightConfig()
    return check_still(data, config, True) if step is Step.STILL else check_motion(step, data, config, True)


def step_of(row):
    name = row.partition(":")[0].upper().replace(" ", "_").replace("RIGHT_SIDE", "RIGHT")
    return Step[name] if name in Step.__members__ else Step.STILL


def motor_rows(*mistakes):
    return session_with(HeldVehicle(mistakes))._spin_motors()


def failures(checks):
    return {check.name: check.hint for check in checks if check.result is Result.FAIL}


def test_a_good_vehicle_passes_everything():
    checks, vehicle = checked()
    assert failures(checks) == {}
    assert {check.result for check in checks} == {Result.PASS}
    assert verdict(checks) == "All checks passed."
    assert vehicle.told == checks
    assert table_of(checks).row_count == len(checks) == 31


def test_without_motion_capture_its_rows_are_left_out():
    checks, _ = checked(with_pose=False, motion=False, motors=False)
    assert failures(checks) == {}
    assert not any("pose" in check.name for check in checks)


@pytest.mark.parametrize(
    ("mistake", "row", "hint"),
    [
        ("half rate", "IMU rate", "lost"),
        ("one way jitter", "IMU jitter", "radio or a busy bridge"),
        ("time in milliseconds", "time base", "milliseconds"),
        ("time in nanoseconds", "time base", "nanoseconds"),
        ("two vehicles", "one vehicle", "two vehicles"),
        ("acceleration in g", "accelerometer at rest", "in g"),
        ("acceleration in milli-g", "accelerometer at rest", "milli-g"),
        ("gravity instead of specific force", "accelerometer at rest", "sign of z"),
        ("forward left up", "accelerometer at rest", "sign of z"),
        ("gyro stuck", "gyroscope at rest", "stuck"),
        ("pressure in Pa", "pressure", "hPa"),
        ("battery low", "battery", "charge"),
        ("battery in centivolts", "battery", "mV"),
        ("no motion capture", "pose rate", "no ODOMETRY"),
        ("accelerometer x reversed", "nose down: accelerometer", "sign of accelerometer x"),
        ("x is to the right", "nose down: accelerometer", "swapped"),
        ("x is to the right", "right side down: gyroscope", "swapped"),
        ("turned by 45 degrees", "nose down: accelerometer", "45 deg about z"),
        ("nobody moves it", "right side down: accelerometer", "hardly tilted"),
        ("gyro in degrees", "nose down: gyroscope", "degrees per second"),
        ("gyro z reversed", "turn right: gyroscope", "sign of gyroscope z"),
        ("flow's gyro reversed", "nose down: flow's gyro", "sign"),
        ("range in millimetres", "lift: range", "cm"),
        ("range looks forward", "lift: range", "25"),
        ("position in millimetres", "lift: pose", "mm"),
        ("pose in ENU", "lift: pose", "third axis is up"),
        ("pose in ENU", "nose down: pose", "reversed"),
        ("quaternion world to body", "right side down: pose", "world to body"),
        ("quaternion x y z w", "nose down: pose", "x, y, z, w"),
        ("position turned by 90 degrees", "forward: pose", "not in one frame"),
        ("motors in the Mambo's order", "motor 1", "Mambo's own order"),
        ("two motors swapped", "motor 3", "motor order"),
        ("propeller turns the other way", "motor 2", "other way"),
        ("motor dead", "motor 4", "did not turn"),
        ("motors do not stop", "motors stop by themselves", "100 ms"),
    ],
)
def test_each_mistake_of_a_bridge_is_found_and_named(mistake, row, hint):
    checks = motor_rows(mistake) if row.startswith("motor") else rows_of(step_of(row), mistake)
    found = failures(checks)
    assert row in found, found
    assert hint in found[row]
    assert "failed: do not fly" in verdict(checks)


def test_without_a_typed_yes_no_motor_ever_turns():
    checks, vehicle = checked(consent=False, motion=False)
    assert vehicle.asked == ["consent"]
    assert not any(armed or any(fractions) for fractions, armed in vehicle.commands)
    assert checks[-1].result is Result.SKIPPED
    assert "not ready to fly" in verdict(checks)


def test_motors_turn_one_at_a_time_weakly_and_stop():
    _, vehicle = checked(motion=False)
    spinning = [fractions for fractions, armed in vehicle.commands if armed]
    assert {sum(f > 0.0 for f in fractions) for fractions in spinning} == {1}
    assert max(map(max, spinning)) <= 0.3
    assert vehicle.last_command == ((0.0,) * 4, False)


def test_a_vehicle_that_is_silent_while_a_motor_turns_gets_stop_commands():
    vehicle = HeldVehicle()
    frames = vehicle.frames
    vehicle.frames = lambda: [] if vehicle.commands[-1][1] else frames()
    checks = session_with(vehicle).run(motion=False, motors=True)
    assert "was silent" in checks[-1].hint
    assert sum(armed for _, armed in vehicle.commands) < 60
    assert vehicle.last_command == ((0.0,) * 4, False)


def test_an_exception_while_a_motor_turns_stops_it():
    vehicle = HeldVehicle()

    def broken():
        if vehicle.commands and vehicle.commands[-1][1]:
            vehicle.frames = list
            raise KeyboardInterrupt
        return []

    vehicle.frames = broken
    with pytest.raises(KeyboardInterrupt):
        session_with(vehicle)._spin(1)
    assert vehicle.last_command == ((0.0,) * 4, False)


def test_a_silent_vehicle_ends_the_check_at_once():
    vehicle = HeldVehicle()
    vehicle.frames = list
    checks = session_with(vehicle).run(True, True)
    assert [check.name for check in checks] == ["vehicle received"]
    assert "wrong address" in checks[0].hint


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--vehicle", "http://a:1"), "serial:///dev/DEVICE"),
        (("--vehicle", "udp://127.0.0.1:24099"), "reserved by the Mambo"),
        (("--vehicle", "serial:///dev/does-not-exist"), "cannot be opened"),
        (("--vehicle", "serial:///dev/null?baud=12345"), "12345 baud is not supported"),
        (("--vehicle", "serial:///dev/null"), "not a serial port"),
        (
            ("--vehicle", "udp://nobody.invalid:1", "--bind", "127.0.0.1:0x1"),
            "--bind 127.0.0.1:0x1: expected HOST:PORT",
        ),
        (("--vehicle", "udp://127.0.0.1:1", "--pose", "14574"), "--pose 14574: expected HOST:PORT"),
        (("--vehicle", "udp://127.0.0.1:1", "--bind", "192.0.2.1:14561"), "with --bind HOST:PORT"),
        (("--vehicle", "udp://127.0.0.1:1", "--vehicle-key-file", "none.key"), "none.key: cannot be read"),
        (("--vehicle", "udp://127.0.0.1:1", "--certificate", "nowhere/x.json"), "there is no folder nowhere"),
    ],
)
def test_bad_addresses_are_usage_errors(options, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert command_line.main(["preflight", *options, "--listen-only"]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


class Typist:
    """A console whose keyboard is a list."""

    def __init__(self, *lines):
        self.lines, self.printed = list(lines), []

    def input(self, question, markup):
        if not self.lines:
            raise EOFError
        return self.lines.pop(0)

    def print(self, text, **_):
        self.printed.append(text)


@pytest.mark.parametrize(
    ("typed", "consent"), [("yes", True), (" yes ", True), ("y", False), ("", False), ("YES!", False), ("no", False)]
)
def test_only_the_typed_word_is_consent(typed, consent):
    assert PersonAtTerminal(Typist(typed)).consents() is consent


def test_a_question_is_repeated_until_the_answer_is_valid():
    assert PersonAtTerminal(Typist("left", "FR", "?", "ccw")).saw(1) == MotorAnswer("front right", "ccw")
    assert PersonAtTerminal(Typist("none")).saw(2) == MotorAnswer("none", "")
    assert PersonAtTerminal(Typist("yes")).saw_it_stop()
    typist = Typist("")
    PersonAtTerminal(typist).ready(Step.LIFT, 8.0)
    assert "LIFT" in typist.printed[0]


def test_without_a_terminal_there_is_no_answer():
    with pytest.raises(StartError, match="needs a terminal"):
        PersonAtTerminal(Typist()).consents()


# -- the certificate ---------------------------------------------------------------------------------------------------


def written(path, checks, partly=False):
    text = write_certificate_file(path, "192.168.3.1:14560", True, checks, partly)
    certificate = read_certificate(path.read_bytes(), str(path))
    return text, arming_refusal(certificate, "192.168.3.1:14560", True, certificate.utc_s)


def test_the_results_are_written_for_onboard(tmp_path):
    path = tmp_path / "preflight.json"
    checks, _ = checked()
    text, refusal = written(path, checks)
    assert text == f"{path}: written; dmrac onboard will arm"
    assert refusal == ""
    assert [row.name for row in read_certificate(path.read_bytes(), "").checks] == [check.name for check in checks]
    checks, _ = checked("gyro z reversed")
    text, refusal = written(path, checks)
    assert refusal == "preflight failed: turn right: gyroscope"
    assert text == f"{path}: written; dmrac onboard will not arm: {refusal}"


def test_a_partial_check_does_not_replace_a_complete_one_unless_it_fails(tmp_path):
    path = tmp_path / "preflight.json"
    partial, _ = checked(motion=False, motors=False)
    assert written(path, partial, partly=True)[1].startswith("preflight is not complete: nose down")
    complete, _ = checked()
    assert written(path, complete)[1] == ""
    text, refusal = written(path, partial, partly=True)
    assert ("not changed" in text, refusal) == (True, "")
    failing, _ = checked("half rate", motion=False, motors=False)
    assert "preflight failed: IMU rate" in written(path, failing, partly=True)[1]


def test_a_vehicle_without_a_pressure_sensor_can_pass():
    rows = rows_of(Step.STILL, "no pressure")
    assert {check.name: check.result for check in rows}["pressure"] is Result.ABSENT
    assert verdict(rows) == "All checks passed."


def test_a_path_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(StartError, match=r"--certificate .*none/x\.json: cannot be written: No such file"):
        written(tmp_path / "none" / "x.json", [])
