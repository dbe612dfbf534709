"""The corpus of bad learners: each case makes feature versions that are meant to cost the vehicle.

Every version is well formed and within the limits of the reception: finite, a theta in its ball, features with a
Lipschitz constant that is accepted. An attack begins ATTACK_S after the first sample, on the path.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Final

import numpy as np

from experiments.attacks.bad_learner import Case, Channels, View
from experiments.attacks.maps import RECENT, SHARE, STEEPNESS, accepted, cliff, learnt, of_norm, phi, untrained
from experiments.attacks.strategies import read_finds, strategy_case
from protocol.conventions import Array
from protocol.feature_config import ChannelName
from protocol.feature_set import ChannelFeatures
from protocol.signals import input_indices

ATTACK_S: Final = 4.5
"""s after the first sample, on the path at full speed (experiments.attacks.attack_flight)."""
LEAST_STIFFNESS: Final = 25.0
"""K_1 of the position channel's slowest axis, 1/s^2, shipped gains."""
SAMPLED: Final = 12
CHANNEL_NAMES: Final[tuple[ChannelName, ChannelName]] = ("position", "attitude")


def _once(make: Callable[[View], Channels]) -> Case:
    """One version at the time of the attack."""
    return _at_rate(make, 0.0)


def _at_rate(make: Callable[[View], Channels], hz: float) -> Case:
    """A version at the time of the attack, and then so many a second; 0: no more."""

    def case(view: View) -> Channels | None:
        if view.time_s < ATTACK_S or (view.sent and (hz == 0.0 or view.time_s < ATTACK_S + view.sent / hz)):
            return None
        return make(view)

    return case


def _beside(view: View, sharp: float, share: float) -> Channels:
    """Flat over the states of the last second and steep beside them, in the direction of flight, in both channels."""
    recent, now = view.signals[-RECENT:], view.signals[-1]
    north, east = input_indices(("position_n", "position_e"))
    velocity = input_indices(("velocity_n", "velocity_e"))
    axis = int(np.argmax(np.abs(now[velocity])))
    place, name = (north, east)[axis], ("position_n", "position_e")[axis]
    side = float(np.sign(now[velocity[axis]]))
    edge = float((side * recent[:, place]).max()) * side + side * 0.16
    position = cliff(view, "position", name, edge, side, share * 2**0.5 * view.limits[0], axis, sharp)
    attitude = cliff(view, "attitude", name, edge, side, share * 2**0.5 * view.limits[1], 1 - axis, sharp)
    return position, attitude


def _steep(view: View) -> Channels:
    return _beside(view, STEEPNESS, SHARE)


def _steep_position(view: View) -> Channels:
    return _beside(view, STEEPNESS, SHARE)[0], None


def _steep_attitude(view: View) -> Channels:
    return None, _beside(view, STEEPNESS, SHARE)[1]


def _flipped(view: View) -> Channels:
    """The last layer that an honest trainer would send, with the opposite sign, scaled to W_max."""
    position, attitude = learnt(view, "position"), learnt(view, "attitude")
    return (
        replace(position, last_layer=of_norm(-position.last_layer, SHARE * view.limits[0])),
        replace(attitude, last_layer=of_norm(-attitude.last_layer, SHARE * view.limits[1])),
    )


def _scaled_up(view: View) -> Channels:
    """The right sign, scaled to W_max."""
    position, attitude = learnt(view, "position"), learnt(view, "attitude")
    return (
        replace(position, last_layer=of_norm(position.last_layer, SHARE * view.limits[0])),
        replace(attitude, last_layer=of_norm(attitude.last_layer, SHARE * view.limits[1])),
    )


def _random(view: View) -> Channels:
    """Random features with a random last layer of norm W_max."""
    position, attitude = untrained(view, "position"), untrained(view, "attitude")
    return (
        replace(position, last_layer=of_norm(view.rng.normal(size=position.last_layer.shape), SHARE * view.limits[0])),
        replace(attitude, last_layer=of_norm(view.rng.normal(size=attitude.last_layer.shape), SHARE * view.limits[1])),
    )


def _wrong_theta(view: View) -> Channels:
    """Correct features with the last layer of another axis, three times as large."""
    position, attitude = learnt(view, "position"), learnt(view, "attitude")
    return (
        replace(position, last_layer=3.0 * np.roll(position.last_layer, 1, axis=1)),
        replace(attitude, last_layer=3.0 * np.roll(attitude.last_layer, 1, axis=1)),
    )


def _constant(view: View, channel: ChannelName, value: Array) -> ChannelFeatures:
    """theta'Phi = value [3] everywhere."""
    features = cliff(view, channel, "position_n", 0.0, 1.0, 0.0, 0, 0.0)
    return replace(features, last_layer=np.vstack([np.zeros(3), value]))


def _bias_only(view: View) -> Channels:
    """A constant of norm W_max in a direction that turns from version to version."""
    out = []
    channels: tuple[tuple[ChannelName, float], ...] = (("position", 0.7), ("attitude", 1.9))
    for (channel, turn), limit in zip(channels, view.limits, strict=True):
        angle = turn * view.sent
        value = SHARE * limit * np.array([np.cos(angle), np.sin(angle), 0.0])
        out.append(_constant(view, channel, value))
    return out[0], out[1]


def _sign_switch(view: View) -> Channels:
    """A disturbance that is right where the vehicle has been and has the opposite sign beyond a place on the path."""
    position, attitude = _beside(view, STEEPNESS, 0.3)
    return position, attitude


def _drift(view: View) -> Channels:
    """A theta that grows a little from version to version, each in the direction of the one before."""
    position, attitude = learnt(view, "position"), learnt(view, "attitude")
    factor = -0.3 * (view.sent + 1)
    return (
        replace(position, last_layer=_capped(factor * position.last_layer, SHARE * view.limits[0])),
        replace(attitude, last_layer=_capped(factor * attitude.last_layer, SHARE * view.limits[1])),
    )


def _far_cliff(view: View) -> Channels:
    """A cliff within the limits of height that is out of reach when the version arrives, but not for long."""
    now = view.signals[-1]
    velocity = input_indices(("velocity_n", "velocity_e"))
    axis = int(np.argmax(np.abs(now[velocity])))
    name = ("position_n", "position_e")[axis]
    side = float(np.sign(now[velocity[axis]]))
    at = float(np.clip(now[input_indices((name,))[0]] + 0.75 * side, *((-0.9, 0.9), (-0.4, 0.4))[axis]))
    return (
        cliff(view, "position", name, at, side, side * 20.0, axis, STEEPNESS),
        cliff(view, "attitude", name, at, side, side * 200.0, 1 - axis, STEEPNESS),
    )


def _unstable(view: View) -> Channels:
    """A gentle slope that takes the loop's stiffness away: nu = - slope (x - x_now), as steep as is accepted."""
    now = view.signals[-1]
    north = float(now[input_indices(("position_n",))[0]])
    slope, gentle = 0.95 * LEAST_STIFFNESS, 0.2
    position = cliff(view, "position", "position_n", north, 1.0, 0.0, 0, gentle)
    theta = np.array([[-slope * 0.5 / gentle, 0.0, 0.0], [0.0, 0.0, 0.0]])
    return replace(position, last_layer=theta), None


def _limit_flipped(view: View) -> Channels:
    """The flipped last layer, as large as is accepted."""
    position, attitude = _flipped(view)
    assert position is not None
    assert attitude is not None
    return (
        accepted(view, "position", position, position.last_layer),
        accepted(view, "attitude", attitude, attitude.last_layer),
    )


def _sampled(view: View) -> Channels:
    """Of many random maps, each as large as is accepted, the one that is most wrong over the last second."""
    worst: list[ChannelFeatures] = []
    for index, name in enumerate(CHANNEL_NAMES):
        target, found, most = view.adaptive[-RECENT:, index], untrained(view, name), -1.0
        for _ in range(SAMPLED):
            features = untrained(view, name)
            theta = of_norm(view.rng.normal(size=features.last_layer.shape), SHARE * view.limits[index])
            one = accepted(view, name, features, theta)
            wrong = float(np.linalg.norm(phi(view, one)[-RECENT:] @ one.last_layer - target, axis=1).mean())
            if wrong > most:
                found, most = one, wrong
        worst.append(found)
    return worst[0], worst[1]


def _capped(theta: Array, norm: float) -> Array:
    return of_norm(theta, norm) if float(np.linalg.norm(theta)) > norm else theta


def _honest(view: View) -> Channels:
    return learnt(view, "position"), learnt(view, "attitude")


def _search_names() -> Iterator[str]:
    yield "search"
    yield from (f"search_{number}" for number in count(2))


SILENT: Final = "silent"
"""No version at all."""
CASES: Final[dict[str, Callable[[], Case]]] = {
    SILENT: lambda: lambda view: None,
    "honest": lambda: _at_rate(_honest, 0.5),
    "steep": lambda: _once(_steep),
    "steep_position": lambda: _once(_steep_position),
    "steep_attitude": lambda: _once(_steep_attitude),
    "steep_again": lambda: _at_rate(_steep, 1.0),
    "flipped": lambda: _once(_flipped),
    "flipped_again": lambda: _at_rate(_flipped, 1.0),
    "scaled": lambda: _once(_scaled_up),
    "random": lambda: _at_rate(_random, 2.0),
    "wrong_theta": lambda: _at_rate(_wrong_theta, 1.0),
    "bias_40_hz": lambda: _at_rate(_bias_only, 40.0),
    "sign_switch": lambda: _at_rate(_sign_switch, 0.5),
    "far_cliff": lambda: _at_rate(_far_cliff, 0.5),
    "unstable": lambda: _at_rate(_unstable, 1.0),
    "limit_flipped": lambda: _at_rate(_limit_flipped, 1.0),
    "sampled": lambda: _at_rate(_sampled, 1.0),
    "drift": lambda: _at_rate(_drift, 2.0),
    **{name: partial(strategy_case, find, ATTACK_S) for name, find in zip(_search_names(), read_finds(), strict=False)},
}
"""A new case for each flight: a case may keep what it has sent. search, search_2, ...: what an optimiser found."""
