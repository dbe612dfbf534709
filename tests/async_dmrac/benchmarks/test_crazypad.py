"""CrazyPAD's logs: reading and learner, on small files in their format (made here, not theirs)."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from async_dmrac.benchmarks.crazypad import (
    KINDS,
    fit_gains,
    read_controller_log,
    read_motor_log,
    results,
    samples,
)
from async_dmrac.command_line import main
from configs.loader import ConfigError
from protocol.conventions import GRAVITY, Array

MOTOR_HEADER = (
    "timestamp,motor.m1,motor.m2,motor.m3,motor.m4,pwm.m1_pwm,pwm.m2_pwm,pwm.m3_pwm,pwm.m4_pwm,pm.vbatMV,"
    "stateEstimate.x,stateEstimate.y,stateEstimate.z,stateEstimate.vx,stateEstimate.vy,stateEstimate.vz,"
    "stateEstimate.ax,stateEstimate.ay,stateEstimate.az,stateEstimate.roll,stateEstimate.yaw"
)
CONTROLLER_HEADER = (
    "timestamp,stateEstimate.x,stateEstimate.y,stateEstimate.z,controller.cmd_thrust,controller.cmd_roll,"
    "controller.cmd_pitch,controller.cmd_yaw,controller.r_roll,controller.r_pitch,controller.r_yaw,controller.accelz,"
    "controller.actuatorThrust,controller.roll,controller.pitch,controller.yaw,controller.rollRate,"
    "controller.pitchRate,controller.yawRate,controller.ctr_yaw"
)
DT = 0.01
THRUST_GAIN = 4.0
"""m/s^2 of the sum of the four motors, each 0 to 1."""
AXIS_GAINS = np.array([120.0, 150.0, 30.0])
"""rad/s^2 of a full command."""
LAG_S = 0.04


def behind_lag(commands: Array) -> Array:
    """The motors' answer, a step at a time."""
    share, found = 1.0 - np.exp(-DT / LAG_S), np.zeros_like(commands)
    found[0] = commands[0]
    for k in range(1, len(commands)):
        found[k] = found[k - 1] + share * (commands[k] - found[k - 1])
    return found


def in_air(n: int) -> NDArray[np.bool_]:
    """[n] bool: two flights and a landing between them, as they fly."""
    k = np.arange(n)
    found: NDArray[np.bool_] = (k >= 60) & (k < n - 20) & ~((k > n // 2) & (k < n // 2 + 40))
    return found


def write_motor_log(path: Path, loss: float, seed: int, n: int = 700) -> dict[str, Array]:
    """A flight that loses `loss` (0 to 1) of its thrust, and more with the speed; returns its rows by name."""
    rng, t = np.random.default_rng(seed), np.arange(n) * DT
    air = in_air(n)
    motors = 0.62 + np.column_stack([0.06 * np.sin((4.0 + m) * t + seed) for m in range(4)])
    motors = np.where(air[:, None], motors, 0.0)
    velocity = np.column_stack([0.6 * np.sin(0.9 * t + seed), 0.2 * np.cos(1.7 * t), 0.3 * np.sin(2.3 * t)])
    thrust = THRUST_GAIN * behind_lag(motors).sum(axis=1) * (1.0 - loss) - 4.0 * loss * velocity[:, 0]
    ax, ay = 0.10 * np.cos(2.0 * t), 0.07 * np.sin(3.0 * t)
    az = np.sqrt(np.maximum((thrust / GRAVITY) ** 2 - ax**2 - ay**2, 0.0)) - 1.0
    acceleration = np.where(air[:, None], np.column_stack([ax, ay, az]), 0.0)
    acceleration += 1e-3 * rng.standard_normal((n, 3))
    battery = np.linspace(3742.0, 3400.0, n).round()
    height = np.where(air, 0.5, 0.05)
    raw = np.round(65535.0 * motors)
    table = np.column_stack(
        [1e3 * t, raw, 1.1 * raw, battery, 0.0 * t, 0.0 * t, height, velocity, acceleration, 0.0 * t, 0.0 * t]
    )
    save(path, table, MOTOR_HEADER)
    return {"thrust": thrust, "motors": raw / 65535.0, "velocity": velocity, "battery": battery}


def write_controller_log(path: Path, trim: float, seed: int, n: int = 700) -> dict[str, Array]:
    """A flight with an angular acceleration `trim` about pitch that its commands do not give."""
    rng, t = np.random.default_rng(seed), np.arange(n) * DT
    air = in_air(n)
    commands = np.column_stack([0.05 * np.sin(7.0 * t + seed), 0.04 * np.sin(9.0 * t), 0.06 * np.cos(5.0 * t + seed)])
    commands = np.round(65535.0 * np.where(air[:, None], commands, 0.0)) / 65535.0
    rates = np.zeros((n, 3))
    answer = behind_lag(commands) * AXIS_GAINS
    for k in range(1, n):
        extra = np.array([0.0, trim * (1.0 + rates[k - 1, 0]), 0.0])
        rates[k] = rates[k - 1] + DT * (answer[k] + extra - 6.0 * np.array([0.0, 1.0, 0.0]) * rates[k - 1])
    thrust = np.where(air, 40000.0 + 500.0 * np.sin(t), 0.0)
    height = np.where(air, 0.5, 0.05)
    noisy = rates + 1e-3 * rng.standard_normal((n, 3))
    none = np.zeros((n, 9))
    table = np.column_stack([1e3 * t, 0.0 * t, 0.0 * t, height, thrust, 65535.0 * commands, noisy, none])
    save(path, table, CONTROLLER_HEADER)
    return {"commands": commands, "rates": noisy, "answer": answer, "thrust": thrust / 65535.0}


def save(path: Path, table: Array, header: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=header, comments="")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("CrazyPAD") / "data"
    conditions = (("normal_flight", 0.0), ("cut_propeller_M3_2mm", 0.08), ("cut_propeller_M3_3mm", 0.12))
    for place, (condition, loss) in enumerate(conditions):
        for log in range(3):
            seed = 10 * place + log
            write_motor_log(folder / "motor_data" / condition / f"E8_log0{log}.csv", loss, seed)
            write_controller_log(folder / "controller_data" / condition / f"E8_log0{log}.csv", 60.0 * loss, seed)
    (folder / "motor_data" / "normal_flight" / "E8_log00").write_bytes(b"\xbc the binary log beside it")
    return folder


def test_a_motor_log_is_read_with_its_columns_and_units(tmp_path: Path) -> None:
    truth = write_motor_log(tmp_path / "motor_data" / "normal_flight" / "E8_log00.csv", 0.1, 3)
    log = read_motor_log(tmp_path / "motor_data" / "normal_flight" / "E8_log00.csv")
    assert (log.name, log.condition) == ("normal_flight/E8_log00", "normal_flight")
    assert log.rate_hz == pytest.approx(100.0)
    assert (log.flying == in_air(700)).all()
    assert log.motion[log.flying, 0] == pytest.approx(truth["thrust"][log.flying], abs=0.06)
    assert log.commands[:, 0] == pytest.approx(truth["motors"].sum(axis=1))
    volts = 1e-3 * truth["battery"][:, None]
    assert log.others == pytest.approx(np.hstack([truth["velocity"], truth["motors"], volts]), abs=1e-6)


def test_a_controller_log_is_read_with_its_columns_and_units(tmp_path: Path) -> None:
    truth = write_controller_log(tmp_path / "controller_data" / "normal_flight" / "E9_log00.csv", 0.0, 3)
    log = read_controller_log(tmp_path / "controller_data" / "normal_flight" / "E9_log00.csv")
    assert log.commands == pytest.approx(truth["commands"], abs=1e-6)
    assert log.others == pytest.approx(np.column_stack([truth["rates"], truth["thrust"]]), abs=1e-6)
    assert np.count_nonzero(log.flying) > 500
    assert log.motion[log.flying, 0] == pytest.approx(truth["answer"][log.flying, 0], abs=1.3)
    assert np.abs(truth["answer"][log.flying, 0]).max() > 5.0


def test_the_gains_and_the_loss_of_thrust_are_those_of_the_law(tmp_path: Path) -> None:
    write_motor_log(tmp_path / "normal_flight" / "E8_log00.csv", 0.0, 1)
    truth = write_motor_log(tmp_path / "cut" / "E8_log00.csv", 0.1, 2)
    gains, lags_s = fit_gains([read_motor_log(tmp_path / "normal_flight" / "E8_log00.csv")])
    assert gains == pytest.approx([THRUST_GAIN], rel=2e-3)
    assert lags_s == pytest.approx([LAG_S])
    cut = read_motor_log(tmp_path / "cut" / "E8_log00.csv")
    expected = -0.1 * THRUST_GAIN * behind_lag(truth["motors"]).sum(axis=1) - 0.4 * truth["velocity"][:, 0]
    residual = samples(cut, gains, lags_s).residual[:, 0]
    assert residual == pytest.approx(expected[cut.flying], abs=0.08)


def test_the_gains_of_the_axes_are_those_of_the_law(tmp_path: Path) -> None:
    write_controller_log(tmp_path / "normal_flight" / "E8_log00.csv", 0.0, 1)
    gains, lags_s = fit_gains([read_controller_log(tmp_path / "normal_flight" / "E8_log00.csv")])
    assert gains[[0, 2]] == pytest.approx(AXIS_GAINS[[0, 2]], rel=0.05)
    assert lags_s[0] == pytest.approx(LAG_S, abs=0.011)
    assert AXIS_GAINS[2] < gains[1] < AXIS_GAINS[1]  # the pitch axis of the test is damped


def test_the_learner_leaves_less_than_a_bias_of_damaged_flights(data: Path) -> None:
    thrust, rates = results(data, rounds=10)
    assert (thrust.kind, thrust.unit, rates.unit) == ("motor_data", "m/s^2", "rad/s^2")
    assert [one.flight for one in thrust.flights] == [
        "cut_propeller_M3_2mm/E8_log02",
        "cut_propeller_M3_3mm/E8_log02",
        "normal_flight/E8_log02",
    ]
    for one in thrust.flights[:2]:
        assert one.zero > 0.5
        assert one.adapted < one.bias < 0.3 * one.zero
        assert one.adapted < 0.5 * one.held  # what is cut is not known before
    cut = rates.flights[1]
    assert cut.zero > 1.0
    assert cut.adapted < 0.9 * cut.bias
    assert cut.adapted < 0.9 * cut.zero
    assert len(KINDS[0].inputs) == 9
    assert len(KINDS[1].inputs) == 7


def test_the_command_prints_a_table_per_kind(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "crazypad", "--data", str(data), "--json"]) == 0
    out, err = capsys.readouterr()
    assert [one["kind"] for one in json.loads(out)] == ["motor_data", "controller_data"]
    assert err.count("cut_propeller_M3_3mm/E8_log02") == 2
    assert "gains 4.0 m/s^2" in err


def test_a_log_that_never_flies_is_left_out_by_name(data: Path, tmp_path: Path) -> None:
    for number in range(3):
        write_motor_log(tmp_path / "motor_data" / "normal_flight" / f"E8_log0{number}.csv", 0.0, number)
        write_controller_log(tmp_path / "controller_data" / "normal_flight" / f"E8_log0{number}.csv", 0.0, number)
    write_motor_log(tmp_path / "motor_data" / "tape" / "E9_log00.csv", 0.0, 4, n=200)
    assert results(tmp_path, rounds=1)[0].left_out == ["tape/E9_log00"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",pm.vbatMV,", ",pm.vbat,", r"no column 'pm.vbatMV'; there are timestamp, motor.m1, "),
        ("\n20,", "\nx20,", r"line 4, column 'timestamp': 'x20': expected a number"),
        ("\n20,", "\n5,", r"line 4: the time does not increase"),
    ],
)
def test_a_file_in_another_format_is_an_error_that_names_it(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "normal_flight" / "E8_log00.csv"
    write_motor_log(path, 0.0, 1)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError, match=f"E8_log00.csv: {message}"):
        read_motor_log(path)


def test_a_missing_folder_says_where_to_get_the_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "crazypad"]) == 2
    assert main(["bench", "crazypad", "--data", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("git clone https://github.com/AerialRoboticsUUST/CrazyPAD") == 2
    assert main(["bench", "gym", "--data", str(tmp_path)]) == 2
    assert "only with dmrac bench neural-fly, nanobench, crazypad" in capsys.readouterr().err
    write_motor_log(tmp_path / "motor_data" / "normal_flight" / "E8_log00.csv", 0.0, 1)
    assert main(["bench", "crazypad", "--data", str(tmp_path)]) == 2
    assert "expected two flights of normal_flight" in capsys.readouterr().err
