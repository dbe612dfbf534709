"""The linear prediction: the textbook loops on the nominal vehicle, and stability on vehicles that differ from it."""

from math import inf

import numpy as np
import pytest

from configs.flight_tree import Choices
from experiments.flights.lockstep_flight import fly_lockstep
from experiments.flights.scenario import FlightConfig, resolve
from experiments.margins.linear import LinearModel, predicted_loop
from experiments.margins.requirement import LOOPS, OMEGA
from experiments.margins.stability import margins, unstable_poles
from protocol.conventions import Array

S = 1j * OMEGA
SETTINGS = "onboard.controller.settings"
LAW = {"pole": 15.0, "bandwidth": 10.0}
GAINS = (
    f"{SETTINGS}.position.gains.natural_frequency_rad_s=[4.9,4.9,5.0]",
    f"{SETTINGS}.position.gains.damping=0.7",
    f"{SETTINGS}.position.augmentation.predictor_pole_rad_s=4.4",
    f"{SETTINGS}.position.augmentation.bandwidth_rad_s=19.0",
    f"{SETTINGS}.attitude.gains.natural_frequency_rad_s=[12.8,12.8,5.0]",
    f"{SETTINGS}.attitude.gains.damping=1.3",
    f"{SETTINGS}.attitude.augmentation.predictor_pole_rad_s={LAW['pole']}",
    f"{SETTINGS}.attitude.augmentation.bandwidth_rad_s={LAW['bandwidth']}",
)
"""Of l1, whatever the search has found since."""
YAW_AS_ASSUMED = "vehicle.motors.torque_ratio_m=0.002414"
NO_SAG = ("vehicle.battery.resistance_ohm=0.0", "vehicle.battery.polarisation_ohm=0.0")
NO_SCALE = "onboard.thrust_scale.enabled=false"
SLUGGISH = (
    NO_SCALE,
    "vehicle.body.inertia_kg_m2=[8.6e-5,1.06e-4,1.47e-4]",
    "vehicle.motors.gain=[0.7,0.7,0.7,0.7]",
    "vehicle.motors.lag_up_s=0.06",
    "vehicle.motors.lag_down_s=0.06",
    "vehicle.motors.command_delay_s=0.01",
)


def l1(*assignments: str, duration_s: float = 20.0) -> FlightConfig:
    return resolve("figure8_wind", Choices("l1", 3, duration_s, (*GAINS, *assignments)))


def unstable(config: FlightConfig) -> list[tuple[int, int]]:
    model = LinearModel(config, OMEGA)
    return [loop for loop in LOOPS if unstable_poles(model.loop(*loop).characteristic)]


@pytest.mark.parametrize("prediction", [True, False])
def test_on_the_nominal_vehicle_the_law_cancels_out(prediction: bool) -> None:
    """Attitude: (L_0 e / (1 + L_0 (1 - e)) + H A e) / (1 - H A e), position: K T / s^2, all with one plant A e."""
    config = l1(YAW_AS_ASSUMED, f"{SETTINGS}.prediction={str(prediction).lower()}")
    A, delay = 1.0 / (1.0 + 0.02 * S), np.exp(-(0.005 + 1.5 * 0.005) * S)
    H = LAW["bandwidth"] / (S + LAW["bandwidth"])
    for axis, frequency in enumerate((12.8, 12.8, 5.0)):
        L_0 = (frequency**2 + 2.0 * 1.3 * frequency * S) * A / S**2
        feedback = L_0 * delay / (1.0 + L_0 * (1.0 - delay)) if prediction else L_0 * delay
        expected = (feedback + H * A * delay) / (1.0 - H * A * delay)
        np.testing.assert_allclose(predicted_loop(config, 1, axis, OMEGA), expected, rtol=1e-9)
    plant, K = A / S**2, 12.8**2 + 2.0 * 1.3 * 12.8 * S
    C = 12.8**2 + 2.0 * 1.3 * 12.8 * S / (1.0 + 0.03 * S)
    T = C * plant * delay / (1.0 + K * plant * (1.0 if prediction else delay))
    expected = (4.9**2 + 2.0 * 0.7 * 4.9 * S) * T / S**2
    np.testing.assert_allclose(predicted_loop(config, 0, 0, OMEGA), expected, rtol=1e-9)


def test_inertia_thrust_and_mass_act_as_gains() -> None:
    """Without the thrust scale. With it, the gain is divided by that of the lift, in both channels."""
    plain = resolve(choices=Choices("none", 3, 20.0, NO_SAG))

    def scaled_gain(channel: int, axis: int, *assignments: str) -> Array:
        changed = resolve(choices=Choices("none", 3, 20.0, (*NO_SAG, *assignments)))
        ratio: Array = predicted_loop(changed, channel, axis, OMEGA) / predicted_loop(plain, channel, axis, OMEGA)
        return ratio

    def gain(channel: int, axis: int, *assignments: str) -> Array:
        return scaled_gain(channel, axis, NO_SCALE, *assignments)

    weak = "vehicle.motors.gain=[0.7,0.7,0.7,0.7]"
    for axis in range(3):
        np.testing.assert_allclose(gain(1, axis, weak), 0.7, rtol=1e-9)
    np.testing.assert_allclose(gain(0, 2, weak, "vehicle.body.mass_kg=0.07"), 0.7 * 63.0 / 70.0, rtol=1e-9)
    for axis in range(3):
        np.testing.assert_allclose(scaled_gain(1, axis, weak, "vehicle.body.mass_kg=0.07"), 70.0 / 63.0, rtol=1e-9)
    np.testing.assert_allclose(scaled_gain(0, 2, weak, "vehicle.body.mass_kg=0.07"), 1.0, rtol=1e-9)
    beyond = "onboard.thrust_scale.least=0.8"
    np.testing.assert_allclose(scaled_gain(0, 2, weak, beyond), 0.7 / 0.8, rtol=1e-9)
    np.testing.assert_allclose(gain(1, 1, "vehicle.body.inertia_kg_m2=[1e-4,2e-4,3e-4]"), 0.716914 / 2.0, rtol=1e-9)
    np.testing.assert_allclose(gain(1, 2, YAW_AS_ASSUMED), 0.002414 / 0.003621, rtol=1e-9)
    late = gain(1, 0, "vehicle.motors.command_delay_s=0.01")
    np.testing.assert_allclose(late, np.exp(-0.01 * S), rtol=1e-9)


def test_the_delay_margin_is_the_delay_that_makes_the_loop_unstable() -> None:
    """Two ways to the same: the margin of L, and the count of unstable poles with a later command."""
    config = l1()
    margin_s = 1e-3 * min(margins(OMEGA, predicted_loop(config, 1, axis, OMEGA)).delay_margin_ms for axis in (0, 1))

    def unstable_attitude(delay_s: float) -> bool:
        late = l1(f"vehicle.motors.command_delay_s={delay_s}")
        return any(channel == 1 for channel, _ in unstable(late))

    assert not unstable(config)
    assert not unstable_attitude(0.97 * margin_s)
    assert unstable_attitude(1.03 * margin_s)


def test_a_law_that_is_unstable_alone_is_counted() -> None:
    """It cancels out of the position loop, but not out of the vehicle."""
    law = f"{SETTINGS}.position.augmentation.law"
    wild = resolve(choices=Choices("bias", assignments=(f"{law}.tracking_gain=9000.0", f"{law}.composite_gain=1.0")))
    assert (0, 0) in unstable(wild)


def test_a_vehicle_that_is_predicted_unstable_swings_or_is_lost_and_the_nominal_one_is_not() -> None:
    """The attitude loop is too slow for the position loop around it: only the latter is unstable."""
    sluggish, nominal = l1(*SLUGGISH, duration_s=14.0), l1(duration_s=14.0)
    assert unstable(sluggish) == [(0, 0), (0, 1)]
    assert not unstable(nominal)
    assert largest_error(sluggish) > 0.2
    assert largest_error(nominal) < 0.08


def largest_error(config: FlightConfig) -> float:
    """Horizontal, m, while the law adapts; infinite for a vehicle that is lost."""
    flight = fly_lockstep(config, with_offboard=False)
    if flight.crash_reason:
        return inf
    tick = flight.trace.tick
    errors = np.hypot(tick["position_n"] - tick["target_n"], tick["position_e"] - tick["target_e"])
    return float(errors[tick["adapting"] == 1.0].max())
