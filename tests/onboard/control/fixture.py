"""A nominal vehicle around a controller, perfectly known but for what a test adds: for laws that must hold exactly.

Motors are the onboard actuator model itself, sensing is exact, a command acts one tick after it was computed.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from configs.loader import CONFIG_DIRECTORY, fill, load, merge
from configs.parts import read_part
from configs.vehicle import read_vehicle
from onboard.control.actuators import ActuatorModel
from onboard.control.airframe import AirframeConfig
from onboard.control.interface import ControllerConfig
from onboard.control.mixer import Mixer
from onboard.control.records import ControlInputs, ControlOutput, Target
from onboard.control.uncertainty import UncertaintyMeasurement
from onboard.estimation.state import VehicleState
from onboard.flight.trajectory import PathPoint
from onboard.sampling.signal_vector import SignalVector
from protocol.conventions import GRAVITY
from protocol.feature_config import FeaturesConfig

DT = 0.005
FORCE, TORQUE = (0.5, -0.3, 0.8), (5.0, -4.0, 0.5)
SUBSTEPS = 5
REST = (0.0, 0.0, 0.0)
AIRFRAME = fill(AirframeConfig, read_vehicle("mambo").airframe, "mambo.yaml")
FEATURES = load(FeaturesConfig, CONFIG_DIRECTORY / "features.yaml")
RANDOM_START = FEATURES.model_copy(update={"untrained": FEATURES.untrained.model_copy(update={"start": "random"})})


def _both(position: dict[str, Any], attitude: dict[str, Any]) -> dict[str, Any]:
    return {"position": {"augmentation": position}, "attitude": {"augmentation": attitude}}


POLES = {
    "position": {"gains": {"natural_frequency_rad_s": [4.0, 4.0, 5.0], "damping": 0.8}},
    "attitude": {"gains": {"natural_frequency_rad_s": [16.0, 16.0, 5.0], "damping": 0.8}},
}
LAW = _both(
    {"law": {"tracking_gain": 5.0, "composite_gain": 10.0, "bias_weight": 40.0}},
    {"law": {"tracking_gain": 20.0, "composite_gain": 10.0, "bias_weight": 40.0}},
)
COVARIANCE = _both(
    {"law": {"tracking_gain": 5.0, "composite_gain": 10.0}}, {"law": {"tracking_gain": 20.0, "composite_gain": 10.0}}
)
OWN: dict[str, dict[str, Any]] = {
    "pid": _both({"gain": [16.0, 16.0, 30.0], "limit": 6.0}, {"gain": [600.0, 600.0, 20.0], "limit": 120.0}),
    "l1": _both(
        {"predictor_pole_rad_s": 10.0, "bandwidth_rad_s": 6.0}, {"predictor_pole_rad_s": 20.0, "bandwidth_rad_s": 15.0}
    ),
    "indi": _both({"filter_s": 0.1}, {"filter_s": 0.05}),
    "bias": LAW,
    "mrac": LAW,
    "dmrac": COVARIANCE,
}
"""Gains of these tests, whatever the search has written into the shipped files since."""


def controller_tree(name: str, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    """A shipped controller's file with the gains above, and settings laid over."""
    tree = read_part("controllers", name)
    over = merge(merge(POLES, OWN.get(name, {})), settings or {})
    return merge({"class": tree["class"], "settings": tree["settings"]}, {"settings": over})


def shipped_controller(name: str, settings: dict[str, Any] | None = None, features: FeaturesConfig = FEATURES) -> Any:
    """A shipped controller, built."""
    return fill(ControllerConfig, controller_tree(name, settings), name).build(AIRFRAME, features, seed=1)


class Rig:
    """The vehicle, its motors and its controller; `fly` runs them all."""

    def __init__(self, controller: Any, force: Any = REST, torque: Any = REST) -> None:
        """force, torque: Delta of the position [m/s^2, NED] and of the attitude channel [rad/s^2, body]."""
        self.controller = controller
        self.force, self.torque = np.array(force, dtype=float), np.array(torque, dtype=float)
        self.position, self.velocity = np.array([0.0, 0.0, -1.0]), np.zeros(3)
        self.attitude, self.rates = Rotation.identity(), np.zeros(3)
        self.jump = np.zeros(3)
        self.motors, self.belief = ActuatorModel(AIRFRAME, DT / SUBSTEPS), ActuatorModel(AIRFRAME, DT)
        hover = AIRFRAME.mass_kg * GRAVITY / 4.0
        self.motors.delivered.thrusts_n[:] = self.belief.delivered.thrusts_n[:] = hover
        self.uncertainty = UncertaintyMeasurement(AIRFRAME, DT)
        self.commands = [(hover / AIRFRAME.motor_thrust_max_n,) * 4]
        self.mixer, self.signals, self.state = Mixer(AIRFRAME), SignalVector(DT), VehicleState()
        self.target: Any = np.array([0.0, 0.0, -1.0])
        self.yaw = 0.0
        self.adapt, self.level_only, self.saturated = True, False, False
        self.specific_force = np.array([0.0, 0.0, -GRAVITY])
        self.output: ControlOutput = ControlOutput()

    def inputs(self, target: Target | None = None) -> ControlInputs:
        """What the controller is given now, with the rig's own target unless another is given."""
        self._sense()
        point = PathPoint(tuple(self.target), REST, REST)
        delivered = self.belief.delivered
        position, attitude = self.uncertainty.step(self.state, [delivered])
        signals = self.signals.step(self.state, delivered.thrusts_n, 3.7)
        return ControlInputs(
            dt=DT,
            state=self.state,
            target=target or Target(point, REST, point, point, self.yaw, point),
            signals=signals,
            position=position,
            attitude=attitude,
            saturated=self.saturated,
            adapt=self.adapt,
            coming=self.uncertainty.coming(self.state, delivered, self.belief.ahead(self.commands[0])),
            level_only=self.level_only,
        )

    def fly(
        self, seconds: float, target_at: Callable[[float], Target | None] = lambda _: None
    ) -> list[dict[str, np.ndarray]]:
        """Runs the loop; one row of telemetry a tick. `target_at`: of the time since the call, s."""
        rows = []
        for tick in range(round(seconds / DT)):
            self.output = self.controller.step(self.inputs(target_at(tick * DT)))
            rows.append(self._row())
            command = self.mixer.thrusts(self.output.thrust_n, self.output.torque_nm)
            self.saturated = abs(sum(command) - self.output.thrust_n) > 1e-3
            self.commands.append(tuple(thrust / AIRFRAME.motor_thrust_max_n for thrust in command))
            self._move(self.commands.pop(0))
        return rows

    def _sense(self) -> None:
        state = self.state
        state.position[:] = self.position + self.jump
        state.velocity[:] = self.velocity
        state.quaternion[:] = self.attitude.as_quat(scalar_first=True)
        state.rotation[:] = self.attitude.as_matrix()
        state.euler[:] = self.attitude.as_euler("ZYX")[::-1]
        state.rates[:] = self.rates
        state.specific_force[:] = self.specific_force
        state.tilt_rad = float(np.arccos(min(state.rotation[2, 2], 1.0)))

    def _row(self) -> dict[str, np.ndarray]:
        row = {"position": self.position.copy(), "velocity": self.velocity.copy(), "rates": self.rates.copy()}
        for name in ("position", "attitude"):
            telemetry = getattr(self.output, name)
            row[f"{name}_e"], row[f"{name}_nu"] = telemetry.error.copy(), telemetry.adaptive.copy()
        return row

    def _move(self, command: Any) -> None:
        """One tick under a motor command, in shares of the maximum thrust."""
        jx, jy, jz = AIRFRAME.inertia_kg_m2
        J, dt = np.array([jx, jy, jz]), DT / SUBSTEPS
        force = np.zeros(3)
        for _ in range(SUBSTEPS):
            _, thrust, torque = self.motors.step(command)
            pushed = -thrust / AIRFRAME.mass_kg * self.attitude.as_matrix()[:, 2] + self.force
            force += pushed / SUBSTEPS
            acceleration = pushed + np.array([0.0, 0.0, GRAVITY])
            turning = (np.array(torque) - np.cross(self.rates, J * self.rates)) / J + self.torque
            self.position += dt * self.velocity + 0.5 * dt * dt * acceleration
            self.velocity += dt * acceleration
            self.attitude = self.attitude * Rotation.from_rotvec(dt * (self.rates + 0.5 * dt * turning))
            self.rates = self.rates + dt * turning
        self.belief.step(command)
        self.specific_force = self.attitude.as_matrix().T @ force


def column(rows: list[dict[str, Any]], name: str) -> Any:
    return np.array([row[name] for row in rows])
