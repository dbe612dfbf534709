"""The gate: accepts only versions that are better and safe."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.training.gate import Evidence, Gate, Verdict, mean_and_error
from offboard.training.network import InputPlan, feature_set, initial_state
from protocol.feature_set import FeatureSet
from tests.offboard.flights import offboard_config

CONFIG = offboard_config()
NETWORKS = CONFIG.features.trained
S = 1_000_000_000


def candidate() -> FeatureSet:
    return feature_set(initial_state(NETWORKS, np.random.default_rng(1)), InputPlan.of(NETWORKS), 1, 0, 100)


def evidence(new: tuple[float, float], flying: tuple[float, float], n: int = 80, seed: int = 0) -> Evidence:
    """Errors with the given means; labels of power 1 in both channels."""
    rng = np.random.default_rng(seed)
    spread = rng.uniform(0.8, 1.2, (n, 1))
    return Evidence(
        time_ns=np.arange(n) * 20_000_000,
        candidate_errors=spread * np.array(new),
        flying_errors=spread * np.array(flying),
        label_power=np.ones(2),
        numpy_difference=1e-6,
        spectral_norms=(1.0, 2.0),
    )


def gate() -> Gate:
    return Gate(CONFIG.gate, NETWORKS)


def judge(found: Evidence, features: FeatureSet | None = None) -> Verdict:
    return gate().judge(features or candidate(), found, 10 * S)


def test_a_clearly_better_version_is_sent() -> None:
    assert judge(evidence((0.1, 0.2), (0.5, 0.6))) is Verdict.SEND


def test_one_better_channel_is_enough_unless_the_other_gets_worse() -> None:
    assert judge(evidence((0.1, 0.2), (0.5, 0.2))) is Verdict.SEND
    assert judge(evidence((0.1, 0.9), (0.5, 0.2))) is Verdict.CHANNEL_WORSE


def test_one_channel_alone_is_never_called_worse() -> None:
    networks = NETWORKS.model_copy(update={"channels": ("position",)})
    alone = Gate(CONFIG.gate, networks)
    for new in (0.1, 0.9):
        verdict = alone.judge(candidate(), evidence((new, 9.0), (0.5, 0.5)), 10 * S)
        assert verdict is (Verdict.SEND if new < 0.5 else Verdict.NOT_TRIGGERED)


def test_a_gain_that_is_small_against_what_training_leaves_is_no_event() -> None:
    left = 0.5
    gain = CONFIG.gate.trigger * left
    assert judge(evidence((left, left), (left + 0.9 * gain, left + 0.9 * gain))) is Verdict.NOT_TRIGGERED
    assert judge(evidence((left, left), (left + 1.1 * gain, left))) is Verdict.SEND
    always = Gate(CONFIG.gate.model_copy(update={"trigger": 0.0}), NETWORKS)
    assert always.judge(candidate(), evidence((left, left), (left + 0.1 * gain, left)), 10 * S) is Verdict.SEND


def test_the_noise_of_the_labels_is_no_event_however_large_the_loss() -> None:
    """Both versions explain all but the noise: the loss is as large as the labels, and nothing can be gained."""
    assert judge(evidence((1.0, 1.0), (1.01, 1.01))) is Verdict.NOT_TRIGGERED


def test_a_gain_that_comes_from_a_single_stretch_is_not_sent() -> None:
    """Much better in one block of time, hardly worse in the three others: less than a standard error."""
    found = evidence((0.52, 0.5), (0.5, 0.5), n=40)
    found.flying_errors[30:, 0] = 5.0
    assert judge(found) is Verdict.NOT_SIGNIFICANT
    found.flying_errors[:30, 0] = 4.0
    assert judge(found) is Verdict.SEND


def test_too_few_samples_and_too_soon() -> None:
    good = evidence((0.1, 0.1), (0.5, 0.5))
    assert judge(evidence((0.1, 0.1), (0.5, 0.5), n=CONFIG.gate.minimum_validation - 1)) is Verdict.TOO_FEW_SAMPLES
    used_gate = gate()
    used_gate.note_sent(10 * S)
    assert used_gate.judge(candidate(), good, 10 * S + S // 10) is Verdict.TOO_SOON
    assert used_gate.judge(candidate(), good, 10 * S + round((CONFIG.gate.interval_s + 0.1) * S)) is Verdict.SEND


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({"numpy_difference": 1e-2}, Verdict.NUMPY_DIFFERS),
        ({"numpy_difference": float("nan")}, Verdict.NUMPY_DIFFERS),
        ({"spectral_norms": (1.0, 2.0 * NETWORKS.spectral_norm_max)}, Verdict.SPECTRAL_NORM),
        ({"candidate_errors": np.full((80, 2), np.nan)}, Verdict.NOT_FINITE),
    ],
)
def test_an_unsafe_version_is_refused_even_if_it_is_better(change: dict[str, object], verdict: Verdict) -> None:
    assert judge(replace(evidence((0.1, 0.1), (0.5, 0.5)), **change)) is verdict


def test_a_channel_that_is_not_learnt_is_ignored() -> None:
    found = evidence((0.1, 5.0), (0.5, 0.1))
    assert judge(found) is Verdict.CHANNEL_WORSE
    networks = NETWORKS.model_copy(update={"channels": ("position",)})
    assert Gate(CONFIG.gate, networks).judge(candidate(), found, 10 * S) is Verdict.SEND


def test_a_channel_is_judged_by_the_samples_that_have_its_label() -> None:
    found = evidence((0.1, 0.1), (0.5, 0.5))
    missing = np.arange(80) % 2 == 1
    for errors in (found.candidate_errors, found.flying_errors):
        errors[missing, 1] = np.nan
    assert judge(found) is Verdict.SEND
    found.candidate_errors[0, 1] = np.nan
    assert judge(found) is Verdict.NOT_FINITE
    for errors in (found.candidate_errors, found.flying_errors):
        errors[CONFIG.gate.minimum_validation :, 1] = np.nan
        errors[0, 1] = np.nan
    assert judge(found) is Verdict.TOO_FEW_SAMPLES


def test_neighbours_in_time_do_not_count_as_independent() -> None:
    rng = np.random.default_rng(3)
    blocks = rng.normal(0.0, 1.0, 50)
    values, time_ns = np.repeat(blocks, 10), np.arange(500) * 20_000_000
    _, error = mean_and_error(values, time_ns)
    assert error == pytest.approx(blocks.std() / np.sqrt(50), rel=0.1)
    assert error > 2.5 * values.std() / np.sqrt(500)
