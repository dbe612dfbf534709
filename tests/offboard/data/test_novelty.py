"""The incremental novelty tests and the swap, compared with brute force."""

import numpy as np
import pytest

from offboard.data.novelty import JITTER, HistoryNovelty, KernelNovelty, swap_for_largest_sigma_min


def brute_gamma(points: np.ndarray, x: np.ndarray) -> float:
    """k(x,x) - k' (K + JITTER I)^-1 k, computed from scratch."""
    if not len(points):
        return 1.0
    K = np.exp(-0.5 * ((points[:, None] - points[None]) ** 2).sum(axis=2)) + JITTER * np.eye(len(points))
    k = np.exp(-0.5 * ((points - x) ** 2).sum(axis=1))
    return float(1.0 - k @ np.linalg.solve(K, k))


def test_gamma_equals_brute_force_through_additions_and_replacements() -> None:
    rng = np.random.default_rng(1)
    novelty, kept = KernelNovelty(160, 4), np.zeros((0, 4))
    for step in range(600):
        x = rng.normal(0.0, 1.2, 4)
        gamma, nearest = novelty.gamma(x)
        assert gamma == pytest.approx(brute_gamma(kept, x), abs=1e-6)
        if len(kept):
            assert nearest == int(((kept - x) ** 2).sum(axis=1).argmin())
        other = x if step % 3 else rng.normal(0.0, 1.2, 4)  # the point of the last query, or another one
        if len(kept) and (len(kept) == 160 or rng.random() < 0.3):
            slot = int(rng.integers(len(kept)))
            novelty.replace(slot, other)
            kept[slot] = other
        elif gamma > 0.01:
            novelty.add(len(kept), x)
            kept = np.vstack([kept, x])
    assert len(kept) == 160


def test_gamma_does_not_drift_over_thousands_of_swaps() -> None:
    rng = np.random.default_rng(2)
    novelty, kept = KernelNovelty(64, 3), np.zeros((64, 3))
    for slot in range(64):
        kept[slot] = rng.normal(0.0, 1.0, 3)
        novelty.add(slot, kept[slot])
    for _ in range(4000):
        slot = int(rng.integers(64))
        kept[slot] = rng.normal(0.0, 1.0, 3)
        novelty.replace(slot, kept[slot])
    x = rng.normal(0.0, 1.0, 3)
    assert novelty.gamma(x)[0] == pytest.approx(brute_gamma(kept, x), abs=1e-5)


def test_a_point_of_another_condition_explains_nothing() -> None:
    rng = np.random.default_rng(4)
    points, condition = rng.normal(0.0, 0.7, (60, 3)), rng.integers(0, 3, 60)
    novelty = KernelNovelty(64, 3)
    for slot, x in enumerate(points):
        novelty.add(slot, x, int(condition[slot]))
    for slot in range(0, 60, 7):  # a slot may pass to another condition
        points[slot], condition[slot] = rng.normal(0.0, 0.7, 3), (condition[slot] + 1) % 3
        novelty.replace(slot, points[slot], int(condition[slot]))
    x = rng.normal(0.0, 0.7, 3)
    for one in range(3):
        gamma, nearest = novelty.gamma(x, one)
        own = np.flatnonzero(condition == one)
        assert gamma == pytest.approx(brute_gamma(points[own], x), abs=1e-6)
        assert nearest == own[((points[own] - x) ** 2).sum(axis=1).argmin()]
    assert novelty.gamma(x, 3) == (1.0, -1)


def smallest_singular_value(Phi: np.ndarray) -> float:
    return float(np.linalg.svd(Phi, compute_uv=False)[-1])


@pytest.mark.parametrize("seed", range(20))
def test_swap_for_largest_sigma_min_equals_brute_force_over_all_swaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, k = int(rng.integers(12, 80)), int(rng.integers(2, 10))
    Phi = np.tanh(rng.normal(0.0, 1.0, (p, k)) * rng.uniform(0.05, 1.0, k))
    phi_new = np.tanh(rng.normal(0.0, 1.0, k))
    after = [smallest_singular_value(np.vstack([np.delete(Phi, row, axis=0), phi_new])) for row in range(p)]
    chosen = swap_for_largest_sigma_min(Phi, Phi.T @ Phi, phi_new)
    assert after[chosen] == pytest.approx(max(after), rel=1e-6)


def test_swap_for_largest_sigma_min_works_for_a_rank_deficient_stack() -> None:
    Phi = np.ones((5, 3))
    assert 0 <= swap_for_largest_sigma_min(Phi, Phi.T @ Phi, np.ones(3)) < 5


def test_history_novelty_accepts_a_large_step_or_a_new_direction() -> None:
    novelty = HistoryNovelty(0.1)
    first = np.array([1.0, 0.0, 0.0])
    assert novelty.is_new(first)
    novelty.add(first)
    assert not novelty.is_new(first)
    assert not novelty.is_new(np.array([1.1, 0.0, 0.0]))
    assert novelty.is_new(np.array([1.1, 0.01, 0.0]))  # a small step, but in a new direction
    novelty.add(np.array([1.1, 0.01, 0.0]))
    assert not novelty.is_new(np.array([1.1, 0.02, 0.0]))
    assert novelty.is_new(np.array([0.5, 0.5, 0.0]))  # a large step
