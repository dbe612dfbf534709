"""The cascade all built-in controllers share: position over attitude, each with its augmentation.

    position:  u = K_r r - K x - nu_ad     -> thrust and attitude command
    attitude:  u = K_1 e_R - K_2 omega - nu_ad -> torque = J u + omega x J omega

Order within a step (k): the reference models advance with what was commanded at k-1 and delivered since; then
residual, error and augmentation at the present; then the command.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.airframe import GRAVITY, AirframeConfig
from onboard.control.demand_limits import DemandLimits, DemandLimitsConfig
from onboard.control.laws.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.control.laws.indi import Indi, IndiConfig
from onboard.control.laws.integral import Integral, IntegralConfig
from onboard.control.laws.l1 import L1, L1Config
from onboard.control.laws.law import Augmentation, ChannelState
from onboard.control.laws.none import NoAugmentation, NoneConfig
from onboard.control.records import ChannelTelemetry, ControlInputs, ControlOutput
from onboard.control.reference_model import AttitudeReferenceModel, ChannelGains, PositionReferenceModel
from onboard.estimation.state import VehicleState
from onboard.flight.trajectory import PathPoint
from protocol.conventions import Array
from protocol.feature_set import FeatureSet
from protocol.geometry import (
    Quaternion,
    Vector3,
    attitude_for_thrust,
    quaternion_multiply,
    quaternion_to_rotation_vector,
)
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

AugmentationConfig = Annotated[
    NoneConfig | IntegralConfig | L1Config | IndiConfig | AdaptiveConfig, Field(discriminator="kind")
]

POSITION_N = SIGNAL_INDEX["position_n"]
VELOCITY_N = SIGNAL_INDEX["velocity_n"]
BODY_VELOCITY_X = SIGNAL_INDEX["body_velocity_x"]
"""The other two axes follow."""
MODEL_ERROR_MAX_RAD = 0.6
"""Beyond this the attitude error is no longer linear: the reference model starts over at the vehicle."""


class ChannelSettings(ConfigRecord):
    """One channel: its poles and its augmentation."""

    gains: ChannelGains
    augmentation: AugmentationConfig


class CascadeSettings(ConfigRecord):
    """The whole cascade."""

    position: ChannelSettings
    attitude: ChannelSettings
    hedging: Annotated[bool, Field(description="pseudo-control hedging of both reference models")] = True
    position_error_max_m: Annotated[float, Field(gt=0, le=10)] = 1.5
    limits: DemandLimitsConfig = DemandLimitsConfig()
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
        self.augmentations = (_augmentation(settings.position, rng), _augmentation(settings.attitude, rng))
        """Of the position and of the attitude channel."""
        self._has_features = any(isinstance(one, AdaptiveAugmentation) for one in self.augmentations)
        self._position_model = PositionReferenceModel(settings.position.gains)
        self._attitude_model = AttitudeReferenceModel(settings.attitude.gains)
        self._k1 = tuple(settings.position.gains.stiffness().tolist())
        self._k2 = tuple(settings.position.gains.rate_gain().tolist())
        self._a1 = tuple(settings.attitude.gains.stiffness().tolist())
        self._a2 = tuple(settings.attitude.gains.rate_gain().tolist())
        self._limits = DemandLimits(settings.limits)
        self._output = ControlOutput()
        self._channels = (self._channel(self._output.position), self._channel(self._output.attitude))
        self._command: Vector3 = (0.0, 0.0, 0.0)
        self._last_rates: Vector3 = (0.0, 0.0, 0.0)
        self._last_delivered = (0.0, 0.0, 0.0, 0.0)
        self._turn_command: Vector3 = (0.0, 0.0, 0.0)
        self._resets_seen = 0
        self._running = False

    def _channel(self, telemetry: ChannelTelemetry) -> ChannelState:
        """A channel whose model error and delivered u_hat are reported as they are: the arrays are the telemetry's."""
        signals = np.zeros((SIGNAL_COUNT, 2))
        return ChannelState(model_error=telemetry.error, delivered=telemetry.delivered, signals=signals)

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
        return self._output

    def reset(self, inputs: ControlInputs) -> None:
        """Reference models to the vehicle's state, integrals and filters to zero."""
        self._restart_models(inputs)
        p, q, r = inputs.state.rates.tolist()
        self._last_rates = (p, q, r)
        self._limits.reset()
        for augmentation in self.augmentations:
            augmentation.reset()

    @property
    def accepts_features(self) -> bool:
        """Whether a channel has network features."""
        return any(isinstance(one, AdaptiveAugmentation) and one.learns for one in self.augmentations)

    def offer_features(self, features: FeatureSet) -> str:
        """Swaps both channels in one tick, or refuses."""
        plans = []
        for augmentation, channel in zip(self.augmentations, (features.position, features.attitude), strict=True):
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
            one.last_layer.W.copy() if isinstance(one, AdaptiveAugmentation) else None for one in self.augmentations
        )
        return position, attitude

    def start_from(self, last_layers: tuple[Array | None, Array | None]) -> None:
        """Takes over W of an earlier flight with the same features; raises ValueError if the shapes differ."""
        for augmentation, W in zip(self.augmentations, last_layers, strict=True):
            if W is None or not isinstance(augmentation, AdaptiveAugmentation):
                continue
            if W.shape != augmentation.last_layer.W.shape:
                raise ValueError(
                    f"last layer of shape {W.shape}, this controller's is {augmentation.last_layer.W.shape}"
                )
            augmentation.last_layer.replace(W, W)

    # --- taking in -----------------------------------------------------------------------------------------------

    def _take_in(self, inputs: ControlInputs) -> None:
        for channel in self._channels:
            channel.dt, channel.adapt, channel.saturated = inputs.dt, inputs.adapt, inputs.saturated
        thrust, torque = self._mean_delivered(inputs)
        self._take_in_translation(inputs.state, thrust)
        self._take_in_rotation(inputs.state, torque, inputs.dt)
        if self._has_features:
            self._look_ahead(inputs)
        self._track(inputs)

    def _take_in_translation(self, state: VehicleState, thrust: float) -> None:
        """u_hat and Delta of the position channel: what thrust and attitude really give, against the accelerometer."""
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = state.rotation.tolist()
        fx, fy, fz = state.specific_force.tolist()
        lift = -thrust / self._airframe.mass_kg
        ux, uy, uz = lift * r02, lift * r12, lift * r22
        channel = self._channels[0]
        delivered, residual = channel.delivered, channel.residual_raw
        delivered[0], delivered[1], delivered[2] = ux, uy, uz + GRAVITY
        residual[0] = r00 * fx + r01 * fy + r02 * fz - ux
        residual[1] = r10 * fx + r11 * fy + r12 * fz - uy
        residual[2] = r20 * fx + r21 * fy + r22 * fz - uz
        channel.rate[:] = state.velocity

    def _take_in_rotation(self, state: VehicleState, torque: Vector3, dt: float) -> None:
        """The same of the attitude channel: torque by the actuator model against the gyroscope's derivative."""
        p, q, r = state.rates.tolist()
        was_p, was_q, was_r = self._last_rates
        up, uq, ur = self._angular_acceleration(torque, p, q, r)
        channel = self._channels[1]
        delivered, residual = channel.delivered, channel.residual_raw
        delivered[0], delivered[1], delivered[2] = up, uq, ur
        residual[0], residual[1], residual[2] = (p - was_p) / dt - up, (q - was_q) / dt - uq, (r - was_r) / dt - ur
        channel.rate[:] = state.rates
        self._last_rates = (p, q, r)

    def _track(self, inputs: ControlInputs) -> None:
        """Tracking error of the position channel, bounded so that a far target asks for no more than a near one."""
        north, east, down = inputs.state.position.tolist()
        vn, ve, vd = inputs.state.velocity.tolist()
        (target_n, target_e, target_d), (target_vn, target_ve, target_vd), _ = inputs.target.now
        limit = self._settings.position_error_max_m
        error = self._channels[0].tracking_error
        error[0] = min(max(target_n - north, -limit), limit)
        error[1] = min(max(target_e - east, -limit), limit)
        error[2] = min(max(target_d - down, -limit), limit)
        error[3], error[4], error[5] = target_vn - vn, target_ve - ve, target_vd - vd

    def _mean_delivered(self, inputs: ControlInputs) -> tuple[float, Vector3]:
        """Thrust [N] and torque [N m] over the tick that has just ended: that is what moved the vehicle since."""
        was, now = self._last_delivered, (inputs.delivered_thrust_n, *inputs.delivered_torque_nm)
        self._last_delivered = now
        thrust = 0.5 * (was[0] + now[0])
        return thrust, (0.5 * (was[1] + now[1]), 0.5 * (was[2] + now[2]), 0.5 * (was[3] + now[3]))

    def _angular_acceleration(self, torque: Vector3, p: float, q: float, r: float) -> Vector3:
        """J^-1 (tau - omega x J omega), rad/s^2."""
        jx, jy, jz = self._airframe.inertia_kg_m2
        return (
            (torque[0] - (jz - jy) * q * r) / jx,
            (torque[1] - (jx - jz) * p * r) / jy,
            (torque[2] - (jy - jx) * p * q) / jz,
        )

    def _look_ahead(self, inputs: ControlInputs) -> None:
        """x_ahead = x + (x_d(t + t_ahead) - x_d(t)), each channel with the t_ahead of its own lag."""
        position, attitude = self._channels
        self._see_ahead(inputs, inputs.target.ahead, position.signals)
        self._see_ahead(inputs, inputs.target.attitude_ahead, attitude.signals)

    def _see_ahead(self, inputs: ControlInputs, there: PathPoint, signals: Array) -> None:
        """Signals at the present and there, [SIGNAL_COUNT, 2]."""
        (now, now_rate, _), (ahead, ahead_rate, _) = inputs.target.now, there
        signals[:, :] = inputs.signals[:, None]
        column = signals[:, 1]
        north, east, down = inputs.state.position.tolist()
        column[POSITION_N] = north + ahead[0] - now[0]
        column[POSITION_N + 1] = east + ahead[1] - now[1]
        column[POSITION_N + 2] = down + ahead[2] - now[2]
        vn, ve, vd = inputs.state.velocity.tolist()
        vn += ahead_rate[0] - now_rate[0]
        ve += ahead_rate[1] - now_rate[1]
        vd += ahead_rate[2] - now_rate[2]
        column[VELOCITY_N], column[VELOCITY_N + 1], column[VELOCITY_N + 2] = vn, ve, vd
        (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = inputs.state.rotation.tolist()
        column[BODY_VELOCITY_X] = r00 * vn + r10 * ve + r20 * vd
        column[BODY_VELOCITY_X + 1] = r01 * vn + r11 * ve + r21 * vd
        column[BODY_VELOCITY_X + 2] = r02 * vn + r12 * ve + r22 * vd

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
        self._position_model.step(self._command, self._hedge(self._output.position, position), inputs.dt)
        self._position_model.error(state.position, state.velocity, position.model_error)
        self._attitude_model.step(self._turn_command, self._hedge(self._output.attitude, attitude), inputs.dt)
        self._attitude_model.error(state.quaternion, state.rates, attitude.model_error)
        e1, e2, e3, _, _, _ = attitude.model_error.tolist()
        if e1 * e1 + e2 * e2 + e3 * e3 > MODEL_ERROR_MAX_RAD**2:
            self._attitude_model.reset(state.quaternion, state.rates)
            attitude.model_error[:] = 0.0

    def _hedge(self, telemetry: ChannelTelemetry, channel: ChannelState) -> Vector3:
        """Demand minus u_hat, what the actuators did not deliver of the last demand; zero without hedging."""
        if not self._settings.hedging:
            return 0.0, 0.0, 0.0
        u1, u2, u3 = telemetry.demand.tolist()
        d1, d2, d3 = channel.delivered.tolist()
        return u1 - d1, u2 - d2, u3 - d3

    def _follow_jump(self, inputs: ControlInputs) -> bool:
        """A jump of the estimate is no motion: the references jump along (True), or start over where they cannot."""
        state = inputs.state
        if state.position_reset_count != self._resets_seen + 1 or state.yaw_jump != 0.0:
            self._restart_models(inputs)  # the frame has turned, or the size of a jump in between is not known
            return False
        self._position_model.shift(state.position_jump)
        (cx, cy, cz), k1 = self._command, self._k1
        jump_n, jump_e, jump_d = state.position_jump.tolist()
        self._command = (cx + k1[0] * jump_n, cy + k1[1] * jump_e, cz + k1[2] * jump_d)
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

    def _position_loop(self, inputs: ControlInputs) -> Vector3:
        """U of the position channel, m/s^2."""
        channel, telemetry = self._channels[0], self._output.position
        nu = self.augmentations[0].step(channel, telemetry)
        telemetry.adaptive[:] = nu
        n1, n2, n3 = nu.tolist()
        (k11, k12, k13), (k21, k22, k23) = self._k1, self._k2
        e1, e2, e3, e4, e5, e6 = channel.tracking_error.tolist()
        f1, f2, f3 = inputs.target.feed_forward
        x, y, z = inputs.state.position.tolist()
        vx, vy, vz = inputs.state.velocity.tolist()
        u1 = k11 * e1 + k21 * e4 + f1 - n1
        u2 = k12 * e2 + k22 * e5 + f2 - n2
        u3 = k13 * e3 + k23 * e6 + f3 - n3
        if inputs.level_only:
            u1, u2, u3 = 0.0, 0.0, k23 * (self._settings.level_sink_speed_m_s - vz) - n3
        demand = telemetry.demand
        demand[0], demand[1], demand[2] = u1, u2, u3
        # K_r r as the reference model needs it: u = K_r r - K x - nu_ad. Here nu_ad is that of the present state, which
        # the law weighs e with; what the look-ahead adds counts as part of the command.
        m1, m2, m3 = telemetry.adaptive_now.tolist()
        self._command = (
            u1 + k11 * x + k21 * vx + m1,
            u2 + k12 * y + k22 * vy + m2,
            u3 + k13 * z + k23 * vz + m3,
        )
        return u1, u2, u3

    def _thrust_vector(self, inputs: ControlInputs, u: Vector3) -> tuple[float, Quaternion]:
        """Collective thrust [N] along the present body axis, and the attitude that would realise u, within limits."""
        self._limits.step(inputs.saturated, inputs.adapt, inputs.dt)
        fx, fy, fz = self._limits.specific_thrust(u, float(self._output.position.adaptive[2]))
        norm = (fx * fx + fy * fy + fz * fz) ** 0.5
        commanded = attitude_for_thrust((fx / norm, fy / norm, fz / norm), inputs.target.yaw_rad)
        r02, r12, r22 = inputs.state.rotation[:, 2].tolist()
        thrust = self._airframe.mass_kg * (fx * r02 + fy * r12 + fz * r22)
        return max(thrust, 0.0), commanded

    def _attitude_loop(self, inputs: ControlInputs, commanded: Quaternion) -> Vector3:
        """Body torque [N m]."""
        channel, telemetry = self._channels[1], self._output.attitude
        state = inputs.state
        w, x, y, z = state.quaternion.tolist()
        ex, ey, ez = quaternion_to_rotation_vector(quaternion_multiply((w, -x, -y, -z), commanded))
        ez = min(max(ez, -0.5), 0.5)
        p, q, r = state.rates.tolist()
        error = channel.tracking_error
        error[0], error[1], error[2], error[3], error[4], error[5] = ex, ey, ez, -p, -q, -r
        nu = self.augmentations[1].step(channel, telemetry)
        n1, n2, n3 = nu.tolist()
        k1, k2 = self._a1, self._a2
        ap = k1[0] * ex - k2[0] * p - n1
        aq = k1[1] * ey - k2[1] * q - n2
        ar = k1[2] * ez - k2[2] * r - n3
        demand = telemetry.demand
        demand[0], demand[1], demand[2] = ap, aq, ar
        telemetry.adaptive[:] = nu
        m1, m2, m3 = telemetry.adaptive_now.tolist()
        self._turn_command = (ap + m1, aq + m2, ar + m3)
        jx, jy, jz = self._airframe.inertia_kg_m2
        return (jx * ap + (jz - jy) * q * r, jy * aq + (jx - jz) * p * r, jz * ar + (jy - jx) * p * q)
