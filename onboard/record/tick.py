"""The record of one tick: state, target, command and adaptation, in one flat vector."""

from collections.abc import Sequence
from typing import Final

from flight_log.schema import RecordType, vector_fields
from onboard.control.records import ChannelMeasurement, ChannelTelemetry, ControlInputs, ControlOutput
from onboard.flight.modes import FlightMode
from protocol.conventions import NEVER_NS, Array


def _channel_fields(name: str, error_axes: tuple[str, str], units: tuple[str, str, str]) -> tuple[tuple[str, str], ...]:
    first, second, u = units
    axes, rate_axes = error_axes
    return (
        *vector_fields(f"{name}_error", axes, first),
        *vector_fields(f"{name}_error_rate", rate_axes, second),
        *vector_fields(f"{name}_demand", axes, u),
        *vector_fields(f"{name}_delivered", axes, u),
        *vector_fields(f"{name}_adaptive", axes, u),
        *vector_fields(f"{name}_adaptive_now", axes, u),
        *vector_fields(f"{name}_residual", axes, u),
        *vector_fields(f"{name}_room", axes, u),
        (f"{name}_weight_norm", u),
        (f"{name}_eps_1", u),
        (f"{name}_eps_2", u),
        (f"{name}_eps_3", u),
        (f"{name}_tracking_bound", first),
    )


TICK: Final = RecordType(
    "onboard/tick",
    (
        ("mode", "onboard.flight.supervisor.FlightMode"),
        ("adapting", "0 or 1"),
        ("saturated", "0 or 1"),
        ("path_time", "s"),
        ("feature_version", ""),
        ("feature_age", "s"),
        ("pose_age", "s"),
        ("offboard_age", "s"),
        ("battery", "V"),
        ("vibration", "m/s^2"),
        ("position_sigma", "m"),
        ("thrust", "N"),
        ("thrust_scale", "thrust as a multiple of the nominal one, estimated"),
        ("law", "onboard.control.guard.Level"),
        *vector_fields("position", "ned", "m"),
        *vector_fields("velocity", "ned", "m/s"),
        *vector_fields("quaternion", "wxyz", ""),
        *vector_fields("euler", "xyz", "rad"),
        *vector_fields("rates", "pqr", "rad/s"),
        *vector_fields("target", "ned", "m"),
        *vector_fields("target_velocity", "ned", "m/s"),
        *vector_fields("feed_forward", "ned", "m/s^2"),
        *vector_fields("commanded_quaternion", "wxyz", ""),
        *vector_fields("torque", "xyz", "N m"),
        *vector_fields("motor", "1234", "share of maximum thrust, commanded"),
        *vector_fields("motor_thrust", "1234", "N, estimated"),
        *_channel_fields("position", ("ned", "ned"), ("m", "m/s", "m/s^2")),
        *_channel_fields("attitude", ("xyz", "pqr"), ("rad", "rad/s", "rad/s^2")),
    ),
    "float32",
)

OFFSET: Final = {name: index for index, name in enumerate(TICK.names)}


POSITION_AT: Final = OFFSET["position_error_n"]
ATTITUDE_AT: Final = OFFSET["attitude_error_x"]


def write_tick(
    row: Array,
    inputs: ControlInputs,
    control: ControlOutput,
    *,
    mode: FlightMode,
    saturated: bool,
    path_time_s: float,
    feature_version: int,
    feature_age_s: float,
    pose_age_s: float,
    offboard_age_s: float,
    battery_v: float,
    motors: Sequence[float],
    motor_thrusts_n: Array,
) -> None:
    """Write one tick into `row`, in the order of TICK.

    Parameters
    ----------
    saturated: the motors cannot deliver what the controller demands in this tick.
    motors: [4], commanded, as shares of the maximum thrust.
    motor_thrusts_n: [4], N, by the actuator model.
    """
    state, target = inputs.state, inputs.target
    row[:POSITION_AT] = (
        mode,
        inputs.adapt,
        saturated,
        path_time_s,
        feature_version,
        feature_age_s,
        pose_age_s,
        offboard_age_s,
        battery_v,
        state.vibration,
        state.position_sigma_m,
        control.thrust_n,
        inputs.thrust[1],
        control.law,
        *state.position.tolist(),
        *state.velocity.tolist(),
        *state.quaternion.tolist(),
        *state.euler.tolist(),
        *state.rates.tolist(),
        *target.path.position,
        *target.path.velocity,
        *target.feed_forward,
        *control.commanded_quaternion,
        *control.torque_nm,
        *motors,
        *motor_thrusts_n.tolist(),
    )
    _write_channel(row, POSITION_AT, control.position, inputs.position)
    _write_channel(row, ATTITUDE_AT, control.attitude, inputs.attitude)


def _write_channel(row: Array, at: int, telemetry: ChannelTelemetry, measured: ChannelMeasurement) -> None:
    row[at : at + 9] = telemetry.vectors[:9]
    row[at + 9 : at + 12] = measured.u_hat
    row[at + 12 : at + 21] = telemetry.vectors[9:]
    row[at + 21 : at + 24] = telemetry.room
    row[at + 24 : at + 29] = (
        telemetry.weight_norm,
        telemetry.eps_1,
        telemetry.eps_2,
        telemetry.eps_3,
        telemetry.tracking_bound,
    )


def age_s(now_ns: int, then_ns: int) -> float:
    """Seconds since `then_ns`; -1 if it has never happened."""
    return -1.0 if then_ns == NEVER_NS else (now_ns - then_ns) * 1e-9
