"""The cascade all built-in controllers share: position over attitude, each with its augmentation.

    position:  u = K_r r - K x - nu_ad     -> thrust and attitude command
    attitude:  u = K_1 e_R - K_2 omega - nu_ad -> torque = J u + omega x J omega

Order within a step (k): the reference models advance with what was commanded at k-1 and delivered since; then
residual, error and augmentation at the present; then the command.
"""

from math import tan
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from configs.loader import Record
from onboard.airframe import GRAVITY, AirframeConfig
from onboard.control_records import ControlInputs, ControlOutput
from onboard.controllers.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.controllers.augmentation import Augmentation, ChannelState
from onboard.controllers.baselines import (
    L1,
    Indi,
    IndiConfig,
    Integral,
    IntegralConfig,
    L1Config,
    NoAugmentation,
    NoneConfig,
)
from onboard.reference_model import AttitudeReferenceModel, ChannelGains, PositionReferenceModel
from onboard.rotation import attitude_for_thrust, quaternion_multiply, quaternion_to_rotation_vector
from protocol.feature_set import FeatureSet
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

Array = NDArray[np.float64]
Vector3 = tuple[float, float, float]
AugmentationConfig = Annotated[
    NoneConfig | IntegralConfig | L1Config | IndiConfig | AdaptiveConfig, Field(discriminator="kind")
]

POSITION = slice(SIGNAL_INDEX["position_n"], SIGNAL_INDEX["position_d"] + 1)
VELOCITY = slice(SIGNAL_INDEX["velocity_n"], SIGNAL_INDEX["velocity_d"] + 1)
BODY_VELOCITY = slice(SIGNAL_INDEX["body_velocity_x"], SIGNAL_INDEX["body_velocity_z"] + 1)
MODEL_ERROR_MAX_RAD = 0.6
"""Beyond this the attitude error is no longer linear: the reference model starts over at the vehicle."""


class ChannelSettings(Record):
    """One channel: its poles and its augmentation."""

    gains: ChannelGains
    augmentation: AugmentationConfig


class CascadeSettings(Record):
    """The whole cascade."""

    position: ChannelSettings
    attitude: ChannelSettings
    hedging: Annotated[bool, Field(description="pseudo-control hedging of both reference models")] = True
    position_error_max_m: Annotated[float, Field(gt=0, le=10)] = 1.5
    tilt_max_rad: Annotated[float, Field(gt=0.1, le=1.2)] = 0.7
    climb_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=20)] = 5.0
    sink_acceleration_max_m_s2: Annotated[float, Field(gt=0, le=9)] = 5.0
    level_sink_speed_m_s: Annotated[float, Field(gt=0, le=1)] = 0.4


def _augmentation(settings: ChannelSettings, rng: np.random.Generator) -> Augmentation:
    config = settings.augmentation
    match config:
        case AdaptiveConfig():
            return AdaptiveAugmentation(config, settings.gains, rng)
        case IntegralConfig():
            return Integral(config)
        case L1Config():
            return L1(config)
        case IndiConfig():
            return Indi(config)
        case NoneConfig():
            return NoAugmentation(config)


class CascadedController:
    """PID, MRAC, DMRAC, L1 and INDI, by its settings."""

    Settings = CascadeSettings

    def __init__(self, settings: CascadeSettings, airframe: AirframeConfig, seed: int) -> None:
        self._settings = settings
        self._airframe = airframe
        rng = np.random.default_rng([seed, 101])
        self._augmentations = (_augmentation(settings.position, rng), _augmentation(settings.attitude, rng))
        self._position_model = PositionReferenceModel(settings.position.gains)
        self._attitude_model = AttitudeReferenceModel(settings.attitude.gains)
        self._k1, self._k2 = settings.position.gains.stiffness(), settings.position.gains.rate_gain()
        self._a1 = tuple(settings.attitude.gains.stiffness().tolist())
        self._a2 = tuple(settings.attitude.gains.rate_gain().tolist())
        self._channels = (ChannelState(), ChannelState())
        self._signals: Array = np.zeros((SIGNAL_COUNT, 2))
        for channel in self._channels:
            channel.signals = self._signals
        self._output = ControlOutput()
        self._command: Array = np.zeros(3)
        self._last_rates: Array = np.zeros(3)
        self._last_delivered = (0.0, 0.0, 0.0, 0.0)
        self._turn_command: Vector3 = (0.0, 0.0, 0.0)
        self._resets_seen = 0
        self._running = False

    # --- the interface -------------------------------------------------------------------------------------------

    def step(self, inputs: ControlInputs) -> ControlOutput:
        """One step of both loops."""
        self._take_in(inputs)
        self._advance_models(inputs)
        acceleration = self._position_loop(inputs)
        thrust, commanded = self._thrust_vector(inputs, acceleration)
        self._output.thrust_n = thrust
        self._output.commanded_quaternion = commanded
        self._output.torque_nm = self._attitude_loop(inputs, commanded)
        self._last_rates[:] = inputs.state.rates
        return self._output

    def reset(self, inputs: ControlInputs) -> None:
        """Reference models to the vehicle's state, integrals and filters to zero."""
        state = inputs.state
        self._restart_models(inputs)
        self._last_rates[:] = state.rates
        for augmentation in self._augmentations:
            augmentation.reset()

    @property
    def accepts_features(self) -> bool:
        """Whether a channel has network features."""
        return any(isinstance(one, AdaptiveAugmentation) and one.learns for one in self._augmentations)

    def offer_features(self, features: FeatureSet) -> str:
        """Swaps both channels in one tick, or refuses."""
        plans = []
        for augmentation, channel in zip(self._augmentations, (features.position, features.attitude), strict=True):
            if channel is None or not isinstance(augmentation, AdaptiveAugmentation) or not augmentation.learns:
                continue
            new, plan = augmentation.plan(channel)
            if plan.refusal:
                return plan.refusal
            plans.append((augmentation, new, plan, channel.last_layer))
        if not plans:
            return "not_accepting"
        for augmentation, new, plan, memory in plans:
            augmentation.commit(new, plan, memory)
        return ""

    def last_layers(self) -> tuple[Array | None, Array | None]:
        """W [k, 3] of the position and the attitude channel; None for a channel without."""
        position, attitude = (
            one.last_layer.W.copy() if isinstance(one, AdaptiveAugmentation) else None for one in self._augmentations
        )
        return position, attitude

    def start_from(self, last_layers: tuple[Array | None, Array | None]) -> None:
        """Takes over W of an earlier flight with the same features; raises ValueError if the shapes differ."""
        for augmentation, W in zip(self._augmentations, last_layers, strict=True):
            if W is None or not isinstance(augmentation, AdaptiveAugmentation):
                continue
            if W.shape != augmentation.last_layer.W.shape:
                raise ValueError(
                    f"last layer of shape {W.shape}, this controller's is {augmentation.last_layer.W.shape}"
                )
            augmentation.last_layer.replace(W, W)

    # --- taking in -----------------------------------------------------------------------------------------------

    def _take_in(self, inputs: ControlInputs) -> None:
        state, target = inputs.state, inputs.target
        position, attitude = self._channels
        for channel in self._channels:
            channel.dt, channel.adapt, channel.saturated = inputs.dt, inputs.adapt, inputs.saturated
        # u_hat and Delta of the position channel: what thrust and attitude really give, against the accelerometer.
        down = state.rotation[:, 2]
        thrust, torque = self._mean_delivered(inputs)
        thrust_acceleration = thrust / self._airframe.mass_kg
        np.multiply(down, -thrust_acceleration, out=position.delivered)
        np.subtract(state.rotation @ state.specific_force, position.delivered, out=position.residual_raw)
        position.delivered[2] += GRAVITY
        position.rate[:] = state.velocity
        # The same of the attitude channel: torque by the actuator model against the gyroscope's derivative.
        attitude.delivered[:] = self._angular_acceleration(torque, state.rates)
        np.subtract(state.rates, self._last_rates, out=attitude.residual_raw)
        attitude.residual_raw /= inputs.dt
        attitude.residual_raw -= attitude.delivered
        attitude.rate[:] = state.rates
        self._look_ahead(inputs)
        # Tracking error of the position channel, bounded so that a far target asks for no more than a near one.
        error = position.tracking_error
        limit = self._settings.position_error_max_m
        error[:3] = target.now.position
        error[:3] -= state.position
        np.minimum(np.maximum(error[:3], -limit, out=error[:3]), limit, out=error[:3])
        error[3:] = target.now.velocity
        error[3:] -= state.velocity

    def _mean_delivered(self, inputs: ControlInputs) -> tuple[float, Vector3]:
        """Thrust [N] and torque [N m] over the tick that has just ended: that is what moved the vehicle since."""
        was, now = self._last_delivered, (inputs.delivered_thrust_n, *inputs.delivered_torque_nm)
        self._last_delivered = now
        thrust, roll, pitch, yaw = (0.5 * (a + b) for a, b in zip(was, now, strict=True))
        return thrust, (roll, pitch, yaw)

    def _angular_acceleration(self, torque: Vector3, rates: Array) -> Vector3:
        """J^-1 (tau - omega x J omega), rad/s^2."""
        jx, jy, jz = self._airframe.inertia_kg_m2
        p, q, r = rates.tolist()
        return (
            (torque[0] - (jz - jy) * q * r) / jx,
            (torque[1] - (jx - jz) * p * r) / jy,
            (torque[2] - (jy - jx) * p * q) / jz,
        )

    def _look_ahead(self, inputs: ControlInputs) -> None:
        """x_ahead = x + (x_d(t + t_ahead) - x_d(t))."""
        signals, target = self._signals, inputs.target
        signals[:, 0] = inputs.signals
        ahead = signals[:, 1]
        ahead[:] = inputs.signals
        ahead[POSITION] += target.ahead.position
        ahead[POSITION] -= target.now.position
        ahead[VELOCITY] += target.ahead.velocity
        ahead[VELOCITY] -= target.now.velocity
        ahead[BODY_VELOCITY] = ahead[VELOCITY] @ inputs.state.rotation

    # --- reference models ----------------------------------------------------------------------------------------

    def _advance_models(self, inputs: ControlInputs) -> None:
        state = inputs.state
        if not inputs.adapt or not self._running:
            self._restart_models(inputs)
            self._running = inputs.adapt
            return
        if state.position_reset_count != self._resets_seen and not self._follow_jump(inputs):
            return
        position, attitude = self._channels
        hedge = self._output.position.demand - position.delivered if self._settings.hedging else np.zeros(3)
        self._position_model.step(self._command, hedge, inputs.dt)
        position.model_error[:3] = self._position_model.position - state.position
        position.model_error[3:] = self._position_model.velocity - state.velocity
        turn = self._output.attitude.demand - attitude.delivered if self._settings.hedging else np.zeros(3)
        hp, hq, hr = turn.tolist()
        self._attitude_model.step(self._turn_command, (hp, hq, hr), inputs.dt)
        self._attitude_model.error(state.quaternion, state.rates, attitude.model_error)
        if float(attitude.model_error[:3] @ attitude.model_error[:3]) > MODEL_ERROR_MAX_RAD**2:
            self._attitude_model.reset(state.quaternion, state.rates)
            attitude.model_error[:] = 0.0

    def _follow_jump(self, inputs: ControlInputs) -> bool:
        """A jump of the estimate is no motion: the references jump along (True), or start over where they cannot."""
        state = inputs.state
        if state.position_reset_count != self._resets_seen + 1 or state.yaw_jump != 0.0:
            self._restart_models(inputs)  # the frame has turned, or the size of a jump in between is not known
            return False
        self._position_model.shift(state.position_jump)
        self._command += self._k1 * state.position_jump
        self._resets_seen = state.position_reset_count
        return True

    def _restart_models(self, inputs: ControlInputs) -> None:
        state = inputs.state
        self._position_model.reset(state.position, state.velocity)
        self._attitude_model.reset(state.quaternion, state.rates)
        self._resets_seen = state.position_reset_count
        for channel in self._channels:
            channel.model_error[:] = 0.0

    # --- the loops -----------------------------------------------------------------------------------------------

    def _position_loop(self, inputs: ControlInputs) -> Array:
        """U of the position channel [3], m/s^2."""
        channel, telemetry = self._channels[0], self._output.position
        nu = self._augmentations[0].step(channel, telemetry)
        u = telemetry.demand
        np.multiply(self._k1, channel.tracking_error[:3], out=u)
        u += self._k2 * channel.tracking_error[3:]
        u += inputs.target.feed_forward
        u -= nu
        if inputs.level_only:
            u[:2] = 0.0
            u[2] = self._k2[2] * (self._settings.level_sink_speed_m_s - channel.rate[2]) - nu[2]
        # K_r r as the reference model needs it: u = K_r r - K x - nu_ad. Here nu_ad is that of the present state, which
        # the law weighs e with; what the look-ahead adds counts as part of the command.
        self._command = u + self._k1 * inputs.state.position + self._k2 * inputs.state.velocity + telemetry.adaptive_now
        telemetry.error[:] = channel.model_error
        telemetry.delivered[:] = channel.delivered
        telemetry.adaptive[:] = nu
        return u

    def _thrust_vector(self, inputs: ControlInputs, u: Array) -> tuple[float, tuple[float, float, float, float]]:
        """Collective thrust [N] along the present body axis, and the attitude that would realise u, within limits."""
        settings = self._settings
        ux, uy, uz = u.tolist()
        uz = min(max(uz, -settings.climb_acceleration_max_m_s2), settings.sink_acceleration_max_m_s2)
        fx, fy, fz = -ux, -uy, GRAVITY - uz
        horizontal = (fx * fx + fy * fy) ** 0.5
        most = fz * tan(settings.tilt_max_rad)
        if horizontal > most:
            fx, fy = fx * most / horizontal, fy * most / horizontal
        norm = (fx * fx + fy * fy + fz * fz) ** 0.5
        commanded = attitude_for_thrust((fx / norm, fy / norm, fz / norm), inputs.target.yaw_rad)
        r02, r12, r22 = inputs.state.rotation[:, 2].tolist()
        thrust = self._airframe.mass_kg * (fx * r02 + fy * r12 + fz * r22)
        return max(thrust, 0.0), commanded

    def _attitude_loop(self, inputs: ControlInputs, commanded: tuple[float, float, float, float]) -> Vector3:
        """Body torque [N m]."""
        channel, telemetry = self._channels[1], self._output.attitude
        state = inputs.state
        w, x, y, z = state.quaternion.tolist()
        ex, ey, ez = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded))
        ez = min(max(ez, -0.5), 0.5)
        p, q, r = state.rates.tolist()
        error = channel.tracking_error
        error[0], error[1], error[2], error[3], error[4], error[5] = ex, ey, ez, -p, -q, -r
        nu = self._augmentations[1].step(channel, telemetry)
        n1, n2, n3 = nu.tolist()
        k1, k2 = self._a1, self._a2
        ap = k1[0] * ex - k2[0] * p - n1
        aq = k1[1] * ey - k2[1] * q - n2
        ar = k1[2] * ez - k2[2] * r - n3
        demand = telemetry.demand
        demand[0], demand[1], demand[2] = ap, aq, ar
        telemetry.error[:] = channel.model_error
        telemetry.delivered[:] = channel.delivered
        telemetry.adaptive[:] = nu
        m1, m2, m3 = telemetry.adaptive_now.tolist()
        self._turn_command = (ap + m1, aq + m2, ar + m3)
        jx, jy, jz = self._airframe.inertia_kg_m2
        return (jx * ap + (jz - jy) * q * r, jy * aq + (jx - jz) * p * r, jz * ar + (jy - jx) * p * q)
