"""Samples from tick records are those that a trainer would have had."""

import numpy as np
import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, FlightConfig, resolve
from experiments.memory.logged_samples import labelled_samples
from offboard.config import LabelConfig
from offboard.data.buffer import SampleTable
from protocol.conventions import Array


@pytest.fixture(scope="module")
def flight() -> tuple[FlightConfig, LockstepOutcome]:
    config = resolve("figure8_wind", Choices("l1", 3, 16.0, []))
    return config, fly_lockstep(config)


def table(outcome: LockstepOutcome) -> SampleTable:
    time_ns = (outcome.trace.time_s * 1e9).round().astype(np.int64)
    return labelled_samples(time_ns, outcome.trace.tick.rows, LabelConfig())


def test_a_flight_without_a_trainer_gives_labels_close_to_the_true_disturbance(
    flight: tuple[FlightConfig, LockstepOutcome],
) -> None:
    outcome = flight[1]
    samples = table(outcome)
    kernel = np.ones(25) / 25.0
    smooth: Array = np.stack([np.convolve(one, kernel, "same") for one in outcome.trace.true_delta.T], axis=1)
    at = np.searchsorted((outcome.trace.time_s * 1e9).round(), samples.time_ns)
    truth = smooth[np.clip(at, 0, smooth.shape[0] - 1)].reshape(-1, 2, 3)
    error = np.sqrt(np.square(samples.labels - truth).mean(axis=0))
    power = np.sqrt(np.square(truth).mean(axis=0))
    assert samples.rows > 400
    assert (error[0] < 0.35 * power[0].max()).all()
    assert (error[1] < 0.35 * power[1].max()).all()


def test_signals_are_those_of_the_ticks(flight: tuple[FlightConfig, LockstepOutcome]) -> None:
    outcome = flight[1]
    samples = table(outcome)
    at = np.searchsorted((outcome.trace.time_s * 1e9).round(), samples.time_ns)
    np.testing.assert_allclose(samples.signals[:, 0], outcome.trace.tick["position_n"][at], atol=1e-6)
    np.testing.assert_allclose(samples.signals[:, 9], outcome.trace.tick["rates_p"][at], atol=1e-5)


def test_nothing_is_sampled_where_nothing_could_adapt(flight: tuple[FlightConfig, LockstepOutcome]) -> None:
    outcome = flight[1]
    rows = outcome.trace.tick.rows[:200]
    time_ns = (outcome.trace.time_s[:200] * 1e9).round().astype(np.int64)
    assert labelled_samples(time_ns, rows, LabelConfig()).rows == 0
    assert labelled_samples(time_ns[:0], rows[:0], LabelConfig()).rows == 0
