"""Labels: correct within noise, without delay, and never across a gap."""

from dataclasses import replace

import numpy as np
import pytest

from offboard.data.labels import LabelledSample, LabelMaker, smoothing_weights
from protocol.messages import SampleBatch
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.offboard.flights import PERIOD_NS, PERIOD_S, Flight, figure8_through_jet, offboard_config

LABELS = offboard_config(labels={"position_window_s": 0.28, "attitude_window_s": 0.2, "order": 2}).labels


def label_all(batches: list[SampleBatch], kind: str = "residual") -> list[LabelledSample]:
    maker = LabelMaker(LABELS.model_copy(update={"kind": kind}))
    return [sample for batch in batches for sample in maker.receive(batch)]


def errors(flight: Flight, samples: list[LabelledSample]) -> np.ndarray:
    return np.array([sample.labels - flight.delta[sample.index] for sample in samples])


def test_labels_recover_the_known_delta_within_noise() -> None:
    flight = figure8_through_jet(10.0, gust_m_s2=0.0)
    samples = label_all(flight.batches())
    assert len(samples) > 480
    rms = np.sqrt((errors(flight, samples) ** 2).mean(axis=0))
    assert rms[0].max() < 0.12  # of jet forces of 1 to 3 m/s^2, velocity noise 0.01 m/s
    assert rms[1].max() < 0.6  # of moments of about 10 rad/s^2, gyro noise 0.015 rad/s


def test_labels_are_exact_and_not_late_without_noise() -> None:
    """A Delta that is quadratic in time is reproduced exactly; a shift of half a period would show."""
    n = 60
    fine = 20
    t = np.arange(n * fine + 1) * (PERIOD_S / fine)
    delta = np.stack([1.0 + 2.0 * t, -3.0 * t + 4.0 * t**2, t**2], axis=1)
    velocity = np.stack([t + t**2, -1.5 * t**2 + 4.0 / 3.0 * t**3, t**3 / 3.0], axis=1)
    at = np.arange(fine, n * fine + 1, fine)
    signals = np.zeros((n, SIGNAL_COUNT))
    signals[:, SIGNAL_INDEX["velocity_n"] : SIGNAL_INDEX["velocity_d"] + 1] = velocity[at]
    signals[:, SIGNAL_INDEX["rate_p"] : SIGNAL_INDEX["rate_r"] + 1] = velocity[at]
    signals[:, SIGNAL_INDEX["position_d"]] = -1.0
    flight = Flight(signals, np.zeros((n, 2, 3)), np.repeat(delta[at][:, None], 2, axis=1))
    samples = label_all(flight.batches())
    worst = np.abs(errors(flight, samples)).max()
    assert worst < 2e-3  # float32 velocities, differenced over 20 ms


def test_delivered_acceleration_is_subtracted_exactly() -> None:
    """A rapidly varying u_hat changes nothing: it is averaged over the same period as the difference of v."""
    flight = figure8_through_jet(6.0, noise=0.0, gust_m_s2=0.0)
    rng = np.random.default_rng(3)
    kicks = rng.normal(0.0, 20.0, flight.delivered.shape)
    signals = flight.signals.copy()
    gained = np.cumsum(kicks, axis=0) * PERIOD_S
    signals[:, SIGNAL_INDEX["velocity_n"] : SIGNAL_INDEX["velocity_d"] + 1] += gained[:, 0]
    signals[:, SIGNAL_INDEX["rate_p"] : SIGNAL_INDEX["rate_r"] + 1] += gained[:, 1]
    kicked = Flight(signals, flight.delivered + kicks, flight.delta)
    calm, wild = label_all(flight.batches()), label_all(kicked.batches())
    difference = np.array([a.labels - b.labels for a, b in zip(calm, wild, strict=True)])
    assert np.abs(difference).max() < 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_no_window_spans_a_gap(seed: int) -> None:
    """The velocities jump by 50 m/s between the parts: a label across the gap would be very large."""
    rng = np.random.default_rng(seed)
    flight = figure8_through_jet(12.0, seed=seed)
    signals = flight.signals.copy()
    batches, lost = [], 0
    for batch in Flight(signals, flight.delivered, flight.delta).batches():
        if rng.random() < 0.15:
            lost += 1
            continue
        shifted = batch.signals.copy()
        shifted[:, SIGNAL_INDEX["velocity_n"] : SIGNAL_INDEX["velocity_d"] + 1] += 50.0 * (lost % 2)
        shifted[:, SIGNAL_INDEX["rate_p"] : SIGNAL_INDEX["rate_r"] + 1] += 50.0 * (lost % 2)
        batches.append(replace(batch, signals=shifted))
    samples = label_all(batches)
    assert lost > 10
    assert len(samples) > 0.5 * 5 * len(batches)
    worst = np.abs(errors(flight, samples)).max(axis=(0, 2))
    assert worst[0] < 1.5
    assert worst[1] < 6.0


def test_reordered_and_duplicate_batches_change_nothing() -> None:
    batches = figure8_through_jet(4.0).batches()
    shuffled = [batches[i] for pair in zip(range(1, 40, 2), range(0, 40, 2), strict=True) for i in (*pair, pair[0])]
    straight, mixed = label_all(batches), label_all(shuffled)
    assert [sample.index for sample in straight] == [sample.index for sample in mixed]
    assert all(np.array_equal(a.labels, b.labels) for a, b in zip(straight, mixed, strict=True))


def test_samples_on_the_ground_are_left_out_and_count_as_a_gap() -> None:
    flight = figure8_through_jet(6.0)
    signals = flight.signals.copy()
    signals[:100, SIGNAL_INDEX["position_d"]] = 0.0
    samples = label_all(Flight(signals, flight.delivered, flight.delta).batches())
    assert min(sample.index for sample in samples) > 100


def test_a_new_flight_discards_old_samples_and_distant_indices_take_no_time() -> None:
    maker = LabelMaker(LABELS)
    flight = figure8_through_jet(3.0)
    for batch in flight.batches(first_index=7_000_000_000):
        maker.receive(batch)
    maker.restart()
    ready = [sample for batch in flight.batches(first_index=0) for sample in maker.receive(batch)]
    assert ready[0].index < 12
    jumped = [sample for batch in flight.batches(first_index=2**40) for sample in maker.receive(batch)]
    assert len(jumped) > 120


def test_mrgen_labels_are_nu_ad_as_flown() -> None:
    flight = figure8_through_jet(3.0)  # its `adaptive` field contains the true Delta
    samples = label_all(flight.batches(), kind="mrgen")
    assert np.abs(errors(flight, samples)).max() < 1e-4


def test_times_and_weights() -> None:
    samples = label_all(figure8_through_jet(2.0).batches(time_ns=5 * 10**9))
    assert all(sample.time_ns == 5 * 10**9 + sample.index * PERIOD_NS for sample in samples)
    for left, right in ((5, 5), (2, 5), (6, 1)):
        c, gain = smoothing_weights(left, right, 2)
        assert c.sum() == pytest.approx(1.0)
        assert c @ (np.arange(-left, right) + 0.5) == pytest.approx(0.0, abs=1e-9)
        assert gain == pytest.approx(float(c @ c))


def test_a_channel_over_its_limit_does_not_cost_the_other_its_label_and_is_counted() -> None:
    flight = figure8_through_jet(6.0)
    wild = flight.delivered.copy()
    wild[100:150, 1] -= 1e4
    maker = LabelMaker(LABELS)
    samples = [s for batch in Flight(flight.signals, wild, flight.delta).batches() for s in maker.receive(batch)]
    calm = label_all(flight.batches())
    assert [sample.index for sample in samples] == [sample.index for sample in calm]
    without = [sample for sample in samples if np.isnan(sample.labels[1]).any()]
    assert {sample.index for sample in without} >= set(range(105, 145))
    assert all(np.array_equal(a.labels[0], b.labels[0]) for a, b in zip(samples, calm, strict=True))
    assert maker.unused["over_limit_attitude"] == len(without)
    assert maker.unused["over_limit_position"] == 0
    both = wild.copy()
    both[100:150, 0] -= 1e4
    none = label_all(Flight(flight.signals, both, flight.delta).batches())
    assert not {sample.index for sample in none} & set(range(105, 145)), "no label at all: no sample"


def test_a_channel_that_is_not_learnt_costs_and_counts_nothing() -> None:
    flight = figure8_through_jet(6.0)
    wild = flight.delivered.copy()
    wild[:, 1] -= 1e4
    maker = LabelMaker(LABELS, ("position",))
    samples = [s for batch in Flight(flight.signals, wild, flight.delta).batches() for s in maker.receive(batch)]
    assert len(samples) == len(label_all(flight.batches()))
    assert all(np.isnan(sample.labels[1]).all() for sample in samples)
    assert maker.unused["over_limit_attitude"] == maker.unused["gap_attitude"] == 0


@pytest.mark.parametrize("loss", [0.0, 0.2])
def test_every_sample_is_used_or_counted(loss: float) -> None:
    """Each channel: samples that arrived = labels + those over the limit + those at a gap; low ones apart."""
    rng = np.random.default_rng(3)
    flight = figure8_through_jet(12.0)
    signals, delivered = flight.signals.copy(), flight.delivered.copy()
    signals[:60, SIGNAL_INDEX["position_d"]] = 0.0
    delivered[200:230, 0] -= 1e4
    maker = LabelMaker(LABELS)
    batches = [b for b in Flight(signals, delivered, flight.delta).batches() if rng.random() >= loss]
    samples = [sample for batch in batches for sample in maker.receive(batch)]
    maker.receive(replace(batches[0], first_index=10**6))  # what still waits is skipped
    arrived = 5 * len(batches)
    low = sum(5 for batch in batches if batch.first_index < 60)
    assert maker.unused["low"] == low + 5
    for channel, name in enumerate(("position", "attitude")):
        labelled = sum(not np.isnan(sample.labels[channel]).any() for sample in samples)
        assert labelled + maker.unused[f"gap_{name}"] + maker.unused[f"over_limit_{name}"] == arrived - low
    assert maker.unused["over_limit_position"] >= 20
    assert (maker.unused["gap_attitude"] > 30) == (loss > 0.0)
    maker.receive(batches[-1])
    assert maker.unused["late"] == 5
