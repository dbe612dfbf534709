"""`dmrac bench sensors`: the sensors' noise in hover beside that of real flight logs, and the estimator's fit to it."""

import json

import numpy as np
import pytest

from async_dmrac.command_line import main
from experiments.flights.sensor_noise import LOGGED, NIS, SCENARIOS, band_variance, rows_of


def test_hover_shows_the_logged_noise_and_the_sigmas_fit(tmp_path, capsys):
    file = tmp_path / "noise.json"
    assert main(["bench", "sensors", "--seconds", "8", "--out", str(file)]) == 0
    report = json.loads(file.read_text(encoding="utf-8"))
    assert report["noise"] == "measured"
    assert [row["quantity"] for row in report["rows"]] == list(LOGGED)
    off = [row for row in report["rows"] if row["fits"] is False]
    of_gains = ("gyro", "tilt", "accelerometer z, 3-15 Hz")
    assert all(row["quantity"].startswith(of_gains) for row in off), "these depend on the gains too"
    assert all(row["simulated"] < row["logged"][0] for row in off if row["quantity"].startswith("tilt"))
    assert list(report["nis"]) == list(SCENARIOS)
    for means in report["nis"].values():
        assert set(means) == {"flow", "pose_attitude", "pose_position", "pressure", "range"}
        assert all(NIS[0] <= mean <= NIS[1] for mean in means.values()), means
    shown = capsys.readouterr().out
    assert "sensors in hover: IMU noise measured, controller dmrac" in shown
    assert all(name in shown for name in LOGGED)


def test_band_variance_splits_the_variance():
    time_s = np.arange(2000) * 0.005
    samples = np.stack([1.0 + 3.0 * np.sin(2 * np.pi * 8 * time_s), 0.5 * np.sin(2 * np.pi * 88 * time_s)], axis=1)
    np.testing.assert_allclose(band_variance(samples, 3.0, 15.0), [4.5, 0.0], atol=1e-9)
    np.testing.assert_allclose(band_variance(samples, 50.0, np.inf), [0.0, 0.125], atol=1e-9)
    noise = np.random.default_rng(1).standard_normal((2000, 2))
    np.testing.assert_allclose(band_variance(noise, 0.0, np.inf), noise.var(axis=0))


@pytest.mark.parametrize(("times", "fits"), [(1.0, True), (1.24, True), (0.76, True), (1.3, False), (0.7, False)])
def test_a_quantity_fits_within_a_quarter(times, fits):
    logged = {name: one or (1.0, 1.0) for name, one in LOGGED.items()}
    figures = {name: times * (least if times < 1.0 else greatest) for name, (least, greatest) in logged.items()}
    for row in rows_of(figures):
        assert row.fits is (None if row.logged is None else fits)
