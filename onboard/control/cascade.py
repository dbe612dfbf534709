"""The cascade of all built-in controllers: a position loop and an attitude loop, each with a law.

    position:  u = K_r r - K x - nu_ad     -> thrust and attitude command
    attitude:  u = K_1 e_R - K_2 (omega - omega_d) + alpha_d - nu_ad -> torque = J u + omega x J omega

Order within tick k: the reference models advance with the command of tick k-1 and what was delivered since; then error
and law at the present; then the command.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.airframe import AirframeConfig
from onboard.control.command_motion import CommandMotion
from onboard.control.demand_limits import DemandLimits, DemandLimitsConfig, thrust_along
from onboard.control.guard import Fall, Guard, GuardConfig
from onboard.control.laws.adaptive import AdaptiveAugmentation, AdaptiveConfig
from onboard.control.laws.ilc import IterativeLearning, IterativeLearningConfig
from onboard.control.laws.indi import Indi, IndiConfig
from onboard.control.laws.integral import Integral, IntegralConfig
from onboard.control.laws.l1 import L1, L1Config
from onboard.control.laws.law import Augmentation, ChannelState
from onboard.control.laws.none import NoAugmentation, NoneConfig
from onboard.control.laws.repetitive import Repetitive, RepetitiveConfig
from onboard.control.records import ChannelTelemetry, ControlInputs, ControlOutput
from onboard.control.reference_model import AttitudeReferenceModel, ChannelGains, PositionReferenceModel
from onboard.control.slope import SlopeLimits
from onboard.control.tracking_bound import TrackingBounds
from onboard.flight.trajectory import PathPoint
from protocol import geometry
from protocol.conventions import GRAVITY, Array
from protocol.feature_config import ChannelName, FeaturesConfig
from protocol.feature_set import FeatureSet
from protocol.geometry import Quaternion, Vector3, add, vector
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX

AugmentationConfig = Annotated[
    NoneConfig | IntegralConfig | L1Config | IndiConfig | RepetitiveConfig | IterativeLearningConfig | AdaptiveConfig,
    Field(discriminator="kind"),
]

POSITION_N, VELOCITY_N = SIGNAL_INDEX["position_n"], SIGNAL_INDEX["velocity_n"]
BODY_VELOCITY_X = SIGNAL_INDEX["body_velocity_x"]
"""The other two axes follow."""
YAW_ERROR_MAX_RAD = 0.5
MODEL_ERROR_MAX_RAD = 0.6
"""Above this attitude error the linear error model does not hold: the reference is set to the vehicle's attitude."""
MODEL_GAP_MAX_S = 0.02
"""The same after a longer time since the last tick, which is no small step for the model of the attitude."""


class ChannelSettings(ConfigRecord):
    """Settings of one channel."""

    gains: ChannelGains
    augmentation: AugmentationConfig


class CascadeSettings(ConfigRecord):
    """Settings of the cascade."""

    features: FeaturesConfig
    position: ChannelSettings
    attitude: ChannelSettings
    hedging: Annotated[
        Literal["all", "limits", "none"],
        Field(description="what is taken out of both reference models: all that is not delivered, or what limits take"),
    ] = "all"
    position_error_max_m: Annotated[float, Field(gt=0, le=10)] = 1.5
    limits: DemandLimitsConfig = DemandLimitsConfig()
    guard: GuardConfig = GuardConfig()
    prediction: Annotated[bool, Field(description="attitude and rates predicted over the loop's dead time")] = True
    gyro_delay_ticks: Annotated[float, Field(ge=0, le=10, description="age of the rates, for the prediction")] = 1.0
    command_rate_filter_s: Annotated[
        float,
        Field(ge=0, le=0.5, description="of the rate that feedback adds to the command's; 0: it is not fed forward"),
    ] = 0.03
    path_turn: Annotated[
        float, Field(ge=0, le=1, description="share of the path's rate and acceleration of turn that is fed forward")
    ] = 1.0
    level_sink_speed_m_s: Annotated[float, Field(gt=0, le=1)] = 0.4


def _augmentation(settings: CascadeSettings, channel: ChannelName, rng: np.random.Generator) -> Augmentation:
    one: ChannelSettings = getattr(settings, channel)
    config = one.augmentation
    match config:
        case AdaptiveConfig():
            limits = SlopeLimits.of(channel, settings.position.gains, settings.attitude.gains, config.slope_shares)
            return AdaptiveAugmentation(config, one.gains, settings.features.untrained, channel, rng, limits)
        case IntegralConfig():
            return Integral(config)
        case L1Config():
            return L1(config)
        case IndiConfig():
            return Indi(config)
        case RepetitiveConfig():
            return Repetitive(config)
        case IterativeLearningConfig():
            return IterativeLearning(config, one.gains)
        case NoneConfig():
            return NoAugmentation(config)


class CascadedController:
    """PID, MRAC, DMRAC, L1, INDI, repetitive control and iterative learning, by its settings."""

    Settings = CascadeSettings

    def __init__(self, settings: CascadeSettings, airframe: AirframeConfig, seed: int) -> None:
        self._settings = settings
        self._airframe = airframe
        rng = np.random.default_rng([seed, 101])
        self.augmentations = (_augmentation(settings, "position", rng), _augmentation(settings, "attitude", rng))
        """Position and attitude channel."""
        self._has_features = any(isinstance(one, AdaptiveAugmentation) for one in self.augmentations)
        gains = settings.position.gains, settings.attitude.gains
        self.guard = Guard(settings.guard, self.augmentations, gains, airframe, settings.limits.tilt_max_rad)
        self._position_model = PositionReferenceModel(settings.position.gains)
        self._attitude_model = AttitudeReferenceModel(settings.attitude.gains)
        self._k1 = tuple(settings.position.gains.stiffness().tolist())
        self._k2 = tuple(settings.position.gains.rate_gain().tolist())
        self._a1 = tuple(settings.attitude.gains.stiffness().tolist())
        self._a2 = tuple(settings.attitude.gains.rate_gain().tolist())
        self._limits = DemandLimits(settings.limits)
        self.bounds = TrackingBounds(settings.position.gains, settings.attitude.gains)
        """Live bounds on the tracking errors; they change no command."""
        self._output = ControlOutput()
        position, attitude = self.augmentations
        self._channels = (
            self._channel(self._output.position, position),
            self._channel(self._output.attitude, attitude),
        )
        self._command: Vector3 = (0.0, 0.0, 0.0)
        self._turn_command: Vector3 = (0.0, 0.0, 0.0)
        self._limited: Vector3 = (0.0, 0.0, 0.0)
        """What the demand's limits took of the position channel's u, m/s^2."""
        self._motion = CommandMotion(settings.command_rate_filter_s, settings.path_turn)
        self._resets_seen = 0
        self._running = False

    def _channel(self, telemetry: ChannelTelemetry, augmentation: Augmentation) -> ChannelState:
        """A channel whose model error is the array that the telemetry reports."""
        states = 3 if isinstance(augmentation, AdaptiveAugmentation) and augmentation.reads_path else 2
        return ChannelState(model_error=telemetry.error, signals=np.zeros((SIGNAL_COUNT, states)))

    # --- the interface -------------------------------------------------------------------------------------------

    def step(self, inputs: ControlInputs) -> ControlOutput:
        """One tick of both loops."""
        self._read(inputs)
        self._advance_models(inputs)
        acceleration = add(self._position_loop(inputs), inputs.excitation[0])
        thrust, commanded = self._thrust_vector(inputs, acceleration)
        self._output.thrust_n = thrust
        self._output.commanded_quaternion = commanded
        self._output.torque_nm = self._attitude_loop(inputs, commanded)
        self._output.law = self.guard.level
        self.guard.judge(inputs.dt, inputs.adapt)
        self.bounds.step(inputs, self._output, self._motion)
        return self._output

    def reset(self, inputs: ControlInputs) -> None:
        """Set the reference models to the vehicle's state, integrals and filters to zero."""
        self._restart_models(inputs)
        self._limits.reset()
        self.bounds.reset()
        self.guard.reset()
        for augmentation in self.augmentations:
            augmentation.reset()

    @property
    def accepts_features(self) -> bool:
        """Whether a channel has network features."""
        return any(isinstance(one, AdaptiveAugmentation) and one.learns for one in self.augmentations)

    def offer_features(self, features: FeatureSet) -> str:
        """Swap the features of both channels in one tick, or refuse."""
        return self.guard.offer(features)

    def begin_features(self, features: FeatureSet) -> None:
        """Start to prepare a swap."""
        self.guard.begin(features)

    def advance_features(self) -> str | None:
        """One part of it, as of `PreparingController`."""
        return self.guard.advance()

    def cancel_features(self) -> None:
        """Forget the version that is being prepared, if any."""
        self.guard.cancel()

    def take_falls(self) -> list[Fall]:
        """What the guard did since the last call."""
        return self.guard.take_falls()

    def last_layers(self) -> tuple[Array | None, Array | None]:
        """W [k, 3] of the position and the attitude channel; None for a channel without."""
        position, attitude = (
            one.last_layer.W.copy() if isinstance(one, AdaptiveAugmentation) else None for one in self.augmentations
        )
        return position, attitude

    def start_from(self, last_layers: tuple[Array | None, Array | None]) -> None:
        """Start with W of an earlier flight with the same features. Raises ValueError if the shapes differ."""
        for augmentation, W in zip(self.augmentations, last_layers, strict=True):
            if W is None or not isinstance(augmentation, AdaptiveAugmentation):
                continue
            if W.shape != augmentation.last_layer.W.shape:
                raise ValueError(
                    f"last layer of shape {W.shape}, this controller's is {augmentation.last_layer.W.shape}"
                )
            augmentation.last_layer.replace(W, W)

    # --- the channels' inputs ------------------------------------------------------------------------------------

    def _read(self, inputs: ControlInputs) -> None:
        """Fill both channels from the inputs."""
        measured = inputs.position, inputs.attitude
        rates = inputs.state.velocity, inputs.state.rates
        for channel, one, rate in zip(self._channels, measured, rates, strict=True):
            channel.dt, channel.adapt, channel.saturated = inputs.dt, inputs.adapt, inputs.saturated
            channel.u_hat, channel.residual, channel.rate = one.u_hat, one.residual, rate
            channel.lap_phase, channel.lap_s = inputs.target.lap_phase, inputs.target.lap_s
        if self._has_features:
            self._look_ahead(inputs)
        self._track(inputs)

    def _track(self, inputs: ControlInputs) -> None:
        """Tracking error of the position channel; the position part is limited per axis."""
        north, east, down = inputs.state.position.tolist()
        vn, ve, vd = inputs.state.velocity.tolist()
        (target_n, target_e, target_d), (target_vn, target_ve, target_vd), _ = inputs.target.now
        limit = self._settings.position_error_max_m
        error = self._channels[0].tracking_error
        error[0] = min(max(target_n - north, -limit), limit)
        error[1] = min(max(target_e - east, -limit), limit)
        error[2] = min(max(target_d - down, -limit), limit)
        error[3], error[4], error[5] = target_vn - vn, target_ve - ve, target_vd - vd

    def _look_ahead(self, inputs: ControlInputs) -> None:
        """The states of both channels, each with the t_ahead of its own lag."""
        each_channel = zip(self._channels, (inputs.target.ahead, inputs.target.attitude_ahead), strict=True)
        for channel, there in each_channel:
            channel.signals[:, :] = inputs.signals[:, None]
            if channel.signals.shape[1] == 3:
                self._set_motion(channel.signals[:, 1], there.position, there.velocity, inputs)
                now = inputs.target.now
                self._set_motion(channel.signals[:, 2], now.position, now.velocity, inputs)
            else:
                self._see_ahead(inputs, there, channel.signals[:, 1])

    def _see_ahead(self, inputs: ControlInputs, there: PathPoint, column: Array) -> None:
        """x_ahead = x + (x_d(t + t_ahead) - x_d(t)), into the signals `column` [SIGNAL_COUNT]."""
        (now, now_rate, _), (ahead, ahead_rate, _) = inputs.target.now, there
        north, east, down = inputs.state.position.tolist()
        vn, ve, vd = inputs.state.velocity.tolist()
        position = north + ahead[0] - now[0], east + ahead[1] - now[1], down + ahead[2] - now[2]
        velocity = vn + ahead_rate[0] - now_rate[0], ve + ahead_rate[1] - now_rate[1], vd + ahead_rate[2] - now_rate[2]
        self._set_motion(column, position, velocity, inputs)

    def _set_motion(self, column: Array, position: Vector3, velocity: Vector3, inputs: ControlInputs) -> None:
        """Position and velocity (world NED) in the signals `column` [SIGNAL_COUNT], at the present attitude."""
        column[POSITION_N], column[POSITION_N + 1], column[POSITION_N + 2] = position
        vn, ve, vd = column[VELOCITY_N], column[VELOCITY_N + 1], column[VELOCITY_N + 2] = velocity
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
        hedge = self._hedge(self._output.position, position, self._limited)
        self._position_model.step(self._command, hedge, inputs.dt)
        self._position_model.error(state.position, state.velocity, position.model_error)
        hedge = self._hedge(self._output.attitude, attitude, (0.0, 0.0, 0.0))
        self._attitude_model.step(self._turn_command, hedge, inputs.dt)
        self._attitude_model.error(state.quaternion, state.rates, attitude.model_error)
        e1, e2, e3, _, _, _ = attitude.model_error.tolist()
        if inputs.dt > MODEL_GAP_MAX_S or e1 * e1 + e2 * e2 + e3 * e3 > MODEL_ERROR_MAX_RAD**2:
            self._attitude_model.reset(state.quaternion, state.rates)
            attitude.model_error[:] = 0.0

    def _hedge(self, telemetry: ChannelTelemetry, channel: ChannelState, limited: Vector3) -> Vector3:
        """What is taken out of the reference: u - u_hat, all that was not delivered, or only what limits took.

        limited: what they took of the last demand; while motors are at theirs, all is taken out.
        """
        hedging = self._settings.hedging
        if hedging == "none":
            return 0.0, 0.0, 0.0
        if hedging == "limits" and not channel.saturated:
            return limited
        each_axis = zip(telemetry.demand.tolist(), channel.u_hat.tolist(), strict=True)
        return vector(u - u_hat for u, u_hat in each_axis)

    def _follow_jump(self, inputs: ControlInputs) -> bool:
        """Move the references with a jump of the estimate (True), or reset them where its size is not known (False)."""
        state = inputs.state
        if state.position_reset_count != self._resets_seen + 1 or state.yaw_jump != 0.0:
            self._restart_models(inputs)  # yaw has jumped as well, or the position more than once
            return False
        self._position_model.shift(state.position_jump)
        each_axis = zip(self._command, self._k1, state.position_jump.tolist(), strict=True)
        self._command = vector(command + k1 * jump for command, k1, jump in each_axis)
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
        """u = K_1 (p_d - p) + K_2 (v_d - v) + a_ff - nu_ad, m/s^2, world NED."""
        channel, telemetry = self._channels[0], self._output.position
        nu_ad = self.guard.step(0, channel, telemetry, inputs)
        K_1, K_2 = self._k1, self._k2
        e = channel.tracking_error.tolist()
        v = inputs.state.velocity.tolist()
        each_axis = zip(K_1, e[:3], K_2, e[3:], inputs.target.feed_forward, nu_ad.tolist(), strict=True)
        u1, u2, u3 = (k1 * e1 + k2 * e2 + a_ff - nu for k1, e1, k2, e2, a_ff, nu in each_axis)
        if inputs.level_only:
            u1, u2, u3 = 0.0, 0.0, K_2[2] * (self._settings.level_sink_speed_m_s - v[2]) - float(nu_ad[2])
        telemetry.demand[:] = u = (u1, u2, u3)
        # The command of the reference model: K_r r = u + K x + nu_ad, with nu_ad of the present state, because the law
        # weighs e with that one. What the look-ahead adds is part of the command.
        each_axis = zip(u, K_1, inputs.state.position.tolist(), K_2, v, telemetry.adaptive_now.tolist(), strict=True)
        self._command = vector(ui + k1 * pi + k2 * vi + nu for ui, k1, pi, k2, vi, nu in each_axis)
        return u

    def _thrust_vector(self, inputs: ControlInputs, u: Vector3) -> tuple[float, Quaternion]:
        """Collective thrust [N] along the present body axis, and the attitude for u, within the limits."""
        self._limits.step(inputs.adapt, float(inputs.position.residual[2]), inputs.dt)
        fx, fy, fz = self._limits.specific_thrust(u, float(self._output.position.adaptive[2]))
        self._limited = u[0] + fx, u[1] + fy, u[2] + fz - GRAVITY
        norm = (fx * fx + fy * fy + fz * fz) ** 0.5
        commanded = geometry.attitude_for_thrust((fx / norm, fy / norm, fz / norm), inputs.target.yaw_rad)
        r02, r12, r22 = inputs.state.rotation[:, 2].tolist()
        return self._airframe.mass_kg * thrust_along((fx, fy, fz), (r02, r12, r22)), commanded

    def _predicted(self, inputs: ControlInputs) -> tuple[Quaternion, Vector3]:
        """Attitude and rates when the command of this tick acts: half a tick after the next one begins.

        The rates are those of GYRO_DELAY_TICKS ago; the actuators' acceleration since then and until then is known, and
        nu_ad of the last tick stands for the disturbance.
        """
        w, x, y, z = inputs.state.quaternion.tolist()
        p, q, r = inputs.state.rates.tolist()
        if not self._settings.prediction:
            return (w, x, y, z), (p, q, r)
        dt, (now, next_) = inputs.period, inputs.coming
        before = now if inputs.missed else vector(inputs.attitude.u_hat.tolist())
        nu = self._output.attitude.adaptive_now.tolist()
        delay = self._settings.gyro_delay_ticks
        here = vector(w_i + delay * dt * (u0 + n) for w_i, u0, n in zip((p, q, r), before, nu, strict=True))
        there = vector(
            w_i + dt * (0.5 * (u1 + u2) + n) + 0.5 * dt * (u2 + n)
            for w_i, u1, u2, n in zip(here, now, next_, nu, strict=True)
        )
        turn = vector(0.5 * 1.5 * dt * 0.5 * (a + b) for a, b in zip(here, there, strict=True))
        return geometry.quaternion_multiply((w, x, y, z), (1.0, *turn)), there

    def _attitude_loop(self, inputs: ControlInputs, commanded: Quaternion) -> Vector3:
        """u = K_1 e_R - K_2 (omega - omega_d) + alpha_d - nu_ad;  tau = J u + omega x J omega, N m; body FRD."""
        channel, telemetry = self._channels[1], self._output.attitude
        (w, x, y, z), omega = self._predicted(inputs)
        ex, ey, ez = geometry.quaternion_to_rotation_vector(geometry.quaternion_multiply((w, -x, -y, -z), commanded))
        e_R = ex, ey, min(max(ez, -YAW_ERROR_MAX_RAD), YAW_ERROR_MAX_RAD)
        p, q, r = omega
        channel.tracking_error[:] = (*e_R, -p, -q, -r)
        nu_ad = self.guard.step(1, channel, telemetry, inputs)
        self._motion.step(commanded, inputs)
        omega_d, alpha_d = self._motion.omega_d, self._motion.alpha_d
        each_axis = zip(self._a1, e_R, self._a2, omega, omega_d, alpha_d, nu_ad.tolist(), strict=True)
        u = vector(k1 * e1 - k2 * (w_i - w_d) + a_d - nu for k1, e1, k2, w_i, w_d, a_d, nu in each_axis)
        telemetry.demand[:] = u
        self._turn_command = vector(ui + nu for ui, nu in zip(u, telemetry.adaptive_now.tolist(), strict=True))
        u = add(u, inputs.excitation[1])
        Jx, Jy, Jz = self._airframe.inertia_kg_m2
        return Jx * u[0] + (Jz - Jy) * q * r, Jy * u[1] + (Jx - Jz) * p * r, Jz * u[2] + (Jy - Jx) * p * q
