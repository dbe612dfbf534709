"""The windows of the metrics, with laps and without."""

import math

import pytest

from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.metrics import FlightMetrics, flight_metrics, rms
from experiments.flights.scenario import Choices, resolve


def test_first_and_settled_laps() -> None:
    metrics = FlightMetrics(1.0, 0.1, (0.4, 0.3, 0.2))
    assert metrics.first_lap_rmse_m == pytest.approx(0.4)
    assert metrics.settled_rmse_m == pytest.approx(math.sqrt((0.09 + 0.04) / 2.0))


def test_without_laps_the_first_windows_stand_for_the_first_lap() -> None:
    assert FlightMetrics(1.0, 0.1, (0.4, 0.3, 0.2), 2).first_lap_rmse_m == pytest.approx(math.sqrt(0.125))
    assert math.isnan(FlightMetrics(1.0, 0.1, (0.4,), 2).first_lap_rmse_m)
    assert math.isnan(FlightMetrics(1.0, 0.1, ()).first_lap_rmse_m)
    assert FlightMetrics(1.0, 0.1, ()).settled_rmse_m == 1.0


def test_a_lissajous_flight_has_windows_and_its_path_comes_from_the_seed() -> None:
    """The first lap's figure is the RMSE of the first 12 s at full speed."""
    config = resolve("lissajous_wind", Choices("pid", 5, 27.0))
    assert config.onboard.guidance.trajectory.path.seed == 5
    assert resolve("lissajous_wind", Choices("pid", 6)).onboard.guidance.trajectory.path.seed == 6
    chosen = Choices("pid", 6, assignments=("onboard.guidance.trajectory.path.seed=9",))
    assert resolve("lissajous_wind", chosen).onboard.guidance.trajectory.path.seed == 9
    trace = fly_lockstep(config).trace
    metrics = flight_metrics(trace, config.onboard.guidance.trajectory)
    since = trace.tick["path_time"] - 6.5
    first = rms(trace.position_error[trace.on_path & (since >= 0.0) & (since < 12.0)])
    assert len(metrics.lap_rmse_m) == 2
    assert metrics.first_lap_rmse_m == pytest.approx(first, rel=1e-3)
    assert metrics.settled_rmse_m == metrics.lap_rmse_m[1]
