"""An axis of the gyroscope that is stuck: found by its repeats, and replaced by a rate from the motors."""

import numpy as np
import pytest

from onboard.estimation.config import EstimatorConfig
from onboard.estimation.stuck_gyro import StuckGyro

DT = 0.005
STEP = 0.00106
"""rad/s, of the Mambo's gyroscope."""
DEFAULTS = EstimatorConfig()


def guard(samples=DEFAULTS.gyro_stuck_samples):
    return StuckGyro(samples, DEFAULTS.gyro_stuck_disturbance_s)


def noise(count, sigma=0.1, seed=0, mean=(0.0, 0.0, 0.0)):
    """[count, 3] quantised rates."""
    rng = np.random.default_rng(seed)
    return np.round((np.array(mean) + sigma * rng.standard_normal((count, 3))) / STEP) * STEP


def fed(gyro, rates, accelerometer=None):
    """What was found with each sample."""
    if accelerometer is None:
        accelerometer = np.random.default_rng(1).standard_normal((len(rates), 3))
    return [
        gyro.receive(tuple(map(float, rate)), tuple(map(float, force)), DT)
        for rate, force in zip(rates, accelerometer, strict=True)
    ]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("value", [None, 0.0])
def test_an_axis_that_repeats_its_value_is_found_within_30_ms(axis, value):
    rates = noise(200)
    rates[150:, axis] = rates[149, axis] if value is None else value
    gyro = guard()
    found = fed(gyro, rates)
    first = next(k for k, one in enumerate(found) if one)
    assert [one.axis for one in found[first]] == [axis]
    assert 150 <= first <= 150 + 5
    assert sum(map(len, found)) == 1
    assert gyro.axes == [axis]


def test_without_a_limit_nothing_is_found():
    rates = noise(200)
    rates[150:, 0] = 0.0
    assert not any(fed(guard(0), rates))


@pytest.mark.parametrize("sigma", [0.2, 0.1, 0.05, 0.02, 0.005, 0.002, 0.0])
def test_a_gyroscope_that_repeats_values_by_chance_is_not_stuck(sigma):
    assert not any(fed(guard(), noise(20_000, sigma, seed=2)))


def test_a_limit_that_ignores_the_repeats_before_would_take_chance_for_a_fault(monkeypatch):
    monkeypatch.setattr(StuckGyro, "_limit", lambda self, axis: self._needed)
    assert any(fed(guard(), noise(20_000, 0.002, seed=2)))


def test_the_whole_imu_repeated_is_left_to_the_link():
    rates, force = noise(200), np.random.default_rng(1).standard_normal((200, 3))
    rates[150:], force[150:] = rates[149], force[149]
    assert not any(fed(guard(), rates, force))


def test_it_is_judged_in_flight_only():
    rates = noise(200)
    rates[150:, 1] = 0.0
    gyro = guard()
    for rate in rates[:160]:
        assert not gyro.receive(tuple(rate), (0.0, 0.0, rate[0]), DT, flying=False)
    found = [gyro.receive(tuple(rate), (0.0, 0.0, rate[0]), DT) for rate in rates[160:]]
    assert any(found)


def test_on_the_floor_it_is_believed_again():
    rates = noise(200)
    rates[150:, 1] = 0.0
    gyro = guard()
    fed(gyro, rates)
    gyro.reset()
    assert gyro.axes == []
    assert gyro.replaced((1.0, 2.0, 3.0)) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize("value", [None, 0.0])
def test_the_rate_follows_the_motors_from_the_last_good_sample_on(value):
    """A turn at a growing rate about x: 2 rad/s^2 by the motors, 1 by a disturbance."""
    count, begin = 400, 300
    truth = 3.0 * DT * np.arange(count)
    rates = noise(count, 0.002)
    rates[:, 0] = truth + 1e-9 * np.arange(count)
    rates[begin:, 0] = rates[begin - 1, 0] if value is None else value
    gyro, turns, last = guard(), [], 0.0
    for k, rate in enumerate(rates):
        turns += gyro.receive(tuple(rate), (0.0, 0.0, 0.01 * k), DT)
        used = gyro.replaced(tuple(rate))[0]
        gyro.expect((2.0, 0.0, 0.0), ((used - last) / DT - 2.0, 0.0, 0.0), DT)
        last = used
    assert gyro.replaced(tuple(rates[-1]))[0] == pytest.approx(truth[-1], abs=0.05)
    missed = (truth - rates[:, 0])[begin - (value is None) : begin - (value is None) + 6].sum() * DT
    assert turns[0].turn_rad == pytest.approx(missed, abs=0.002)


def test_the_present_bias_turns_the_attitudes_since_a_time():
    gyro = guard()
    for k in range(10):
        gyro.note_bias((0.1, 0.0, -0.2), k * 5_000_000, DT)
    assert gyro.turn_since(20_000_000, (0.0, 0.0, 0.0)) == pytest.approx((5 * DT * 0.1, 0.0, -5 * DT * 0.2))
    assert gyro.turn_since(45_000_000, (0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
