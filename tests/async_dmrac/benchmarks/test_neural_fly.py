"""The reader of Neural-Fly's flights and the comparison, on small files in their format (made here, not theirs)."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from async_dmrac.benchmarks.neural_fly import FORCES, SIGNALS, compare, read_recording
from async_dmrac.command_line import main
from configs.loader import ConfigError

COLUMNS = ("", "t", "p", "p_d", "v", "v_d", "q", "R", "w", "T_sp", "q_sp", "hover_throttle", "fa", "pwm")


def write_flight(path: Path, wind_m_s: float, seed: int, samples: int = 400) -> np.ndarray:
    """A flight whose force is a drag on the air speed; returns the forces."""
    rng, t = np.random.default_rng(seed), np.arange(samples) * 0.02
    v = np.column_stack([2.0 * np.cos(2.0 * t + seed), 0.3 * np.sin(t), np.cos(4.0 * t)])
    air = v - np.array([wind_m_s, 0.0, 0.0])
    fa = -0.3 * air * np.linalg.norm(air, axis=1, keepdims=True) + 0.05 * rng.standard_normal(v.shape)
    pwm = 950.0 + 40.0 * rng.standard_normal((samples, 4))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for k in range(samples):
            vector, rotation = json.dumps([0.0] * 3), json.dumps(np.eye(3).tolist())
            cells = (
                vector,
                vector,
                json.dumps(v[k].tolist()),
                vector,
                json.dumps([0.0, 0.0, 0.0, 1.0]),
                rotation,
                vector,
            )
            last = ("[0.45]", json.dumps([0.0] * 4), "[0.45]", json.dumps(fa[k].tolist()), json.dumps(pwm[k].tolist()))
            writer.writerow([k, t[k], *cells, *last])
    return fa


@pytest.fixture
def data(tmp_path: Path) -> Path:
    for number, wind in enumerate((0, 2, 4)):
        write_flight(tmp_path / "training" / f"custom_random3_baseline_{wind}0wind.csv", wind, number)
    write_flight(tmp_path / "experiment" / "custom_figure8_baseline_35wind.csv", 3.0, 7)
    write_flight(tmp_path / "experiment" / "custom_figure8_NF_35wind.csv", 3.0, 8)
    return tmp_path


def test_a_flight_is_read_with_their_columns_and_units(data: Path) -> None:
    path = data / "experiment" / "custom_figure8_baseline_35wind.csv"
    forces = write_flight(path, 3.0, 7)
    flight = read_recording(path)
    assert flight.signals.shape == (400, len(SIGNALS))
    assert flight.rate_hz == pytest.approx(50.0)
    assert flight.forces == pytest.approx(forces)
    pwm = [SIGNALS.index(f"pwm_{k}") for k in range(4)]
    assert flight.signals[:, pwm].mean() == pytest.approx(0.95, abs=0.01)


def test_the_learner_beats_the_mean_on_a_flight_that_it_has_not_seen(data: Path) -> None:
    [errors] = compare(data, rounds=10)
    assert (errors.condition, errors.samples, errors.published) == ("35wind", 400, 0.74)
    assert errors.fitted < errors.ahead < errors.mean < errors.zero
    assert errors.ahead < errors.ahead_untrained


def test_the_command_prints_a_table(data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "neural-fly", "--data", str(data), "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)[0]["condition"] == "35wind"
    assert "35wind" in err


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (",fa,", ",force,", r"no column 'fa'; there are .*force"),
        ('"[0.0, 0.0, 0.0, 1.0]"', "1.0;0.0", r"line 2, column 'q': '1.0;0.0': expected 4 numbers"),
        ('"[0.0, 0.0, 0.0, 1.0]"', '"[0.0, NaN, 0.0, 1.0]"', r"column 'q': a value is not finite"),
    ],
)
def test_a_file_in_another_format_is_an_error_that_names_it(data: Path, old: str, new: str, message: str) -> None:
    path = data / "training" / "custom_random3_baseline_00wind.csv"
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ConfigError, match=f"custom_random3_baseline_00wind.csv: {message}"):
        read_recording(path)


def test_a_missing_folder_says_where_to_get_the_flights(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "neural-fly"]) == 2
    assert main(["bench", "neural-fly", "--data", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("git clone https://github.com/aerorobotics/neural-fly") == 2
    assert main(["bench", "gym", "--data", str(tmp_path)]) == 2
    assert "only with dmrac bench neural-fly" in capsys.readouterr().err
    assert len(FORCES) == 3
