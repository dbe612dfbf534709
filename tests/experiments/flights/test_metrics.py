"""The windows of the metrics, with laps and without."""

import math
from typing import Any

import numpy as np
import pytest

from experiments.flights.flight_summary import build_summary, summary_rows
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.metrics import FlightMetrics, bound_metrics, flight_metrics, rms
from experiments.flights.scenario import Choices, resolve
from experiments.flights.trace import Columns, FlightTrace
from onboard.flight.modes import FlightMode
from onboard.record.tick import OFFSET, TICK
from sim_vehicle.records import TRUTH


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


def made_up_trace(errors_m: list[float], bounds_m: list[float], flying: list[bool]) -> FlightTrace:
    ticks, truths = np.zeros((len(errors_m), len(TICK.names))), np.zeros((len(errors_m), len(TRUTH.names)))
    ticks[:, OFFSET["mode"]] = [FlightMode.FLYING.value if one else FlightMode.LANDING.value for one in flying]
    ticks[:, OFFSET["position_tracking_bound"]] = bounds_m
    ticks[:, OFFSET["commanded_quaternion_w"]] = truths[:, TRUTH.names.index("quaternion_w")] = 1.0
    truths[:, TRUTH.names.index("position_n")] = errors_m
    return FlightTrace(0.005 * np.arange(len(errors_m)), Columns(TICK, ticks), Columns(TRUTH, truths))


def test_coverage_counts_the_ticks_on_the_path_that_have_a_bound() -> None:
    trace = made_up_trace([0.1, 0.1, 0.3, 0.9, 0.9], [0.1, 0.2, 0.2, 0.0, 0.1], [True, True, True, True, False])
    position, attitude = bound_metrics(trace).values()
    assert position.coverage == pytest.approx(2.0 / 3.0)
    assert (position.bound_median, position.error_median) == (0.2, 0.1)
    assert math.isnan(attitude.coverage)
    assert math.isnan(attitude.bound_median)


def test_the_summary_says_bound_error_and_coverage() -> None:
    trace = made_up_trace([0.01, 0.01, 0.03, 0.01], [0.02, 0.02, 0.02, 0.02], [True] * 4)
    trace.tick.rows[:, OFFSET["attitude_tracking_bound"]] = 0.1
    config = resolve("hover", Choices("pid", 5, 5.0))
    counts: dict[str, dict[str, int]] = {}
    told: dict[str, Any] = build_summary(config, "lockstep", trace, "", {}, None, counts)
    assert told["live_bound"]["position"] == {"bound_median": 0.02, "error_median": 0.01, "coverage": 0.75}
    line = dict(summary_rows(told))["live bound"]
    assert line == "position 20.0 mm (error 10.0), 75.0 % covered; attitude 5.7 deg (error 0.0), 100.0 % covered"


def test_the_summary_says_what_training_did_and_what_it_did_not_use() -> None:
    trace = made_up_trace([0.01] * 4, [0.02] * 4, [True] * 4)
    counts: dict[str, dict[str, int]] = {}
    offboard = {
        "rounds": 5,
        "verdicts": {"send": 2, "not_triggered": 3},
        "unused": {"low": 7, "gap_position": 0, "over_limit_attitude": 9},
        "rejected": {},
    }
    told = build_summary(resolve("hover", Choices("pid", 5, 5.0)), "lockstep", trace, "", {}, offboard, counts)
    lines = dict(summary_rows(told))
    assert lines["training"] == "5 rounds: not triggered 3, send 2"
    assert lines["not learnt from"] == "over limit attitude 9, low 7"
    without = build_summary(resolve("hover", Choices("pid", 5, 5.0)), "lockstep", trace, "", {}, None, counts)
    assert not {"training", "not learnt from"} & dict(summary_rows(without)).keys()
