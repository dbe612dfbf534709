"""Both cores' guards with their laws side by side, in a synthetic flight: all numbers and decisions are compared."""

import dataclasses
from typing import Any

import numpy as np

from onboard.c.event_text import fall_text
from onboard.c.feature_arrays import put_channel, put_feature_set
from onboard.control.features import NetworkFeatures, random_channel
from onboard.control.laws.adaptive import AdaptiveAugmentation
from onboard.control.laws.law import ChannelState
from onboard.control.records import ChannelTelemetry
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.messages import REFUSALS
from protocol.signals import SIGNAL_COUNT, SIGNAL_INDEX
from tests.onboard.c.parity import call, configured, filled, same, view
from tests.onboard.c.test_laws import c_state
from tests.onboard.control.fixture import AIRFRAME, DT, shipped_controller

SIDES = ("position", "attitude")
NETWORK = {side: {"augmentation": {"features": "network"}} for side in SIDES}
LAWS: dict[str, tuple[str, dict[str, Any]]] = {
    "gradient": ("mrac", NETWORK),
    "covariance": ("dmrac", {}),
    "attitude alone": ("paper_dmrac", {}),
    "without features": ("indi", {}),
}
INPUTS = (
    ("position_n", "position_e", "velocity_n", "velocity_d", "motor_thrust_2"),
    ("roll", "pitch", "rate_p", "rate_q", "velocity_n"),
)
SIZES = 2.0, 40.0
"""Of the disturbance in both channels, units of u."""


def smooth_channel(side: int, seed: int, size: float, gain: float = 1.0) -> ChannelFeatures:
    """Features that vary slowly, with a last layer of this size."""
    rng = np.random.default_rng([seed, side])
    start = random_channel(INPUTS[side], np.zeros(5), np.ones(5), (8, 5), rng)
    last = size * rng.uniform(-1.0, 1.0, (6, 3))
    last[-1] *= 0.3
    return dataclasses.replace(start, weights=tuple(gain * W for W in start.weights), last_layer=last)


class World:
    """What both laws see: a smooth path, and a disturbance that a network explains, times a mood that may change."""

    def __init__(self, seed: int) -> None:
        self.truth = [smooth_channel(side, seed, SIZES[side]) for side in (0, 1)]
        self._features = [NetworkFeatures(one) for one in self.truth]
        self.rng, self.mood, self.noise = np.random.default_rng(seed), 1.0, 0.02
        self.time_s, self.e = 0.0, np.zeros((2, 6))
        self.push = 0.0
        """Added to e in every tick, as a share of SIZES: a loop that goes wrong for a reason of its own."""

    def state(self, side: int, dt: float, adapt: bool, reads_path: bool) -> ChannelState:
        """The channel's inputs of a tick; the vehicle is a little late on its path."""
        times = (self.time_s, self.time_s + 0.1, self.time_s + 0.01)[: 3 if reads_path else 2]
        columns = np.stack([self.signals_at(t) for t in times], axis=1)
        z = self._features[side].select(columns)
        Delta = (self.truth[side].last_layer.T @ self._features[side].evaluate(z))[:, 0]
        residual = self.mood * Delta + self.noise * SIZES[side] * self.rng.normal(size=3)
        state = ChannelState(dt, adapt, residual=residual, signals=columns)
        state.model_error[:] = self.e[side]
        return state

    def signals_at(self, t: float) -> Any:
        """[SIGNAL_COUNT]."""
        signals = np.sin((3.0 + 0.15 * np.arange(SIGNAL_COUNT)) * t + np.arange(SIGNAL_COUNT))  # faster than a bias
        signals[SIGNAL_INDEX["roll"] :][:6] *= 0.3
        signals[SIGNAL_INDEX["motor_thrust_1"] :][:4] += 2.0
        return signals

    def move(self, side: int, dt: float, nu: Any, residual: Any) -> None:
        """e_dot = A_rm e + B (nu - Delta), as in the loop."""
        e, w = self.e[side], (4.0, 16.0)[side]
        e[3:] += dt * (nu - residual + self.push * SIZES[side] - w * w * e[:3] - 1.6 * w * e[3:])
        e[:3] += dt * e[3:]


class Pair:
    """A numpy Guard and its twin, each with its own laws."""

    def __init__(self, core: Any, law: str, guard: dict[str, Any], seed: int = 1) -> None:
        name, settings = LAWS[law]
        controller = shipped_controller(name, {**settings, "guard": guard})
        self.core, self.laws, self.theirs = core, controller.augmentations, controller.guard
        self.c_laws, self.ours = (core.Augmentation * 2)(), core.Guard()
        c_settings, start = configured(core, controller._settings), core.ChannelFeatures()
        for side, one in enumerate(self.laws):
            if isinstance(one, AdaptiveAugmentation):
                put_channel(start, one.features.channel)  # type: ignore[attr-defined]
            core.augmentation_init(self.c_laws[side], c_settings, side, start)
        gains = (
            configured(core, controller._settings.position.gains),
            configured(core, controller._settings.attitude.gains),
        )
        tilt = controller._settings.limits.tilt_max_rad
        airframe = filled(core.AirframeConfig, AIRFRAME)
        core.guard_init(self.ours, c_settings.guard, self.c_laws[0], *gains, airframe, tilt)
        self.telemetry = ChannelTelemetry(), ChannelTelemetry()
        self.c_telemetry = core.ChannelTelemetry(), core.ChannelTelemetry()
        self.world, self.offered = World(seed), core.FeatureSet()
        self.rtol, self.texts, self.refusals = 1e-11, list[str](), list[str]()
        self.same_state()

    def step(self, adapt: bool = True, periods: int = 1, demand: float = 0.0, thrust_n: float = 0.6) -> None:
        """One tick of both channels, and the verdict. demand: of the loops, as a share of SIZES."""
        dt, world = periods * DT, self.world
        world.time_s += dt
        for side in (0, 1):
            state = world.state(side, dt, adapt, getattr(self.laws[side], "reads_path", False))
            nu = self._step_channel(side, state, demand * SIZES[side], thrust_n)
            world.move(side, dt, nu, state.residual)
        self.theirs.judge(dt, adapt)
        self.core.guard_judge(self.ours, self.c_laws[0], dt, adapt, False)
        self.same_state()

    def _step_channel(self, side: int, state: ChannelState, demand: float, thrust_n: float) -> Any:
        one, other = self.telemetry[side], self.c_telemetry[side]
        one.demand[:] = demand - one.adaptive
        view(other.demand)[:] = demand - view(other.adaptive)
        inputs: Any = type("Inputs", (), {"thrust": (thrust_n, 0.9)})
        expected = self.theirs.step(side, state, one, inputs).copy()
        c_inputs = self.core.ControlInputs(thrust_n=thrust_n, thrust_scale=0.9)
        nu = call(
            self.core, "guard_step", self.ours, self.c_laws[0], side, c_state(self.core, state), other, c_inputs, out=3
        )
        scale = SIZES[side]
        same(nu, expected, self.rtol, scale)
        for name in ("adaptive", "adaptive_now", "residual", "room"):
            same(view(getattr(other, name)), getattr(one, name), self.rtol, scale)
        return expected

    def offer(self, features: FeatureSet) -> str:
        """The answer of both."""
        expected: str = self.theirs.offer(features)
        put_feature_set(self.offered, features)
        assert REFUSALS[self.core.guard_offer(self.ours, self.c_laws[0], self.offered)] == expected
        self.rtol = 1e-8  # a swap solves a system
        self.refusals.append(expected)
        self.same_state()
        return expected

    def reset(self) -> None:
        """On the ground."""
        self.theirs.reset()
        self.core.guard_reset(self.ours)
        for one, other in zip(self.laws, self.c_laws, strict=True):
            one.reset()
            self.core.augmentation_reset(other)
        self.world.e[:] = 0.0
        self.same_state()

    def same_state(self) -> None:
        """Everything that the guard decides by, and the falls."""
        ours, theirs, core = self.ours, self.theirs, self.core
        falls = (core.Fall * 8)()
        texts = [(one.refused, one.flying, fall_text(one)) for one in falls[: core.guard_take_falls(ours, falls[0])]]
        expected = theirs.take_falls()
        assert texts == [tuple(one) for one in expected]
        self.texts += [one.text for one in expected]
        assert (ours.level, ours.version, ours.proven) == (theirs.level, theirs.version, theirs._proven)
        assert (ours.strikes, ours.refused_count, list(ours.limited)) == (
            theirs._strikes,
            len(theirs._refused),
            theirs.limited,
        )
        assert (ours.losses, ours.needs_evidence) == (theirs._losses, theirs._needs_evidence)
        assert ours.good.version == theirs._good.version
        assert (ours.time_s, ours.next_check_s, ours.swap_count) == (
            theirs._time_s,
            theirs._next_check_s,
            len(theirs._swaps),
        )
        assert [side for side in (0, 1) if ours.due[side]] == theirs._due
        assert [ours.tests[side].looks for side in theirs._tests] == [one.looks for one in theirs._tests.values()]
        for side, watch in theirs._watches.items():
            own, scale = ours.watches[side], SIZES[side] ** 2
            same(view(own.d), watch.d, self.rtol, SIZES[side])
            same([own.worse_s, own.evidence_s, own.agreed_s], [watch._worse_s, watch.evidence_s, watch.agreed_s], 1e-12)
            same(
                [*own.misfits, *own.errors, own.gain], [*watch._misfits, *watch._errors, watch._gain], self.rtol, scale
            )
