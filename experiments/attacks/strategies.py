"""Bad learners with parameters, for an optimiser to make worse: the family that experiments.attacks.search searches.

A version's map is a mixture, in each channel, of what a bad learner may know to do harm: the honest map or its
opposite, slopes over place and velocity that take stiffness or damping away or couple the axes, a step at a place
ahead, and a constant. The mixture is then made as large as onboard's own test accepts now, times `share`. When the
versions come, and whether they change sign, are parameters too.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from configs.loader import ConfigError
from experiments.attacks.bad_learner import Case, Channels, View
from experiments.attacks.maps import RECENT, SHARE, STEEPNESS, Units, accepted, least_squares, of_norm, untrained
from onboard.control.features import random_channel
from protocol.conventions import Array
from protocol.feature_config import ChannelName
from protocol.feature_set import ChannelFeatures
from protocol.signals import input_indices


class Range(NamedTuple):
    """One parameter of the family."""

    low: float
    high: float
    log: bool = False


_SIGNED: Final = Range(-1.0, 1.0)
_MIXTURE: Final = ("honest", "place", "place_swirl", "motion", "motion_swirl", "step", "step_across", "along", "across")
"""Weights of the parts of a map, of both channels. A swirl pushes across instead of along."""
RANGES: Final[dict[str, Range]] = {
    "delay_s": Range(0.0, 1.5),
    "period_s": Range(0.26, 3.0),
    "alternate": _SIGNED,
    "share": Range(0.2, 1.0),
    "step_ahead_m": Range(0.05, 1.2, log=True),
    "step_sharpness": Range(1.0, STEEPNESS, log=True),
    **{f"{channel}_{part}": _SIGNED for channel in ("position", "attitude") for part in _MIXTURE},
}
HONEST_UNITS: Final = 12
GENTLE: Final = 0.2
"""Of the units that are to be straight over the whole path: scaled input to tanh."""
PLACE: Final = ("position_n", "position_e")
MOTION: Final[dict[ChannelName, tuple[str, str]]] = {
    "position": ("velocity_n", "velocity_e"),
    "attitude": ("body_velocity_x", "body_velocity_y"),
}
FINDS: Final = Path(__file__).with_name("finds.json")

Strategy = Mapping[str, float]
"""A value for each name of RANGES."""


def checked(strategy: Mapping[str, Any], source: str) -> Strategy:
    """The strategy with all its values in their ranges. Raises ConfigError, naming `source` and the value."""
    if missing := sorted(set(RANGES) ^ set(strategy)):
        raise ConfigError(f"{source}: {missing[0]}: missing or unknown; expected are {', '.join(RANGES)}")
    for name, (low, high, _) in RANGES.items():
        value = strategy[name]
        if not isinstance(value, int | float) or not low <= value <= high:
            raise ConfigError(f"{source}: {name}: {value!r} is not between {low} and {high}")
    return {name: float(strategy[name]) for name in RANGES}


def read_finds(path: Path = FINDS) -> list[Strategy]:
    """The worst strategies that a search has found, the worst first. Raises ConfigError."""
    try:
        finds = json.loads(path.read_text(encoding="utf-8"))["finds"]
        return [checked(find["strategy"], f"{path}, find {number}") for number, find in enumerate(finds, start=1)]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: no finds of dmrac attack --search: {error}") from None


def strategy_case(strategy: Strategy, begin_s: float) -> Case:
    """The case of a strategy, which attacks from begin_s on."""

    def case(view: View) -> Channels | None:
        if view.time_s < begin_s + strategy["delay_s"] + view.sent * strategy["period_s"] or not len(view.signals):
            return None
        sign = -1.0 if strategy["alternate"] < 0.0 and view.sent % 2 else 1.0
        return _channel(view, "position", strategy, sign), _channel(view, "attitude", strategy, sign)

    return case


def _channel(view: View, name: ChannelName, strategy: Strategy, sign: float) -> ChannelFeatures:
    """The mixture for one channel, as large as is accepted."""
    weight = {part: sign * strategy[f"{name}_{part}"] for part in _MIXTURE}
    layout = untrained(view, name)
    units = Units(layout)
    nu = view.adaptive[-RECENT:, int(name == "attitude")]
    size = max(float(np.sqrt(np.square(nu).sum(axis=1).mean())), 0.02 * view.limits[int(name == "attitude")])
    now = view.signals[-1]
    honest = _honest(view, name, layout)
    units.add(honest.weights[0], honest.biases[0], weight["honest"] * honest.last_layer[:-1])
    units.constant += weight["honest"] * honest.last_layer[-1]
    for names, along, swirl in (
        (PLACE, weight["place"], weight["place_swirl"]),
        (MOTION[name], weight["motion"], weight["motion_swirl"]),
    ):
        units.add_straight(names, now, GENTLE, size * np.array([[along, -swirl, 0.0], [swirl, along, 0.0]]))
    forward = _forward(now)
    side = np.array([-forward[1], forward[0]])
    step = weight["step"] * forward + weight["step_across"] * side
    at = now[list(input_indices(PLACE))] + strategy["step_ahead_m"] * forward
    units.add_step(PLACE, at, forward, strategy["step_sharpness"], size * np.array([*step, 0.0]))
    units.constant[:2] += size * (weight["along"] * forward + weight["across"] * side)
    features = units.features()
    theta = of_norm(features.last_layer, SHARE * view.limits[int(name == "attitude")])
    largest = accepted(view, name, features, theta)
    return replace(largest, last_layer=strategy["share"] * largest.last_layer)


def _honest(view: View, name: ChannelName, layout: ChannelFeatures) -> ChannelFeatures:
    """One layer of random units with the last layer of least squares."""
    random = random_channel(layout.inputs, layout.offset, layout.scale, (HONEST_UNITS,), view.rng)
    return least_squares(view, name, random)


def _forward(now: Array) -> Array:
    """[2], unit vector of the flight over ground."""
    velocity = now[list(input_indices(("velocity_n", "velocity_e")))]
    speed = float(np.linalg.norm(velocity))
    forward: Array = velocity / speed if speed > 1e-6 else np.array([1.0, 0.0])
    return forward
