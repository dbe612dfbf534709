"""The signal vector: every quantity that can be an input of a feature network, with name and unit.

A sample holds one such vector. A feature network selects its inputs from it by name, so that both sides use the same
inputs.
"""

from typing import Final

SIGNALS: Final[dict[str, str]] = {
    "position_n": "m, world NED",
    "position_e": "m, world NED",
    "position_d": "m, world NED",
    "velocity_n": "m/s, world NED",
    "velocity_e": "m/s, world NED",
    "velocity_d": "m/s, world NED",
    "roll": "rad",
    "pitch": "rad",
    "yaw": "rad",
    "rate_p": "rad/s, body FRD",
    "rate_q": "rad/s, body FRD",
    "rate_r": "rad/s, body FRD",
    "body_velocity_x": "m/s, body FRD",
    "body_velocity_y": "m/s, body FRD",
    "body_velocity_z": "m/s, body FRD",
    "motor_thrust_1": "N, estimated, smoothed, PX4 motor 1 (front right)",
    "motor_thrust_2": "N, estimated, smoothed, PX4 motor 2 (rear left)",
    "motor_thrust_3": "N, estimated, smoothed, PX4 motor 3 (front left)",
    "motor_thrust_4": "N, estimated, smoothed, PX4 motor 4 (rear right)",
    "battery_voltage": "V",
    "vibration": "m/s^2, high-passed accelerometer magnitude, smoothed",
}
"""Name and unit of each signal, in the order of the signal vector."""

SIGNAL_NAMES: Final[tuple[str, ...]] = tuple(SIGNALS)
SIGNAL_COUNT: Final[int] = len(SIGNAL_NAMES)
SIGNAL_INDEX: Final[dict[str, int]] = {name: index for index, name in enumerate(SIGNAL_NAMES)}

CHANNELS: Final[tuple[str, ...]] = ("position", "attitude")
"""The adaptive channels, in the order of every array with a channel axis.

position: u is an acceleration, world NED, m/s^2. attitude: u is an angular acceleration, body FRD, rad/s^2.
"""


def input_indices(names: tuple[str, ...], signals: tuple[str, ...] = SIGNAL_NAMES) -> list[int]:
    """Indices of the named signals in a signal vector; `signals` are the names of its elements.

    Raises
    ------
    ValueError
        If a name is unknown or occurs twice; the message lists the allowed names.
    """
    index = SIGNAL_INDEX if signals is SIGNAL_NAMES else {name: at for at, name in enumerate(signals)}
    unknown = [name for name in names if name not in index]
    if unknown:
        raise ValueError(f"unknown signal {unknown[0]!r}; allowed are {', '.join(signals)}")
    if len(set(names)) != len(names):
        raise ValueError(f"a signal occurs twice in {names}")
    return [index[name] for name in names]
