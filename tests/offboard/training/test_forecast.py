"""Before the first version flies, the maps so far must have foretold the samples that came after them."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.config import GateConfig
from offboard.data.buffer import SampleTable
from offboard.training.forecast import LAG_S, RATE, Forecast, left_by_bias
from offboard.training.gate import Verdict
from offboard.training.job import TrainingResult
from offboard.training.network import InputPlan, feature_set, initial_state
from offboard.training.network import phi as features_at
from offboard.training.vehicle_learner import VehicleLearner
from protocol.feature_set import FeatureSet
from protocol.signals import SIGNAL_INDEX
from tests.offboard.flights import figure8_through_jet, offboard_config

GATE = GateConfig()
NETWORKS = offboard_config().features.trained
PERIOD_NS = 20_000_000
ROUND_NS = 500_000_000


def a_map(scale: float = 1.0, seed: int = 1) -> FeatureSet:
    """Random features whose last layer is random, too, in both channels."""
    features = feature_set(initial_state(NETWORKS, np.random.default_rng(seed)), InputPlan.of(NETWORKS), 1, 0, 100)
    rng = np.random.default_rng(seed)
    with_layers = [
        replace(channel, last_layer=scale * size * rng.normal(size=channel.last_layer.shape))
        for channel, size in zip(features.channels, (1.0, 20.0), strict=True)
    ]
    return replace(features, position=with_layers[0], attitude=with_layers[1])


def flight(truth: FeatureSet, seconds: float) -> SampleTable:
    """Samples on a circle whose labels are what `truth` says there."""
    table = SampleTable.empty(round(seconds * 1e9 / PERIOD_NS))
    table.time_ns[:] = PERIOD_NS * np.arange(table.rows)
    angle = 2.0 * np.pi * table.time_ns * 1e-9 / 3.0
    for name, value in (("position_n", np.cos(angle)), ("position_e", np.sin(angle))):
        table.signals[:, SIGNAL_INDEX[name]] = 0.5 * value
    for name, value in (("velocity_n", -np.sin(angle)), ("velocity_e", np.cos(angle))):
        table.signals[:, SIGNAL_INDEX[name]] = value
    for at, channel in enumerate(truth.channels):
        table.labels[:, at] = features_at(channel, table.signals) @ channel.last_layer
    return table


def passed_after(maps: FeatureSet, truth: FeatureSet, seconds: float, **gate: float) -> list[bool]:
    """Whether a first version may fly after each round, if all candidates are `maps`."""
    forecast, table = Forecast(GATE.model_copy(update=gate)), flight(truth, seconds)
    passed = []
    for made_ns in range(ROUND_NS, round(seconds * 1e9), ROUND_NS):
        known = table.take(table.time_ns <= made_ns)
        forecast.enter(maps, made_ns, known, known.rows)
        passed.append(forecast.passed)
    return passed


def test_maps_that_foretell_pass_once_there_is_evidence_of_it() -> None:
    passed = passed_after(a_map(), a_map(), 5.0)
    rounds = round(GATE.first_evidence_s * 1e9 / ROUND_NS)
    assert passed.index(True) == rounds, "the first round's map has nothing after it, then one part comes per round"
    assert all(passed[rounds:]), "it stays so"


@pytest.mark.parametrize("wrong", [a_map(seed=2), a_map(scale=-1.0)])
def test_maps_that_do_not_foretell_wait_for_the_samples(wrong: FeatureSet) -> None:
    assert not any(passed_after(wrong, a_map(), 5.0))
    samples = 150
    after = passed_after(wrong, a_map(), 5.0, first_samples=samples)
    assert after.index(True) == -(-samples * PERIOD_NS // ROUND_NS) - 1


def test_no_map_at_all_foretells_nothing() -> None:
    assert not any(passed_after(a_map(scale=0.0), a_map(), 5.0))


def test_a_constant_error_of_the_maps_costs_nothing() -> None:
    """The bias on board takes it up."""
    truth = a_map()
    off = [replace(channel, last_layer=channel.last_layer.copy()) for channel in truth.channels]
    for channel, size in zip(off, (3.0, 60.0), strict=True):
        channel.last_layer[-1] += size
    assert any(passed_after(replace(truth, position=off[0], attitude=off[1]), truth, 5.0))


def test_zero_samples_switch_it_off() -> None:
    assert passed_after(a_map(seed=2), a_map(), 2.0, first_samples=0)[0]


@pytest.mark.parametrize("channel", [0, 1])
def test_a_bias_leaves_nothing_of_a_constant_and_all_of_what_comes_within_its_lag(channel: int) -> None:
    time_s = 0.02 * np.arange(200)
    step = np.where(time_s < 1.0, 0.0, 1.0)
    left = left_by_bias(time_s, step[:, None], RATE[channel], LAG_S[channel])[:, 0]
    within = (time_s >= 1.0) & (time_s < 1.0 + LAG_S[channel] - 1e-6)
    np.testing.assert_allclose(left[within], 1.0)
    later = time_s >= 1.0 + LAG_S[channel]
    assert np.all(np.diff(left[later]) < 0.0)
    assert left[-1] < 1e-3


class Sends:
    """A gate that finds every candidate good."""

    def judge(self, *_: object) -> Verdict:
        return Verdict.SEND

    def note_sent(self, _now_ns: int) -> None:
        pass


def learner_after_a_round(**gate: float) -> tuple[VehicleLearner, TrainingResult]:
    learner = VehicleLearner(offboard_config(gate=gate))
    learner._gate = Sends()  # type: ignore[assignment]
    job = None
    for batch in figure8_through_jet(6.0).batches():
        learner.receive(batch)
        job = learner.job(0) if job is None else job
    assert job is not None
    return learner, job.run()


def test_a_learner_sends_no_first_version_that_has_foretold_nothing() -> None:
    learner, result = learner_after_a_round(first_samples=GATE.first_samples)
    outcome = learner.receive_result(result, 10**9)
    assert outcome.verdict is Verdict.UNPROVEN
    assert outcome.to_send is None
    assert learner.latest is None


def test_a_learner_that_has_a_version_does_not_wait() -> None:
    learner, result = learner_after_a_round(first_samples=GATE.first_samples)
    learner.warm_start(result.candidate)
    assert learner.receive_result(result, 10**9).verdict is Verdict.SEND


def test_switched_off_the_first_candidate_is_sent() -> None:
    learner, result = learner_after_a_round(first_samples=0)
    assert learner.receive_result(result, 10**9).to_send is not None


def test_a_gap_in_the_samples_is_bridged_by_their_times() -> None:
    time_s = np.concatenate([0.02 * np.arange(50), 3.0 + 0.02 * np.arange(10)])
    left = left_by_bias(time_s, np.ones((60, 1)), RATE[0], LAG_S[0])[:, 0]
    assert abs(left[50]) < 1e-3, "3 s later the bias has settled"
