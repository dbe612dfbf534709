"""A feature version is prepared in parts, one a tick, before it is swapped in one tick.

Planning a swap takes longer than a tick: numpy's several milliseconds, a second of a processor without floating point.
So each channel's features, slopes and filter (onboard.control.posterior_swap) and its test on what is ahead
(onboard.control.version_test) are done in parts of bounded size. The number of parts depends on the sizes of the
networks and on the states in the ring, on nothing measured, so that a flight repeats to the bit.

- The map on the states ahead comes last, so that they are at most some 0.1 s old when the version flies.
- The law, the jump and the room of swaps are judged in the tick of the swap alone (Guard).
- If what flies changes meanwhile, because the guard takes a version back, the preparation starts again.
- A version that comes meanwhile waits (onboard.control.feature_reception).

Law (2) has no preparation: its W_new comes from the W that flies. It is planned and tested in the tick of the swap.
"""

from collections.abc import Mapping
from typing import NamedTuple

from onboard.control.feature_swap import SwapPlan
from onboard.control.features import Features
from onboard.control.laws.adaptive import AdaptiveAugmentation
from onboard.control.posterior_swap import PosteriorSwap
from onboard.control.version_test import AHEAD_PER_PART, BOX_SLOPES_PER_PART, VersionTest
from protocol.feature_set import ChannelFeatures, FeatureSet


class Plan(NamedTuple):
    """What is to fly in a channel."""

    channel: int
    features: Features
    swap: SwapPlan


class Preparation:
    """One version: of the channels whose features would change; a swap to the same would forget S."""

    def __init__(
        self,
        features: FeatureSet,
        content: bytes,
        replaces: tuple[int, bytes],
        learners: Mapping[int, AdaptiveAugmentation],
        tests: Mapping[int, VersionTest],
    ) -> None:
        """replaces: number and content of what flies. learners, tests: by channel; no tests: they are off."""
        self.features, self.content, self.replaces = features, content, replaces
        self._learners, self._tests = learners, tests
        self._sources: dict[int, ChannelFeatures] = {}
        for i, learner in learners.items():
            channel = features.by_channel[i]
            if channel is not None and not learner.flies(channel):
                self._sources[i] = channel
        self._swaps: dict[int, PosteriorSwap] = {}
        for i, channel in self._sources.items():
            swap = learners[i].prepare(channel)
            if swap is not None:
                self._swaps[i] = swap
        self._swapping, self._looking = list(self._swaps), [i for i in self._swaps if i in tests]
        self._sloping = list(self._looking)
        self._begun = False
        """Whether the slopes in the box, or the look ahead, of a channel have begun."""
        self.refusal = ""

    def step(self) -> bool:
        """One part; whether all are done."""
        for swap in self._swaps.values():
            swap.follow()
        if self._swapping:
            swap = self._swaps[self._swapping[0]]
            if swap.step():
                self._swapping.pop(0)
            self.refusal = swap.refusal
        elif self._sloping:
            self._check_slopes(self._sloping[0])
        elif self._looking:
            self._look_ahead(self._looking[0])
        return bool(self.refusal) or not (self._swapping or self._looking)

    def _check_slopes(self, channel: int) -> None:
        """At some states of the box around the vehicle as it was at the first part."""
        swap, ahead = self._swaps[channel], self._tests[channel].ahead
        if not self._begun:
            ahead.begin_slopes(self._learners[channel].signals_now)
        self._begun = not ahead.steepest(swap.new, swap.theta, BOX_SLOPES_PER_PART)
        if not self._begun:
            self._sloping.pop(0)

    def _look_ahead(self, channel: int) -> None:
        """Some states ahead of the vehicle, from where it was at the first part."""
        swap, ahead = self._swaps[channel], self._tests[channel].ahead
        if not self._begun:
            ahead.begin(self._learners[channel].signals_now)
        self._begun = not ahead.step(swap.new, swap.theta, AHEAD_PER_PART)
        if not self._begun:
            self._looking.pop(0)

    def plans(self) -> tuple[list[Plan], str]:
        """What is to fly, once all parts are done, and "" or the refusal."""
        plans: list[Plan] = []
        for i, channel in self._sources.items():
            learner, swap = self._learners[i], self._swaps.get(i)
            new, plan = learner.plan(channel) if swap is None else (swap.new, learner.planned(swap))
            refusal = plan.refusal or self._verdict(i, new, plan)
            if refusal:
                return [], refusal
            plans.append(Plan(i, new, plan))
        return plans, ""

    def _verdict(self, channel: int, new: Features, plan: SwapPlan) -> str:
        test, swap, learner = self._tests.get(channel), self._swaps.get(channel), self._learners[channel]
        if test is None:
            return ""
        if swap is None:
            return test.refusal(new, learner.prior_of(plan), learner.signals_now, *learner.recent)
        return test.verdict(swap.theta, *swap.measured, float(swap.shares.max()))
