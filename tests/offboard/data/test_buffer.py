"""The buffer: bounded, diverse, and updated where the vehicle flies."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.data.buffer import TEST, TRAINING, VALIDATION, NewestRing, NoveltyBuffer, split_of_block
from offboard.data.labels import LabelledSample
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.offboard.flights import offboard_config

CONFIG = offboard_config()
S = 1_000_000_000


def sample(index: int, position_n: float, label: float = 0.0, time_s: float | None = None) -> LabelledSample:
    signals = np.zeros(SIGNAL_COUNT)
    signals[SIGNAL_INDEX["position_n"]] = position_n
    signals[SIGNAL_INDEX["position_d"]] = -1.0
    return LabelledSample(
        index, round((index * 0.02 if time_s is None else time_s) * S), signals, np.full((2, 3), label)
    )


def features(signals: np.ndarray) -> np.ndarray:
    """Some smooth features of position_n, with a constant."""
    x = signals[:, SIGNAL_INDEX["position_n"]].astype(np.float64)
    return np.stack([np.tanh(x), np.tanh(2.0 * x - 1.0), np.tanh(x + 2.0), np.ones_like(x)], axis=1)


def buffer(**over: object) -> NoveltyBuffer:
    config = CONFIG.buffer.model_copy(update={"capacity": 24, **over})
    return NoveltyBuffer(config, CONFIG.features.trained, features)


def fill(kept: NoveltyBuffer, n: int = 400, seed: int = 0) -> None:
    rng = np.random.default_rng(seed)
    for index in range(n):
        kept.consider(sample(index, float(rng.uniform(-8.0, 8.0)), float(index)), TRAINING)


@pytest.mark.parametrize("admission", ["kernel", "history"])
@pytest.mark.parametrize("deletion", ["svd", "fifo"])
def test_capacity_is_never_exceeded_and_rows_are_consistent(admission: str, deletion: str) -> None:
    kept = buffer(admission=admission, deletion=deletion)
    fill(kept)
    rows = kept.rows()
    assert rows.rows == kept.count <= 24
    assert kept.count > 5
    assert len(set(rows.time_ns.tolist())) == kept.count
    assert np.array_equal(rows.labels[:, 0, 0], (rows.time_ns / (0.02 * S)).astype(np.float32).round())


def test_svd_keeps_the_smallest_singular_value_higher_than_fifo() -> None:
    smallest = []
    for deletion in ("svd", "fifo"):
        kept = buffer(admission="history", deletion=deletion)
        fill(kept, 1500, seed=3)
        smallest.append(np.linalg.svd(features(kept.rows().signals), compute_uv=False)[-1])
    assert smallest[0] > 1.2 * smallest[1]


def test_a_hovering_vehicle_does_not_fill_the_buffer_but_refreshes_it() -> None:
    kept = buffer(capacity=100)
    rng = np.random.default_rng(1)
    for index in range(2000):
        kept.consider(sample(index, float(rng.normal(0.0, 0.01)), float(index)), TRAINING)
    assert kept.count < 5
    youngest = kept.rows().labels[:, 0, 0].min()
    assert youngest > 2000 - 3 * CONFIG.buffer.refresh_age_s / 0.02


def test_fifo_replaces_the_oldest() -> None:
    kept = buffer(deletion="fifo", refresh_age_s=1e6)
    for index in range(40):
        kept.consider(sample(index, 3.0 * index), TRAINING)
    assert sorted((kept.rows().time_ns / (0.02 * S)).round().astype(int).tolist()) == list(range(16, 40))


def test_new_features_change_nothing_but_the_stack() -> None:
    kept, other = buffer(), buffer()
    fill(kept, 200)
    fill(other, 200)
    kept.set_features(features)
    fill(kept, 50, seed=5)
    fill(other, 50, seed=5)
    assert np.array_equal(kept.rows().time_ns, other.rows().time_ns)


def test_loaded_rows_behave_like_the_original() -> None:
    kept, again = buffer(), buffer()
    fill(kept, 200)
    again.load(kept.rows(), kept.order)
    fill(kept, 60, seed=9)
    fill(again, 60, seed=9)
    assert np.array_equal(kept.rows().time_ns, again.rows().time_ns)
    assert np.array_equal(kept.order, again.order)


def test_ring_keeps_the_newest_in_order_and_reloads() -> None:
    ring = NewestRing(10)
    for index in range(37):
        ring.put(sample(index, 0.0), TRAINING)
    expected = list(range(27, 37))
    assert (ring.rows().time_ns / (0.02 * S)).round().astype(int).tolist() == expected
    again = NewestRing(10)
    again.load(ring.rows())
    again.put(sample(37, 0.0), TRAINING)
    assert (again.rows().time_ns / (0.02 * S)).round().astype(int).tolist() == list(range(28, 38))


def test_splits_are_by_block_and_in_proportion() -> None:
    splits = [split_of_block(block, 1, 5, 4) for block in range(2000)]
    assert splits.count(VALIDATION) == 400
    assert splits.count(TEST) == 100
    places = {block % 10 for block, split in enumerate(splits) if split == VALIDATION}
    assert places == set(range(10))  # no lap of ten blocks always holds out the same stretch
    assert splits == [split_of_block(block, 1, 5, 4) for block in range(2000)]
    assert splits != [split_of_block(block, 2, 5, 4) for block in range(2000)]


def test_old_validation_samples_are_released_to_training_and_new_ones_are_not() -> None:
    ring = NewestRing(10)
    for index in range(10):
        ring.put(sample(index, 0.0), VALIDATION if index % 2 else TEST)
    rows = ring.rows().released(5 * 20_000_000)
    assert rows.split.tolist() == [TEST, TRAINING, TEST, TRAINING, TEST, VALIDATION, TEST, VALIDATION, TEST, VALIDATION]
    assert ring.rows().split.tolist() == [TEST, VALIDATION] * 5
    assert replace(rows, split=ring.rows().split).rows == 10


def wind(condition: int, kept: NoveltyBuffer, first: int, label: float, laps: int = 3) -> None:
    """Fly the same 12 m stretch, several times, in a condition whose labels all have this value."""
    for number in range(laps * 100):
        place = -6.0 + 12.0 * (number % 100) / 100
        one = sample(first + number, place, label)
        kept.consider(replace(one, condition=condition), TRAINING)


@pytest.mark.parametrize("distinguished", [True, False])
def test_a_new_wind_at_the_same_place_does_not_overwrite_the_old_one(distinguished: bool) -> None:
    """Two winds over the same places: with one condition for both, only the labels of the second are left."""
    kept = buffer(capacity=200, refresh_age_s=1.0)
    wind(0, kept, 0, 1.0)
    before = kept.rows()
    wind(1 if distinguished else 0, kept, 1000, -1.0)
    rows = kept.rows()
    first = rows.take(rows.labels[:, 0, 0] > 0.0)
    if not distinguished:
        assert first.rows == 0
        return
    assert np.array_equal(first.time_ns, before.time_ns), "all that was stored is still there"
    assert np.ptp(rows.take(rows.labels[:, 0, 0] < 0.0).signals[:, SIGNAL_INDEX["position_n"]]) > 11.0
    wind(0, kept, 2000, 3.0)
    back = kept.rows()
    assert (back.labels[back.condition == 0, 0, 0] > 2.0).all(), "back in the first wind, its samples are refreshed"
    assert (back.labels[back.condition == 1, 0, 0] < 0.0).all()


def test_a_round_uses_another_winds_samples_only_where_the_present_one_has_none() -> None:
    kept = buffer(capacity=200)
    wind(0, kept, 0, 1.0)
    assert kept.rows_for(1).rows == kept.rows_for(0).rows == kept.count, "of a new wind nothing is known yet"
    for index in range(50):  # the new wind is met on the northern half only
        one = sample(1000 + index, 6.0 * index / 50, -1.0)
        kept.consider(replace(one, condition=1), TRAINING)
    rows = kept.rows_for(1)
    north = rows.signals[:, SIGNAL_INDEX["position_n"]]
    assert (rows.condition[north > 0.2] == 1).all()
    assert (rows.condition[north < -0.5] == 0).sum() > 5
    assert (rows.condition == 1).sum() == (kept.rows().condition == 1).sum()


@pytest.mark.parametrize("deletion", ["svd", "fifo"])
def test_a_full_buffer_gives_each_condition_its_share(deletion: str) -> None:
    kept = buffer(deletion=deletion)
    rng = np.random.default_rng(0)
    for condition in range(3):
        for number in range(300):
            one = sample(1000 * condition + number, float(rng.uniform(-20.0, 20.0)), float(condition))
            kept.consider(replace(one, condition=condition), TRAINING)
    assert np.bincount(kept.rows().condition).tolist() == [8, 8, 8]


def test_a_sample_that_lacks_a_label_does_not_replace_one_that_has_it() -> None:
    kept = buffer(refresh_age_s=1.0)
    assert kept.consider(sample(0, 1.0, 5.0), TRAINING)
    partly = sample(200, 1.0, 6.0)
    partly.labels[1] = np.nan
    assert not kept.consider(partly, TRAINING)
    assert kept.consider(sample(201, 1.0, 7.0), TRAINING)
    assert kept.rows().labels[:, 1, 0].tolist() == [7.0]
