"""The thrust scale: what it converges to, alone and in flight, and what it leaves to the laws without it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from configs.loader import ConfigError
from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from onboard.control.thrust_scale import ThrustScale, ThrustScaleConfig
from protocol.conventions import GRAVITY, Array
from tests.onboard.control.fixture import AIRFRAME, DT

CONFIG = ThrustScaleConfig()
HOVER_N = AIRFRAME.mass_kg * GRAVITY


def learn(scale: ThrustScale, gain: float, seconds: float, load: float = 1.0, adapt: bool = True) -> Array:
    """k after each tick of a vehicle whose motors give `gain`; load: thrust of the nominal motors over weight."""
    values = []
    for _ in range(round(seconds / DT)):
        scale.step(-gain * load * GRAVITY, scale.value * load * HOVER_N, adapt)
        values.append(scale.value)
    return np.array(values)


def test_it_converges_with_the_time_constants_that_are_set() -> None:
    """An error left by t falls as 1 / (t + start) at first, and as exp(-t / tau) in the end."""
    values = learn(ThrustScale(CONFIG, AIRFRAME, DT), 0.7, 10.0)
    assert values[-1] == pytest.approx(0.7, abs=1e-3)
    left = (values - 0.7) / 0.3
    assert left[round(0.15 / DT)] == pytest.approx(0.3 / 0.45, abs=0.03)
    late = math.log(left[round(4.0 / DT)] / left[round(5.5 / DT)])
    assert late == pytest.approx(1.0, abs=0.05)
    assert np.all(np.diff(values) < 0.0), "no overshoot"


@pytest.mark.parametrize(("gain", "end"), [(0.2, 0.5), (3.0, 1.3)])
def test_it_stays_within_its_limits(gain: float, end: float) -> None:
    values = learn(ThrustScale(CONFIG, AIRFRAME, DT), gain, 10.0)
    assert values[-1] == end
    assert values.min() >= CONFIG.least
    assert values.max() <= CONFIG.greatest


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.floats(allow_nan=True), st.floats(0.0, 10.0)), max_size=100))
def test_no_reading_brings_it_out_of_its_limits(readings: list[tuple[float, float]]) -> None:
    scale = ThrustScale(CONFIG, AIRFRAME, DT)
    for specific_force, thrust in readings:
        scale.step(specific_force, thrust, True)
        assert CONFIG.least <= scale.value <= CONFIG.greatest


def test_it_learns_only_in_flight_and_under_thrust() -> None:
    scale = ThrustScale(CONFIG, AIRFRAME, DT)
    assert np.all(learn(scale, 0.7, 2.0, adapt=False) == 1.0)
    learnt = learn(scale, 0.7, 2.0, load=0.3)
    assert np.all(learnt[1:] == learnt[0]), "after the mean with the thrust of the last tick"
    assert learn(scale, 0.7, 5.0)[-1] < 0.75
    scale.reset()
    assert scale.value == 1.0


def test_the_mean_of_a_noisy_force_counts() -> None:
    rng, scale = np.random.default_rng(1), ThrustScale(CONFIG, AIRFRAME, DT)
    values = []
    for _ in range(4000):
        scale.step(-0.8 * GRAVITY + 3.0 * rng.standard_normal(), scale.value * HOVER_N, True)
        values.append(scale.value)
    settled = np.array(values[1500:])
    assert settled.mean() == pytest.approx(0.8, abs=0.01)
    white = 3.0 / GRAVITY * math.sqrt(DT / (2.0 * CONFIG.time_constant_s))  # of a first-order filter
    assert settled.std() < 2.0 * white


@pytest.mark.parametrize(
    ("assignment", "key"),
    [
        ("least=1.2", "least"),
        ("greatest=0.9", "greatest"),
        ("time_constant_s=0.0", "time_constant_s"),
        ("start_time_constant_s=2.0", "start_time_constant_s"),
        ("thrust_min_share=1.0", "thrust_min_share"),
    ],
)
def test_bad_settings_are_refused(assignment: str, key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        resolve(choices=Choices("l1", assignments=(f"onboard.thrust_scale.{assignment}",)))


def fly(*assignments: str) -> LockstepOutcome:
    flight = fly_lockstep(resolve("hover", Choices("l1", 3, 9.0, assignments)), with_offboard=False)
    assert not flight.crash_reason
    return flight


def motors(share: float) -> str:
    return f"vehicle.motors.gain=[{share}, {share}, {share}, {share}]"


OTHERS = (
    ((motors(0.75),), 0.75),
    ((motors(0.85), "vehicle.body.mass_kg=0.07"), 0.85 * 63.0 / 70.0),
    (("vehicle.body.mass_kg=0.055",), 63.0 / 55.0),
)


@pytest.mark.parametrize(("vehicle", "expected"), OTHERS)
def test_in_flight_it_becomes_gain_over_mass(vehicle: tuple[str, ...], expected: float) -> None:
    """The rated battery voltage, at which the gain holds, is about that of a full battery under load."""
    tick = fly(*vehicle).trace.tick
    ground = tick["adapting"] == 0.0
    assert np.all(tick["thrust_scale"][: int(np.argmin(ground)) + 1] == 1.0), "not on the ground"
    nominal = fly().trace.tick["thrust_scale"][-1]
    assert nominal == pytest.approx(1.0, abs=0.15)
    assert tick["thrust_scale"][-1] / nominal == pytest.approx(expected, rel=0.04)


def test_it_takes_over_what_the_motors_lack_and_without_it_the_law_bears_it() -> None:
    """The ablation: the vertical nu_ad of l1 over the last 2 s, m/s^2. It is the residual, low-passed."""
    borne = []
    for enabled in ("true", "false"):
        tick = fly(motors(0.75), f"onboard.thrust_scale.enabled={enabled}").trace.tick
        borne.append(float(tick["position_adaptive_now_d"][-400:].mean()))
        assert bool(tick["thrust_scale"][-1] == 1.0) is (enabled == "false")
    assert abs(borne[0]) < 0.3
    assert borne[1] > 1.5
