"""The record of one tick: what was sensed, wanted, commanded and adapted. One flat vector, without allocation."""

from typing import Final

from flight_log.schema import RecordType, vector_fields
from onboard.control.records import ChannelTelemetry
from protocol.conventions import Array


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
        (f"{name}_weight_norm", u),
        (f"{name}_eps_1", u),
        (f"{name}_eps_2", u),
        (f"{name}_eps_3", u),
        (f"{name}_live_bound", ""),
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
)

OFFSET: Final = {name: index for index, name in enumerate(TICK.names)}


def write_channel(record: Array, at: int, telemetry: ChannelTelemetry) -> None:
    """Writes a channel's telemetry into the record from index `at`."""
    record[at : at + 21] = telemetry.vectors
    record[at + 21 : at + 26] = (
        telemetry.weight_norm,
        telemetry.eps_1,
        telemetry.eps_2,
        telemetry.eps_3,
        telemetry.live_bound,
    )
