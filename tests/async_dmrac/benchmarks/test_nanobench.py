"""NanoBench's flights: reading, learner and estimator, on small files in their format (made here, not theirs)."""

import json
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.benchmarks.nanobench import (
    FLIGHTS,
    INPUTS,
    fit_thrust,
    learner_result,
    read_flight,
    samples,
)
from async_dmrac.benchmarks.nanobench_estimates import FOLDERS, by_speed, estimates
from async_dmrac.command_line import main
from configs.loader import ConfigError
from protocol.conventions import GRAVITY
from tests.async_dmrac.benchmarks.nanobench_files import (
    DRAG,
    EKF_OFF_DEG,
    EKF_OFF_M_S,
    HEADER,
    LATE_ROWS,
    MOTOR_LAG_S,
    STILL_S,
    K,
    write_flight,
)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nanobench-iros2026")
    for number, name in enumerate(("B2_circle_slow_rep2", "B2_circle_slow_rep10", "B3_figure8_fast_rep1")):
        write_flight(folder / FLIGHTS / f"{name}.csv", number)
    write_flight(folder / FOLDERS[0] / "B9_trefoil_slow_rep1.csv", 5)
    write_flight(folder / FOLDERS[1] / "B9_trefoil_slow_rep1.csv", 6)
    write_flight(folder / FOLDERS[1] / "B9_trefoil_medium_rep1.csv", 7)
    return folder


def test_a_flight_is_read_with_their_columns_and_units(tmp_path: Path) -> None:
    truth = write_flight(tmp_path / "B2_circle_slow_rep1.csv", 3)
    flight = read_flight(tmp_path / "B2_circle_slow_rep1.csv")
    assert flight.rate_hz == pytest.approx(100.0, rel=1e-3)
    assert flight.late_rows() == LATE_ROWS
    aligned = flight.aligned()
    n = len(aligned.time_s)
    pairs = (
        (aligned.position, truth["position"]),
        (aligned.attitude, truth["attitude"]),
        (aligned.velocity, truth["velocity"]),
        (aligned.force, truth["imu_g"] * GRAVITY),
        (aligned.rate, truth["gyro"]),
        (aligned.motors, truth["pwm"] / 65535.0),
        (aligned.battery, truth["battery"]),
        (aligned.ekf_velocity, truth["ekf_velocity"]),
        (aligned.ekf_attitude, truth["ekf_attitude"]),
    )
    for found, expected in pairs:
        assert found == pytest.approx(expected[:n], abs=1e-6)


def test_the_thrust_curve_and_the_residual_are_those_of_the_law(tmp_path: Path) -> None:
    for number in (1, 2):
        write_flight(tmp_path / f"B2_circle_slow_rep{number}.csv", number)
    flights = [read_flight(tmp_path / f"B2_circle_slow_rep{number}.csv").aligned() for number in (1, 2)]
    curve = fit_thrust(flights)
    assert curve.lag_s == MOTOR_LAG_S
    volts = np.array([3.8, 4.1])[:, None] ** np.arange(3)
    assert volts @ curve.k == pytest.approx(volts @ K, rel=0.03)
    found = samples(flights[0], curve)
    velocity = found.signals[:, [INPUTS.index(name) for name in ("vx", "vy", "vz")]]
    settled = slice(40, None)
    assert found.residual[settled, :2] == pytest.approx(-DRAG[:2] * velocity[settled, :2], abs=0.06)
    assert np.abs(velocity).max() > 0.8


def test_the_learner_leaves_less_than_a_bias_on_the_last_repetition(data: Path) -> None:
    result = learner_result(data, rounds=10)
    [left] = result.flights
    assert left.flight == "B2_circle_slow_rep10"
    assert left.adapted < 0.5 * left.bias
    assert left.adapted < left.zero
    assert left.adapted < left.untrained
    assert left.held < left.zero
    assert result.left_out == []


def test_the_estimator_follows_the_motion_capture_and_their_filter_has_its_error(data: Path) -> None:
    found, left_out = estimates(data)
    assert left_out == []
    assert [one.flight for one in found] == [
        "mellinger_trefoil/B9_trefoil_slow_rep1",
        "pid_trefoil/B9_trefoil_medium_rep1",
        "pid_trefoil/B9_trefoil_slow_rep1",
    ]
    for one in found:
        assert one.late_s == pytest.approx(0.01 * LATE_ROWS, rel=1e-3)
        assert one.theirs_m_s == pytest.approx(float(np.linalg.norm(EKF_OFF_M_S)), abs=1e-3)
        assert one.theirs_deg == pytest.approx(EKF_OFF_DEG, abs=1e-2)
        assert one.logged_m_s > one.theirs_m_s
        assert one.compared_s == pytest.approx(16.0 - STILL_S, abs=0.1)
        assert one.ours_m_s < 0.004
        assert one.ours_deg < 0.15
        assert one.sparse_m_s < 0.006
        assert one.sparse_deg < 0.2
    slow, medium = by_speed(found)
    assert (slow.speed, slow.flights, slow.published_m_s, medium.flights) == ("slow", 2, 0.069, 1)
    assert slow.ours_m_s == pytest.approx(np.mean([one.ours_m_s for one in found if one.speed == "slow"]))


def test_a_table_that_begins_in_flight_is_compared_once_the_estimator_has_settled(tmp_path: Path) -> None:
    for part in FOLDERS:
        write_flight(tmp_path / part / "B9_trefoil_slow_rep1.csv", 5)
    path = tmp_path / FOLDERS[1] / "B9_trefoil_slow_rep1.csv"
    header, *rows = path.read_text().splitlines()
    path.write_text("\n".join([header, *rows[430:]]) + "\n")
    whole, cut = estimates(tmp_path)[0]
    assert cut.compared_s == pytest.approx(16.0 - 4.3 - 0.5 - 2.0, abs=0.1)
    assert cut.ours_m_s == pytest.approx(whole.ours_m_s, abs=0.003)
    assert cut.ours_deg < 0.15
    path.write_text("\n".join([header, *rows[430:700]]) + "\n")
    assert estimates(tmp_path)[1] == ["pid_trefoil/B9_trefoil_slow_rep1"]


def test_the_command_prints_both_tables(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "nanobench.json"
    assert main(["bench", "nanobench", "--data", str(data), "--json", "--out", str(out)]) == 0
    printed, err = capsys.readouterr()
    report = json.loads(printed)
    assert report == json.loads(out.read_text())
    assert report["learner"]["flights"][0]["flight"] == "B2_circle_slow_rep10"
    assert report["estimator_by_speed"][0]["published_m_s"] == 0.069
    assert "B2_circle_slow_rep10" in err
    assert "motor lag 0.03 s" in err


def test_rows_without_a_number_are_left_out_and_voltages_filled(tmp_path: Path) -> None:
    path = tmp_path / "B2_circle_slow_rep1.csv"
    write_flight(path, 1, seconds=8.0)
    lines = path.read_text().splitlines()
    first, second = lines[101].split(","), lines[102].split(",")
    lines[101] = ",".join(["" if k == 1 else cell for k, cell in enumerate(first)])
    lines[301] = ",".join(["0.0" if 4 <= k <= 7 else cell for k, cell in enumerate(lines[301].split(","))])
    lines[102] = ",".join([*second[:-1], "0.000000000"])
    path.write_text("\n".join(lines) + "\n")
    flight = read_flight(path)
    assert len(flight.time_s) == 798  # a cell is empty; a pose is zero
    assert flight.battery[100] == pytest.approx(float(first[-1]))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",imu_gyro_x,", ",gyro_x,", r"no column 'imu_gyro_x'; there are t, px, "),
        ("\n1772430159.18", "\nmorning", r"line 2, column 't': 'morning\d+': expected a number"),
        ("\n1772430159.20", "\n1772430150.20", r"line 4: the time does not increase"),
    ],
)
def test_a_file_in_another_format_is_an_error_that_names_it(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "B2_circle_slow_rep1.csv"
    write_flight(path, 1, seconds=5.0)
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError, match=f"B2_circle_slow_rep1.csv: {message}"):
        read_flight(path)


def test_a_quaternion_in_other_units_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "B2_circle_slow_rep1.csv"
    write_flight(path, 1, seconds=5.0)
    path.write_text(path.read_text().replace("qx,qy,qz,qw,roll,pitch,yaw", "roll,pitch,yaw,qw,qx,qy,qz", 1))
    with pytest.raises(ConfigError, match=r"columns qx, qy, qz, qw: the quaternions are not of unit length"):
        read_flight(path)


def test_a_missing_folder_says_where_to_get_the_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "nanobench"]) == 2
    assert main(["bench", "nanobench", "--data", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("git clone https://github.com/syediu/nanobench-iros2026") == 2
    write_flight(tmp_path / FLIGHTS / "B2_circle_slow_rep1.csv", 1, seconds=8.0)
    assert main(["bench", "nanobench", "--data", str(tmp_path)]) == 2
    assert "no trajectory with two flights" in capsys.readouterr().err


def test_the_header_is_the_one_of_their_files() -> None:
    assert len(HEADER.split(",")) == 52
