"""The scene of a flight, for a viewer, as plain arrays: the vehicle in space, and curves in groups."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from configs.loader import ConfigError, parse_yaml
from flight_log.reader import Event, Flight, Table

Array = NDArray[np.float64]

RATE_MAX_HZ: Final = 50.0
"""Regular topics are thinned to this rate, so that a long flight opens in seconds; a screen shows no more."""
SMOOTHING_ROWS: Final = 20
"""Number of ticks (0.1 s) over which the true disturbance, a difference of noisy signals, is averaged."""
FLOOR_EFFECT_M: Final = 0.15
LOSS_WINDOW_NS: Final = 1_000_000_000
DEGREES: Final = 180.0 / np.pi
ARM_M: Final = 0.0442
"""Half the distance between neighbouring rotors of a Mambo, which is drawn in its real size."""
ROTORS: Final = ((ARM_M, ARM_M, 0.0), (-ARM_M, -ARM_M, 0.0), (ARM_M, -ARM_M, 0.0), (-ARM_M, ARM_M, 0.0))
"""PX4 order: front right, rear left, front left, rear right; body FRD."""
THRUST_M_PER_N: Final = 1.0
ARROW_SCALE: Final = {"wind": 0.05, "disturbance": 4.0, "nu_ad": 0.25}
"""Drawn metres per m/s, per N, per m/s^2 (a Mambo weighs 0.063 kg, so force and nu_ad are drawn alike)."""
ARROW_COLOURS: Final = {"wind": (120, 170, 255), "disturbance": (235, 90, 60), "nu_ad": (60, 190, 120)}


@dataclass(frozen=True, slots=True)
class Curve:
    """A scalar over time."""

    group: str
    name: str
    time_ns: NDArray[np.int64]
    values: Array
    """[n]"""
    reference: bool = False
    """A curve that the others in its group should follow; drawn in grey."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The vehicle and what acts on it; row i of every array is at time i. World NED, m, N."""

    time_ns: NDArray[np.int64]
    """[n]"""
    position: Array
    """[n, 3]"""
    quaternion: Array
    """[n, 4] wxyz, body FRD to world NED."""
    thrust: Array
    """[n, 4] N, PX4 motor order."""
    arrows: dict[str, Array]
    """Name -> [n, 3]: wind in m/s, disturbance in N, nu_ad in m/s^2, if logged."""


@dataclass(frozen=True, slots=True)
class Scene:
    """All data for a viewer. Parts that the flight did not log are None or empty."""

    motion: Motion | None
    target: tuple[NDArray[np.int64], Array] | None
    """Times and positions, [n, 3]."""
    curves: tuple[Curve, ...]
    events: tuple[Event, ...]
    start_ns: int
    groups: tuple[str, ...] = field(default=())
    """Groups of curves, in the order of display."""


PLAIN_CURVES: Final[tuple[tuple[str, str, str, str, float, bool], ...]] = (
    # group, name, topic, column, factor, reference
    ("position [m]", "target north", "onboard/tick", "target_n", 1.0, True),
    ("position [m]", "target east", "onboard/tick", "target_e", 1.0, True),
    ("position [m]", "target down", "onboard/tick", "target_d", 1.0, True),
    ("attitude [deg]", "roll", "onboard/tick", "euler_x", DEGREES, False),
    ("attitude [deg]", "pitch", "onboard/tick", "euler_y", DEGREES, False),
    ("adaptive, position [m/s²]", "nu_ad north", "onboard/tick", "position_adaptive_n", 1.0, False),
    ("adaptive, position [m/s²]", "nu_ad east", "onboard/tick", "position_adaptive_e", 1.0, False),
    ("adaptive, position [m/s²]", "nu_ad down", "onboard/tick", "position_adaptive_d", 1.0, False),
    ("adaptive, attitude [rad/s²]", "nu_ad x", "onboard/tick", "attitude_adaptive_x", 1.0, False),
    ("adaptive, attitude [rad/s²]", "nu_ad y", "onboard/tick", "attitude_adaptive_y", 1.0, False),
    ("norm(W)", "position", "onboard/tick", "position_weight_norm", 1.0, False),
    ("norm(W)", "attitude", "onboard/tick", "attitude_weight_norm", 1.0, False),
    ("features", "version in use", "onboard/tick", "feature_version", 1.0, False),
    ("features", "age [s]", "onboard/tick", "feature_age", 1.0, False),
    ("link ages [s]", "pose", "onboard/tick", "pose_age", 1.0, False),
    ("link ages [s]", "offboard", "onboard/tick", "offboard_age", 1.0, False),
    ("link counts", "received", "offboard/link", "received", 1.0, False),
    ("link counts", "lost", "offboard/link", "lost", 1.0, False),
    ("link counts", "rejected", "offboard/link", "rejected", 1.0, False),
    ("training loss, position [(m/s²)²]", "training", "offboard/training", "training_loss_position", 1.0, False),
    ("training loss, position [(m/s²)²]", "held out", "offboard/training", "validation_loss_position", 1.0, False),
    ("training loss, position [(m/s²)²]", "flying", "offboard/training", "flying_loss_position", 1.0, False),
    ("training loss, attitude [(rad/s²)²]", "training", "offboard/training", "training_loss_attitude", 1.0, False),
    ("training loss, attitude [(rad/s²)²]", "held out", "offboard/training", "validation_loss_attitude", 1.0, False),
    ("training loss, attitude [(rad/s²)²]", "flying", "offboard/training", "flying_loss_attitude", 1.0, False),
    ("motors [share of maximum]", "1 front right", "onboard/tick", "motor_1", 1.0, False),
    ("motors [share of maximum]", "2 rear left", "onboard/tick", "motor_2", 1.0, False),
    ("motors [share of maximum]", "3 front left", "onboard/tick", "motor_3", 1.0, False),
    ("motors [share of maximum]", "4 rear right", "onboard/tick", "motor_4", 1.0, False),
    ("loop [us]", "tick", "onboard/loop", "tick", 1.0, False),
    ("loop [us]", "lateness", "onboard/loop", "lateness", 1.0, False),
    ("health", "battery [V]", "onboard/tick", "battery", 1.0, False),
    ("health", "vibration [m/s²]", "onboard/tick", "vibration", 1.0, False),
    ("health", "mode", "onboard/tick", "mode", 1.0, False),
)
TABS: Final = {
    "control": ("position [m]", "attitude [deg]", "adaptive, position [m/s²]", "adaptive, attitude [rad/s²]"),
    "adaptation": ("norm(W)", "tracking error, position [m]", "tracking error, attitude [deg]"),
    "learning": ("features", "training loss, position [(m/s²)²]", "training loss, attitude [(rad/s²)²]"),
    "link": ("datagrams lost in 1 s [%]", "delay of datagrams [ms]", "link ages [s]", "link counts"),
    "vehicle": ("motors [share of maximum]", "loop [us]", "health"),
}
"""Tab -> groups of curves, from top to bottom."""
GROUPS: Final = tuple(group for groups in TABS.values() for group in groups)


def build_scene(flight: Flight, start_ns: int | None = None) -> Scene:
    """The scene of a flight, or of a part of it; `start_ns` is the zero of the time line, by default its `start_ns`."""
    tables = {topic: flight[topic] for topic in flight.topics}
    tick, truth, delivery = (tables.get(topic) for topic in ("onboard/tick", "sim_vehicle/truth", "radio/delivery"))
    curves = [curve for wanted in PLAIN_CURVES if (curve := _plain(tables, *wanted)) is not None]
    flown = truth if truth is not None else tick
    if flown is not None:
        curves += [_curve("position [m]", name, thinned(flown), f"position_{axis}") for name, axis in _NED]
    if tick is not None:
        curves += _commanded(tick) + _bounds(tick) + _weight_limits(flight, tick)
    if tick is not None and truth is not None:
        curves += _true_disturbance(tick, truth)
    if delivery is not None:
        curves += _deliveries(delivery)
    present = {curve.group for curve in curves}
    return Scene(
        motion=_motion(tick, truth),
        target=None if tick is None else (thinned(tick).time_ns, thinned(tick).vector(*_names("target", "ned"))),
        curves=tuple(curves),
        events=flight.events,
        start_ns=flight.start_ns if start_ns is None else start_ns,
        groups=tuple(group for group in GROUPS if group in present),
    )


_NED: Final = (("north", "n"), ("east", "e"), ("down", "d"))


def thinned(table: Table) -> Table:
    """The table, thinned to at most RATE_MAX_HZ."""
    if len(table) < 2:
        return table
    period_s = float(np.median(np.diff(table.time_ns))) * 1e-9
    step = max(round(1.0 / (RATE_MAX_HZ * max(period_s, 1e-6))), 1)
    return Table(table.topic, table.names, table.units, table.time_ns[::step], table.values[::step])


def _rows(table: Table, rows: NDArray[np.bool_]) -> Table:
    return Table(table.topic, table.names, table.units, table.time_ns[rows], table.values[rows])


def _names(name: str, axes: str) -> list[str]:
    return [f"{name}_{axis}" for axis in axes]


def _curve(group: str, name: str, table: Table, column: str) -> Curve:
    return Curve(group, name, table.time_ns, table[column])


def _plain(
    tables: dict[str, Table], group: str, name: str, topic: str, column: str, factor: float, reference: bool
) -> Curve | None:
    table = tables.get(topic)
    if table is None or column not in table:
        return None
    thin = thinned(table)
    values = thin[column] * factor
    if column.endswith("_age"):
        values = np.where(values < 0.0, np.nan, values)  # -1 stands for "never"
    return Curve(group, name, thin.time_ns, values, reference)


def _commanded(tick: Table) -> list[Curve]:
    """Roll and pitch of the commanded attitude."""
    thin = thinned(tick)
    w, x, y, z = thin.vector(*_names("commanded_quaternion", "wxyz")).T
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    pairs = (("commanded roll", roll), ("commanded pitch", pitch))
    return [Curve("attitude [deg]", name, thin.time_ns, values * DEGREES, True) for name, values in pairs]


def _bounds(tick: Table) -> list[Curve]:
    """The tracking error of each channel, by the estimate, and the live bound on it; logs before it have no bound."""
    thin, curves = thinned(tick), []
    position = np.linalg.norm(thin.vector(*_names("position", "ned")) - thin.vector(*_names("target", "ned")), axis=1)
    dot = (thin.vector(*_names("quaternion", "wxyz")) * thin.vector(*_names("commanded_quaternion", "wxyz"))).sum(1)
    attitude = 2.0 * np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    channels = (("position", "m", position, 1.0), ("attitude", "deg", attitude, DEGREES))
    for channel, unit, error, factor in channels:
        group = f"tracking error, {channel} [{unit}]"
        curves.append(Curve(group, "error", thin.time_ns, error * factor))
        if f"{channel}_tracking_bound" in thin:
            bound = thin[f"{channel}_tracking_bound"]
            curves.append(Curve(group, "live bound", thin.time_ns, np.where(bound > 0.0, bound, np.nan) * factor, True))
    return curves


def _weight_limits(flight: Flight, tick: Table) -> list[Curve]:
    """W_max of each channel that has one, from the configuration that onboard attached."""
    config = flight.attachments.get("onboard", {}).get("config.yaml")
    if config is None or len(tick) == 0:
        return []
    ends, curves = tick.time_ns[[0, -1]], []
    tree: Any = None
    with suppress(ConfigError, ValueError):
        tree = parse_yaml(config.decode(), "config.yaml")
    for channel in ("position", "attitude"):
        node = tree
        for key in ("onboard", "controller", "settings", channel, "augmentation", "law", "weight_norm_max"):
            node = node.get(key) if isinstance(node, dict) else None
        if isinstance(node, int | float):
            curves.append(Curve("norm(W)", f"W_max, {channel}", ends, np.full(2, float(node)), True))
    return curves


def _true_disturbance(tick: Table, truth: Table) -> list[Curve]:
    """Delta = v_dot - u_hat, which nu_ad should be: true acceleration minus the estimated delivered one.

    NaN on the floor and below FLOOR_EFFECT_M, where most of Delta comes from the floor.
    """
    tick = _rows(tick, (tick.time_ns >= truth.time_ns[0]) & (tick.time_ns <= truth.time_ns[-1]))
    if len(tick) == 0:
        return []
    curves = []
    height_m = -np.interp(_seconds(tick, tick), _seconds(truth, tick), truth["position_d"])
    channels = (
        ("adaptive, position [m/s²]", "acceleration", "position_delivered", "ned", ("north", "east", "down")),
        ("adaptive, attitude [rad/s²]", "angular_acceleration", "attitude_delivered", "xyz", ("x", "y")),
    )
    for group, true_name, delivered_name, axes, labels in channels:
        for axis, label in zip(axes, labels, strict=False):
            true = np.interp(_seconds(tick, tick), _seconds(truth, tick), truth[f"{true_name}_{axis}"])
            delta = np.where(height_m < FLOOR_EFFECT_M, np.nan, _smoothed(true - tick[f"{delivered_name}_{axis}"]))
            table = thinned(Table("", ("delta",), {}, tick.time_ns, delta[:, None]))
            curves.append(Curve(group, f"true {label}", table.time_ns, table["delta"], True))
    return curves


def _smoothed(values: Array) -> Array:
    """Running mean over SMOOTHING_ROWS, fewer at the ends."""
    kernel = np.ones(min(SMOOTHING_ROWS, len(values)))
    mean: Array = np.convolve(values, kernel, mode="same") / np.convolve(np.ones(len(values)), kernel, mode="same")
    return mean


def _deliveries(delivery: Table) -> list[Curve]:
    """For each direction the delay of each datagram, and the share lost of those sent in the last LOSS_WINDOW_NS."""
    curves = []
    for number, name in enumerate(("up", "down")):  # as in sim_vehicle.link.radio.DIRECTIONS
        rows = delivery["direction"] == number
        sent_ns, delay_ns = delivery.time_ns[rows], delivery["delay_ns"][rows]
        lost = np.cumsum(delay_ns < 0)
        first = np.searchsorted(sent_ns, sent_ns - LOSS_WINDOW_NS)
        count = np.arange(1, len(sent_ns) + 1) - first
        before = np.where(first > 0, lost[first - 1], 0) if len(sent_ns) else lost
        share = 100.0 * (lost - before) / np.maximum(count, 1)
        curves.append(Curve("datagrams lost in 1 s [%]", name, sent_ns, share))
        delay_ms = np.where(delay_ns < 0, np.nan, delay_ns * 1e-6)
        curves.append(Curve("delay of datagrams [ms]", name, sent_ns, delay_ms))
    return curves


def _seconds(table: Table, zero: Table) -> Array:
    return table.seconds(int(zero.time_ns[0]))


def _motion(tick: Table | None, truth: Table | None) -> Motion | None:
    """Motion from the simulator's truth if it was logged, else from onboard's estimate."""
    source = truth if truth is not None else tick
    if source is None:
        return None
    thin = thinned(source)
    arrows: dict[str, Array] = {}
    for name, column in (("wind", "wind"), ("disturbance", "disturbance_force")):
        if f"{column}_n" in thin:
            arrows[name] = thin.vector(*_names(column, "ned"))
    if "disturbance" in arrows:  # on the floor it is the force of the floor
        arrows["disturbance"][-thin["position_d"] < FLOOR_EFFECT_M] = 0.0
    if tick is not None:
        arrows["nu_ad"] = _at(thin, tick, _names("position_adaptive", "ned"))
    return Motion(
        thin.time_ns,
        thin.vector(*_names("position", "ned")),
        thin.vector(*_names("quaternion", "wxyz")),
        thin.vector(*_names("motor_thrust", "1234")),
        arrows,
    )


def _at(table: Table, source: Table, names: Sequence[str]) -> Array:
    """Columns of `source`, interpolated at the times of `table`."""
    at, times = _seconds(table, table), _seconds(source, table)
    return np.column_stack([np.interp(at, times, source[name]) for name in names])
