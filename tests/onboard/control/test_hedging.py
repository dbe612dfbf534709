"""Pseudo-control hedging: limits stay out of the model error, and lag where that is asked; u_hat is what acted."""

from typing import Any

import numpy as np

from onboard.control.actuators import Delivered
from tests.onboard.control.fixture import AIRFRAME, FORCE, Rig, column, shipped_controller


def errors_of_a_great_step(hedging: str, name: str = "none", **disturbance: Any) -> tuple[Any, Any]:
    """Error e of both channels while the motors saturate: 2.6 m at once, and a quarter turn of yaw."""
    rig = Rig(shipped_controller(name, {"hedging": hedging}), **disturbance)
    rig.target, rig.yaw = np.array([1.5, -1.5, -2.5]), 1.5
    rows = rig.fly(2.0)
    return column(rows, "position_e"), column(rows, "attitude_e")


def test_hedging_of_all_keeps_saturation_lag_and_limits_out_of_both_errors() -> None:
    """Nothing is unknown here, so that e ought to stay zero: through tilt limit, motor limits, lag and dead time."""
    position, attitude = errors_of_a_great_step("all")
    assert np.abs(position[:, :3]).max() < 0.01
    assert np.abs(attitude[:, :3]).max() < 0.01


def test_without_hedging_the_limits_look_like_a_disturbance() -> None:
    position, attitude = errors_of_a_great_step("none")
    assert np.abs(position[:, :3]).max() > 0.3
    assert np.abs(attitude[:, :3]).max() > 0.1


def test_hedging_of_limits_leaves_the_lag_alone() -> None:
    """A step that no limit cuts: e has what lag and dead time cost. One that limits cut: e has no more than that."""
    rig = Rig(shipped_controller("none", {"hedging": "limits"}))
    rig.target = np.array([0.05, 0.0, -1.0])
    lag = np.abs(column(rig.fly(2.0), "position_e")[:, 0]).max()
    assert 0.002 < lag < 0.02
    (hedged, _), (unhedged, _) = errors_of_a_great_step("limits"), errors_of_a_great_step("none")
    assert np.abs(hedged[:, :3]).max() < 0.2 * np.abs(unhedged[:, :3]).max()


def test_the_errors_dynamics_are_the_same_in_saturation() -> None:
    """With a disturbance and no nu_ad, e follows e_dot = A_rm e - B Delta whether the motors saturate or not."""
    calm = Rig(shipped_controller("none"), FORCE)
    unsaturated = column(calm.fly(2.0), "position_e")
    saturated, _ = errors_of_a_great_step("all", force=FORCE)
    np.testing.assert_allclose(saturated, unsaturated, atol=0.05)
    np.testing.assert_allclose(unsaturated[-1, :3], -np.array(FORCE) / (16.0, 16.0, 25.0), rtol=0.05)


def test_u_hat_is_what_acted_over_the_tick_and_not_at_its_end() -> None:
    """A step of u puts half a tick times the step into e_2 if the two are confused; here u steps by 130 rad/s^2."""
    rig = Rig(shipped_controller("none"))
    rig.fly(0.1)
    rig.target = np.array([0.6, 0.0, -1.0])
    rates = column(rig.fly(0.3), "attitude_e")[:, 3:]
    assert np.abs(rates).max() < 0.05


def test_both_directions_of_the_attitude_dynamics_know_the_gyroscopic_torque() -> None:
    """Torque = J u + omega x J omega on the way out, and u_hat the reverse of it on the way in."""
    rig = Rig(shipped_controller("none", {"prediction": False}))
    rig.rates = np.array([6.0, -5.0, 9.0])
    J = np.diag(AIRFRAME.inertia_kg_m2)
    gyroscopic = np.cross(rig.rates, J @ rig.rates)
    torque = (1e-3, -2e-3, 3e-4)
    inputs = rig.inputs()
    for _ in range(2):  # u_hat is the mean of two ticks
        _, attitude = rig.uncertainty.step(inputs.state, [Delivered(np.zeros(4), 0.5, torque)])
    output = rig.controller.step(inputs)
    np.testing.assert_allclose(output.torque_nm, J @ output.attitude.demand + gyroscopic, rtol=1e-9)
    expected = np.linalg.solve(J, np.array(torque) - gyroscopic)
    np.testing.assert_allclose(attitude.u_hat, expected, rtol=1e-9)


def test_hedging_keeps_adaptation_from_learning_a_limit() -> None:
    def learnt(hedging: str) -> float:
        over: dict[str, Any] = {"hedging": hedging}
        for channel in ("position", "attitude"):
            over[channel] = {"augmentation": {"law": {"composite_gain": 0.0, "tracking_gain": 16.0}}}
        rig = Rig(shipped_controller("bias", over))
        rig.target = np.array([1.5, -1.5, -2.5])
        return float(np.abs(column(rig.fly(2.0), "position_nu")).max())

    assert learnt("all") < 0.1
    assert learnt("none") > 1.0
    assert learnt("limits") < 0.1 * learnt("none")
