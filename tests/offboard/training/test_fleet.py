"""Vehicles of one trainer: shared inner layers, own last layers, one round for all, and learning from another."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch

from offboard.core import OffboardCore
from offboard.training import round as round_module
from offboard.training.evidence import squared_errors
from offboard.training.fleet import MATURE_ROUNDS, Fleet
from offboard.training.gradient import LossGradient, Views, parameters_of
from offboard.training.job import TrainingJob, TrainingResult
from offboard.training.network import initial_state
from offboard.training.refit import ridge_fits
from offboard.training.round import train_together, with_last_layers
from offboard.training.vehicle_learner import VehicleLearner
from protocol.feature_set import FeatureSet
from protocol.messages import TimeSyncRequest
from tests.offboard.flights import Flight, figure8_through_jet, offboard_config
from tests.offboard.test_core import MS, START_NS, Onboard, fly

FLIGHTS = [figure8_through_jet(12.0, seed=seed, jet_m_s=5.0 + seed, gust_m_s2=0.05) for seed in range(3)]


def job_of(vehicle: int, flight: Flight, batches: int = 120, state: Any = None) -> TrainingJob:
    learner = VehicleLearner(offboard_config(seed=vehicle, vehicle_id=vehicle))
    for batch in flight.batches()[:batches]:
        learner.receive(batch)
    job = learner.job(0)
    assert job is not None
    return job if state is None else replace(job, state=state)


JOBS = [job_of(vehicle + 1, flight) for vehicle, flight in enumerate(FLIGHTS)]


def left(features: FeatureSet, flight: Flight) -> np.ndarray:
    """Share of the power of each channel's Delta that is left over a whole flight."""
    errors = squared_errors(features, flight.signals.astype(np.float32), flight.delta).mean(axis=0)
    return errors / np.square(flight.delta).sum(axis=2).mean(axis=0)


def trained(fleet: Fleet, jobs: Sequence[TrainingJob], rounds: int = 1) -> list[TrainingResult]:
    results: list[TrainingResult] = []
    for _ in range(rounds):
        entered = [fleet.enter(job) for job in jobs]
        results = [one.run() for one in entered]
        jobs = [replace(job, state=result.state) for job, result in zip(jobs, results, strict=True)]
    return results


def test_the_gradient_of_several_vehicles_is_that_of_autograd() -> None:
    C, V, M = 2, 3, 24
    rng, features = np.random.default_rng(4), offboard_config().features.trained
    states = [initial_state(features, rng) for _ in range(V)]
    state = with_last_layers(states[0], states)
    flat = parameters_of(state).flat + 0.1 * torch.from_numpy(
        rng.normal(size=parameters_of(state).flat.numel()).astype(np.float32)
    )
    z, y = (torch.from_numpy(rng.normal(size=shape).astype(np.float32)) for shape in ((C, 10, M), (C * V, 3, M // V)))
    known = torch.from_numpy((rng.random((C * V, 1, M // V)) < 0.8).astype(np.float32))
    gradient = Views.of(torch.zeros_like(flat), state)
    LossGradient(Views.of(flat, state), gradient, M).at(z, y, known, None)
    leaf = flat.clone().requires_grad_()
    total = torch.zeros(())
    for vehicle in range(V):
        own = Views.of(leaf, state).of_vehicle(vehicle)
        rows = slice(vehicle * M // V, (vehicle + 1) * M // V)
        h = z[:, :, rows]
        for W, b in zip(own.weights, own.biases, strict=True):
            h = torch.tanh(W.mT @ h + b.mT)
        errors = own.last_layer.mT @ h + own.last_bias.mT - y.view(C, V, 3, -1)[:, vehicle]
        total = total + (errors * known.view(C, V, 1, -1)[:, vehicle]).square().sum()
    (total / (3 * C * M)).backward()
    assert leaf.grad is not None
    torch.testing.assert_close(gradient.flat, leaf.grad, rtol=1e-4, atol=1e-6)


def test_a_fleet_of_one_trains_as_without_a_fleet_bit_for_bit() -> None:
    fleet, job, alone = Fleet(), JOBS[0], JOBS[0]
    for _ in range(3):
        result, expected = fleet.enter(job).run(), alone.run()
        job, alone = replace(job, state=result.state), replace(alone, state=expected.state)
    for found, wanted in zip(
        (*job.state.network.weights, *job.state.moments, job.state.network.last_layer),
        (*alone.state.network.weights, *alone.state.moments, alone.state.network.last_layer),
        strict=True,
    ):
        np.testing.assert_array_equal(found, wanted)


def test_vehicles_share_the_inner_layers_and_have_their_own_last_layer() -> None:
    results = trained(Fleet(), JOBS, 6)
    first, second, third = (result.candidate for result in results)
    for a, b in ((first, second), (second, third)):
        assert a.attitude is not None
        assert b.attitude is not None
        assert all(np.array_equal(W, V) for W, V in zip(a.attitude.weights, b.attitude.weights, strict=True))
        assert not np.allclose(a.attitude.last_layer, b.attitude.last_layer, rtol=0.01)
    for candidate, flight in zip((first, second, third), FLIGHTS, strict=True):
        assert (left(candidate, flight) < (0.12, 0.15)).all()
    assert left(first, FLIGHTS[2])[0] > 2.0 * left(third, FLIGHTS[2])[0]


def test_one_round_serves_all_that_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = []

    def counted(jobs: Any, state: Any) -> Any:
        rounds.append(len(jobs))
        return train_together(jobs, state)

    monkeypatch.setattr(round_module, "train_together", counted)
    fleet = Fleet()
    entered = [fleet.enter(job) for job in JOBS]
    assert [one.run().training_samples > 0 for one in entered] == [True] * 3
    fleet.enter(JOBS[1]).run()
    assert rounds == [3, 3]  # the second with the samples of the vehicles that do not wait


def test_a_vehicle_whose_training_fails_leaves_and_the_others_continue() -> None:
    fleet = Fleet()
    broken = replace(JOBS[1], newest=replace(JOBS[1].newest, signals=JOBS[1].newest.signals[:, :3]))
    entered = [fleet.enter(job) for job in (JOBS[0], broken, JOBS[2])]
    assert entered[0].run().training_samples > 0
    assert entered[2].run().training_samples > 0
    for _ in range(2):
        with pytest.raises(ValueError, match="dimensions"):
            entered[1].run()
    later = trained(fleet, [JOBS[0], JOBS[2]])
    first, second = (result.state.network.weights[0] for result in later)
    np.testing.assert_array_equal(first, second)


def test_a_diverged_round_restores_every_vehicle() -> None:
    wild = {"optimiser": "sgd", "learning_rate": 1e6, "momentum": 0.99}
    jobs = [replace(job, config=job.config.model_copy(update=wild)) for job in JOBS[:2]]
    for job, result in zip(jobs, trained(Fleet(), jobs), strict=True):
        np.testing.assert_array_equal(result.state.network.last_layer, job.state.network.last_layer)
        np.testing.assert_array_equal(result.state.network.weights[1], jobs[0].state.network.weights[1])
        assert np.isnan(result.evidence.candidate_errors).all()
        assert result.state.rounds == 1


def test_what_another_vehicle_learnt_in_the_jet_is_there_before_the_first_lap_ends() -> None:
    """The second vehicle has flown 3 s of a lap of 5 s; the error over the whole lap decides."""
    newcomer = figure8_through_jet(12.0, seed=7, jet_m_s=6.0, gust_m_s2=0.05)
    young = job_of(2, newcomer, batches=30)
    fleet = Fleet()
    result = trained(fleet, [JOBS[0]], 10)
    for _ in range(3):
        experienced = replace(JOBS[0], state=result[0].state)
        result = trained(fleet, [experienced, young])
        young = replace(young, state=result[1].state)
    alone = job_of(2, newcomer, batches=30)
    for _ in range(3):
        alone = replace(alone, state=alone.run().state)
    with_fleet, without = left(result[1].candidate, newcomer), left(alone.run().candidate, newcomer)
    assert (with_fleet < 0.7 * without).all()


def test_what_another_vehicle_learnt_in_another_jet_does_no_harm() -> None:
    """The jet of the second vehicle blows the other way: its held-out samples refuse the mean of the fleet."""
    opposed = figure8_through_jet(12.0, seed=7, jet_m_s=-6.0, gust_m_s2=0.05)
    fleet = Fleet()
    trained(fleet, [JOBS[0]], 10)
    result = trained(fleet, [JOBS[0], job_of(2, opposed)], 4)[1]
    alone = job_of(2, opposed)
    for _ in range(3):
        alone = replace(alone, state=alone.run().state)
    assert (left(result.candidate, opposed) < 1.1 * left(alone.run().candidate, opposed)).all()


def test_a_strong_ridge_ends_where_it_pulls_to() -> None:
    rng = np.random.default_rng(0)
    Phi, y = (torch.from_numpy(rng.normal(size=(2, width, 50)).astype(np.float32)) for width in (5, 3))
    toward = torch.from_numpy(rng.normal(size=(2, 5, 3)).astype(np.float32))
    fits = ridge_fits(Phi, y, torch.ones(2, 1, 50), (1e-6, 1e6), None, toward)
    torch.testing.assert_close(fits[0], ridge_fits(Phi, y, torch.ones(2, 1, 50), (1e-6,))[0], rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(fits[1][:, :-1], toward[:, :-1], rtol=1e-3, atol=1e-3)


def test_the_cores_of_a_fleet_ask_at_the_same_time_and_are_served_by_one_round() -> None:
    fleet = Fleet()
    cores = [OffboardCore(offboard_config(seed=v, vehicle_id=v), 7, None, fleet) for v in (1, 2)]
    sides = [Onboard(), Onboard()]
    for side, vehicle in zip(sides, (1, 2), strict=True):
        side.endpoint = type(side.endpoint)("onboard", 1, None, vehicle, side.endpoint.layout)
    for core, side, flight in zip(cores, sides, FLIGHTS, strict=False):
        core.receive_onboard(side.endpoint.encode(TimeSyncRequest(START_NS), START_NS), START_NS)
        for at, batch in enumerate(flight.batches()[:60]):
            core.receive_onboard(side.endpoint.encode(batch, START_NS + at * MS), START_NS + at * MS)
    now = START_NS + 100 * MS
    assert [core.step(now).job for core in cores] == [None, None]
    now += 20 * MS
    jobs = [core.step(now).job for core in cores]
    results = [job.run() for job in jobs if job is not None]
    assert len(results) == 2
    first, second = (result.state.network.weights[0] for result in results)
    np.testing.assert_array_equal(first, second)
    for core, result in zip(cores, results, strict=True):
        core.receive_training(result, now)
        assert core.learner.rounds == 1


def test_with_shared_false_a_core_trains_alone() -> None:
    core = OffboardCore(offboard_config(trainer={"shared": False}), 7, None, Fleet())
    log = fly(core, Onboard(), FLIGHTS[0].batches()[:80])
    alone = fly(OffboardCore(offboard_config(), 7, None), Onboard(), FLIGHTS[0].batches()[:80])
    assert log.checkpoint == alone.checkpoint
    assert [record[1] for record in log.records] == [record[1] for record in alone.records]


def test_a_vehicle_that_has_not_flown_starts_with_the_fleets_inner_layers() -> None:
    fleet = Fleet()
    assert fleet.start() is None
    trained(fleet, JOBS[:1], MATURE_ROUNDS)
    start = fleet.start()
    assert start is not None
    assert start.position is not None
    assert not start.position.last_layer.any()
    core, onboard = OffboardCore(offboard_config(), 7, None, fleet), Onboard()
    fly(core, onboard, FLIGHTS[1].batches()[:10])
    assert onboard.received[0].position is not None
    np.testing.assert_allclose(onboard.received[0].position.weights[0], start.position.weights[0], atol=1e-3)
