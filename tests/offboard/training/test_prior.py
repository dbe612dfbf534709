"""Rounds that start from a prior: the refit, the contest of the entrants, and what flies on."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.data.buffer import SampleTable
from offboard.memory.memory import Memory, Prior, UnusableMemoryError
from offboard.training import prior as module
from offboard.training.evidence import squared_errors
from offboard.training.gate import Verdict
from offboard.training.job import TrainingJob
from offboard.training.prior import NO_CONTEST, Contest, refit
from offboard.training.vehicle_learner import VehicleLearner
from protocol.feature_set import FeatureSet
from tests.offboard.flights import figure8_through_jet, offboard_config
from tests.offboard.memory.conditions import FEATURES, condition, random_prior

FLIGHT = figure8_through_jet(12.0, gust_m_s2=0.05)


def prior() -> Prior:
    return replace(random_prior(), variance=np.array([1.0, 100.0]), noise=np.array([0.05, 5.0]))


def memory(learnt: int = 2) -> Memory:
    return Memory(FEATURES, prior(), (condition("a"), condition("b", seed=1)), learnt)


def knowing() -> Memory:
    """A memory whose theta is not zero in the position channel."""
    start = memory()
    network = start.prior.network
    last_layer = network.last_layer.copy()
    last_layer[0] += 0.3
    return replace(start, prior=replace(start.prior, network=replace(network, last_layer=last_layer)))


def recalling(batches: int = 120) -> VehicleLearner:
    learner = VehicleLearner(offboard_config())
    learner.recall(memory())
    for batch in FLIGHT.batches()[:batches]:
        learner.receive(batch)
    return learner


def job_after(batches: int = 120) -> TrainingJob:
    job = recalling(batches).job(0)
    assert job is not None
    return job


def left(features: FeatureSet) -> float:
    """Share of the position labels' power that is left."""
    errors = squared_errors(features, FLIGHT.signals.astype(np.float32), FLIGHT.delta)[:, 0]
    return float(errors.mean() / np.square(FLIGHT.delta[:, 0]).sum(axis=1).mean())


def samples(features: FeatureSet, error: float, start_ns: int = 10**9) -> SampleTable:
    """A second of samples that the features predict but for an error of both channels that changes its sign."""
    table = SampleTable.empty(50)
    table.time_ns[:] = start_ns + np.arange(1, 51) * 20_000_000
    table.signals[:] = FLIGHT.signals[:50]
    channels = (features.position, features.attitude)
    for at, channel in enumerate(channels):
        assert channel is not None
        table.labels[:, at] = module.phi(channel, table.signals) @ channel.last_layer
    table.labels[:, :, 0] += error * np.where(np.arange(50) % 2, 1.0, -1.0)[:, None]
    return table


def test_the_refit_keeps_the_priors_inner_layers_and_explains_the_flight() -> None:
    job = job_after()
    fitted, start = refit(job, prior()), memory().version()
    for channel, other in zip(fitted.channels, start.channels, strict=True):
        assert all(np.array_equal(W, V) for W, V in zip(channel.weights, other.weights, strict=True))
    assert left(fitted) < 0.5 * left(start)


def test_the_refit_without_samples_is_the_prior() -> None:
    job = job_after()
    empty = replace(job, buffer=SampleTable.empty(0), newest=SampleTable.empty(0))
    for channel, other in zip(refit(empty, prior()).channels, memory().version().channels, strict=True):
        np.testing.assert_array_equal(channel.last_layer, other.last_layer)


def test_a_channel_without_labels_keeps_theta() -> None:
    job = job_after()
    for table in (job.buffer, job.newest):
        table.labels[:, 1] = np.nan
    fitted = refit(job, prior())
    assert fitted.attitude is not None
    assert not fitted.attitude.last_layer.any()
    assert fitted.position is not None
    assert fitted.position.last_layer.any()


def test_the_trained_networks_lead_after_enough_evidence_only() -> None:
    """Each second of new samples is predicted better by the trained entrant."""
    job = job_after()
    trained, refitted = memory().version(), refit(job, prior())
    contest = Contest(made_ns=10**9, refitted=refitted, trained=trained)
    once = contest.continued(samples(trained, 0.01))
    assert once.seconds == pytest.approx(0.98)
    assert once.trained_leads == (False, False)
    thrice = once
    for second in (2, 3):
        again = replace(thrice, made_ns=second * 10**9)
        thrice = again.continued(samples(trained, 0.01, second * 10**9))
    assert thrice.trained_leads == (True, True)


def test_equal_entrants_leave_the_lead_where_it_is() -> None:
    version = memory().version()
    for leads in ((False, False), (True, True)):
        contest = Contest(10**9, version, version, trained_leads=leads, seconds=10.0)
        assert contest.continued(samples(version, 0.5)).trained_leads == leads


def test_old_samples_and_none_decide_nothing() -> None:
    version = memory().version()
    contest = Contest(10**12, version, version)
    assert contest.continued(samples(version, 1.0)) is contest
    assert NO_CONTEST.continued(samples(version, 1.0)) is NO_CONTEST


def test_in_the_first_round_held_out_samples_say_who_leads() -> None:
    job = job_after()
    known, other = refit(job, prior()), memory().version()
    held_out = samples(known, 0.01)
    assert NO_CONTEST.opened(other, known, held_out).trained_leads == (True, True)
    assert NO_CONTEST.opened(known, other, held_out).trained_leads == (False, False)


def test_the_first_candidate_is_the_one_that_leads_in_each_channel() -> None:
    result = job_after().run()
    contest = result.contest
    assert contest.refitted is not None
    assert contest.trained is not None
    for at, leads in enumerate(contest.trained_leads):
        leader = contest.trained if leads else contest.refitted
        mine, expected = result.candidate.by_channel[at], leader.by_channel[at]
        assert mine is not None
        assert expected is not None
        assert mine.same_as(expected)


def test_the_networks_of_the_flight_start_as_without_a_memory() -> None:
    """What another condition taught may be a bad start."""
    remembering, cold = VehicleLearner(offboard_config()), VehicleLearner(offboard_config())
    remembering.recall(memory())
    for mine, other in zip(remembering._state.network.weights, cold._state.network.weights, strict=True):
        np.testing.assert_array_equal(mine, other)


def test_a_channel_that_flies_better_flies_on() -> None:
    job = job_after()
    good = job.run().candidate
    assert good.position is not None
    bad_attitude = replace(good.attitude, last_layer=good.attitude.last_layer + 50.0)  # type: ignore[type-var, union-attr]
    candidate = replace(good, position=replace(good.position, last_layer=good.position.last_layer + 50.0))
    mixed = module._without_losses(replace(job, flying=replace(good, attitude=bad_attitude)), candidate)
    assert mixed.position is not None
    assert mixed.attitude is not None
    assert mixed.position.same_as(good.position)  # as it flies
    assert candidate.attitude is not None
    assert mixed.attitude.same_as(candidate.attitude)  # the new one


def test_what_a_memory_knows_is_the_first_version() -> None:
    learner = VehicleLearner(offboard_config())
    learner.recall(knowing())
    assert learner.latest is not None
    assert learner.latest.version == 1
    assert learner.latest.position is not None
    assert learner.latest.attitude is None, "its theta is zero"


def test_inner_layers_alone_are_no_version() -> None:
    learner = VehicleLearner(offboard_config())
    learner.recall(memory())
    assert learner.latest is None


def test_a_memory_is_in_every_round() -> None:
    learner = recalling()
    job = learner.job(0)
    assert job is not None
    assert job.prior is not None
    outcome = learner.receive_result(job.run(), 10**10)
    assert outcome.verdict in (Verdict.SEND, Verdict.NOT_TRIGGERED, Verdict.NOT_SIGNIFICANT)
    later = learner.job(1)
    assert later is None  # no sample since
    assert learner._contest.refitted is not None


def test_a_refusal_ends_the_memorys_part() -> None:
    """What the vehicle refused would come again with the next refit: the flight's own networks go on alone."""
    learner = recalling(100)
    learner.refuse(0)  # none was refused
    before = learner.job(0)
    assert before is not None
    assert before.prior is not None
    learner.refuse(2)
    for batch in FLIGHT.batches()[100:110]:
        learner.receive(batch)
    after = learner.job(0)
    assert after is not None
    assert after.prior is None


def test_a_memory_that_has_not_learnt_changes_nothing() -> None:
    learner = VehicleLearner(offboard_config())
    learner.recall(memory(learnt=0))
    assert learner.latest is None


def test_a_memory_of_other_networks_is_refused() -> None:
    learner = VehicleLearner(offboard_config(features={"trained": {"hidden": [16, 16]}}))
    with pytest.raises(UnusableMemoryError, match=r"features\.trained\.hidden"):
        learner.recall(memory())


def test_the_flight_becomes_a_condition_with_complete_labels() -> None:
    learner = recalling()
    found = learner.condition("today")
    assert found.name == "today"
    assert 0 < found.samples.rows <= learner.labelled
    assert np.isfinite(found.samples.labels).all()
    assert (np.diff(found.samples.time_ns) > 0).all()
