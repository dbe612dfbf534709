"""Checkpoints and version files: exact, and safe to read."""

import io

import numpy as np
import pytest

from offboard.data.experience import ExperienceError, dump_version, load_experience, load_version
from offboard.training.network import InputPlan, feature_set, initial_state
from offboard.training.vehicle_learner import VehicleLearner
from tests.offboard.flights import figure8_through_jet, offboard_config


def learnt() -> VehicleLearner:
    learner = VehicleLearner(offboard_config())
    for number, batch in enumerate(figure8_through_jet(6.0).batches()):
        learner.receive(batch)
        if number % 10 == 9:
            job = learner.job(learner.version)
            if job is not None:
                learner.receive_result(job.run(), batch.time_ns)
    assert learner.version > 0
    return learner


@pytest.fixture(scope="module")
def saved() -> bytes:
    return learnt().experience()


def test_an_experience_survives_the_file_bit_for_bit(saved: bytes) -> None:
    again = VehicleLearner(offboard_config())
    again.resume(load_experience(saved))
    assert again.experience() == saved


def test_the_next_round_after_a_restart_is_the_same_as_without_it(saved: bytes) -> None:
    results = []
    for _ in range(2):
        learner = VehicleLearner(offboard_config())
        learner.resume(load_experience(saved))
        for batch in figure8_through_jet(1.0, seed=4).batches(first_index=10**6, time_ns=10**12):
            learner.receive(batch)
        job = learner.job(learner.version)
        assert job is not None
        results.append(job.run())
    assert np.array_equal(results[0].epoch_losses, results[1].epoch_losses)
    assert results[0].state.steps > results[0].state.rounds > 1


def test_another_clock_after_a_restart_does_not_set_times_back(saved: bytes) -> None:
    learner = VehicleLearner(offboard_config())
    learner.resume(load_experience(saved))
    before = load_experience(saved).newest.time_ns.max()
    for batch in figure8_through_jet(1.0, seed=4).batches(first_index=0, time_ns=0):
        learner.receive(batch)
    assert load_experience(learner.experience()).newest.time_ns[-1] > before


@pytest.mark.parametrize("cut", [0, 10, 1000, -20])
def test_damaged_files_raise_experience_error(saved: bytes, cut: int) -> None:
    with pytest.raises(ExperienceError):
        load_experience(saved[:cut])
    with pytest.raises(ExperienceError):
        load_version(saved[:cut])


def test_pickled_objects_are_refused() -> None:
    out = io.BytesIO()
    np.savez(out, header=np.array([{"format": 1}], dtype=object))
    with pytest.raises(ExperienceError):
        load_experience(out.getvalue())


def test_a_checkpoint_of_other_networks_is_refused(saved: bytes) -> None:
    narrow = VehicleLearner(offboard_config(features={"trained": {"hidden": [16, 16]}}))
    with pytest.raises(ValueError, match="shape"):
        narrow.resume(load_experience(saved))


def test_a_version_file_and_a_checkpoint_both_give_a_version(saved: bytes) -> None:
    config = offboard_config().features.trained
    version = feature_set(initial_state(config, np.random.default_rng(3)), InputPlan.of(config), 5, 4, 100)
    loaded = load_version(dump_version(version))
    assert (loaded.version, loaded.parent, loaded.samples) == (5, 4, 100)
    newest = load_experience(saved).versions[-1]
    assert load_version(saved).version == newest.version
