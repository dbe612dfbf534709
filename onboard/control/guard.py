"""The guard: no feature version, and nothing that the adaptation does, may cost the vehicle.

Theory of operation
-------------------
The architecture is Simplex (Sha, "Using simplicity to control complexity", IEEE Software 2001): a law that performs, a
law that is simple, and a decision between them that depends on the simple one alone. Here the law that performs is the
one with learnt features. There are two simple ones: the bias-only law, into which no byte from offboard goes, and none
at all, the loop with its feed-forward. The decision uses measurements of this vehicle only.

1. **Room** (onboard.control.room): nu_ad is bounded per axis by what the actuators give beside the loop's own need.
2. **Test** (onboard.control.version_test): a version is tested before it flies, and the map that flies every `check_s`
   on what is ahead by then. Swaps a second, and their summed jump, are limited.
3. **Probation** (onboard.control.watch): the map is compared with the bias-only law in every tick. Worse for 0.3 s:
   back to the last good version with its W, then to the bias-only law, then to none. Each step is an event and a
   refusal for the trainer.
4. **Proof**: a version is good when evidence says so: `proof_s` in which it disagreed with the bias-only law and was no
   worse. Time alone proves nothing. The newest good version and its W are kept, whatever the trainer does.
5. **Audition**: a version that arrives on the ground, or while a simpler law flies, runs beside the bias-only law
   first. It flies after `audition_s` of evidence. Without evidence, after `agreement_s` in the air in which it said
   what the bias says: it then changes nothing, and is on probation like a version that arrives in flight. A map that
   failed, and any version after `losses_max` in a row that lost to the bias, need evidence.
6. **Memory**: the content of a version that was taken back is never accepted again, under no number. After
   `strikes_max` of them no version is accepted for the rest of the session.

What is left after all of it: for 0.3 s a wrong nu_ad within its room can act. docs/guard.md has promises and figures.
"""

import hashlib
from collections import deque
from collections.abc import Sequence
from enum import IntEnum
from typing import Annotated, Final, NamedTuple

import numpy as np
from pydantic import Field

from configs.loader import ConfigRecord
from onboard.control.airframe import AirframeConfig
from onboard.control.feature_swap import SwapPlan
from onboard.control.features import Features
from onboard.control.laws.adaptive import AdaptiveAugmentation, Learnt
from onboard.control.laws.law import Augmentation, ChannelState
from onboard.control.records import ChannelTelemetry, ControlInputs
from onboard.control.reference_model import ChannelGains
from onboard.control.room import Room, RoomConfig
from onboard.control.version_test import VersionTest, VersionTestConfig
from onboard.control.watch import ChannelWatch, WatchConfig
from protocol.conventions import Array
from protocol.feature_set import FeatureSet
from protocol.geometry import Vector3, vector
from protocol.signals import CHANNELS

Plan = tuple[int, Features, SwapPlan]
"""Channel, features, and what flies with them."""


class GuardConfig(ConfigRecord):
    """The guard of a controller with learnt features."""

    room: RoomConfig = RoomConfig()
    test: VersionTestConfig = VersionTestConfig()
    watch: WatchConfig = WatchConfig()
    swaps_per_s_max: Annotated[float, Field(ge=0.1, le=1e4, description="1/s, accepted versions")] = 4.0
    jumps_max: Annotated[
        float, Field(gt=0, le=1e4, description="summed jumps of nu_cmd in a second, over jump_max of the channel")
    ] = 2.0
    strikes_max: Annotated[
        int, Field(ge=1, le=10**6, description="versions taken back, after which no other is accepted")
    ] = 3
    losses_max: Annotated[
        int,
        Field(ge=1, le=10**6, description="versions in a row that lost when the next came, before each is auditioned"),
    ] = 3


class Level(IntEnum):
    """The law that flies."""

    MAP = 0
    BIAS = 1
    NONE = 2


LOSES_S: Final = 0.3
"""Evidence after which a version that loses is taken back when the next one comes, s."""
LAWS: Final = {Level.MAP: "the learnt features", Level.BIAS: "the bias alone", Level.NONE: "no adaptation"}


class Fall(NamedTuple):
    """A step back, or up again: for the events, the ground station and the trainer."""

    refused: int
    """The version taken back; 0 if none is."""
    flying: int
    """The version in use now."""
    text: str


class Kept(NamedTuple):
    """A version that may be needed again, with all that the laws had learnt with it."""

    version: int
    content: bytes
    learnt: tuple[Learnt | None, Learnt | None]


def content_of(features: FeatureSet) -> bytes:
    """Digest of what a version would fly: the same for the same content under another number."""
    digest = hashlib.blake2b(digest_size=16)
    for channel in features.by_channel:
        for array in () if channel is None else (channel.offset, channel.scale, *channel.parameters):
            digest.update(np.ascontiguousarray(array).tobytes())
        digest.update(b"|")
    return digest.digest()


class Guard:
    """Stands between the laws of both channels and the loops."""

    def __init__(
        self,
        config: GuardConfig,
        augmentations: tuple[Augmentation, Augmentation],
        gains: tuple[ChannelGains, ChannelGains],
        airframe: AirframeConfig,
        tilt_max_rad: float,
    ) -> None:
        self._config, self._augmentations = config, augmentations
        self._room = Room(config.room, airframe, tilt_max_rad)
        self._learners: dict[int, AdaptiveAugmentation] = {
            i: one for i, one in enumerate(augmentations) if isinstance(one, AdaptiveAugmentation) and one.learns
        }
        self._watches = {i: self._watch(i, one, gains[i]) for i, one in self._learners.items()}
        self._tests = {i: VersionTest(config.test, i, one.slope_limits) for i, one in self._learners.items()}
        self.level = Level.MAP
        self.version = 0
        self.limited = [0, 0]
        """Ticks in which the room was too small, per channel."""
        self._good = Kept(0, b"", self._learnt())
        self._proven = True
        self._content: bytes = b""
        self._refused: set[bytes] = set()
        self._strikes = 0
        self._losses = 0
        """Versions in a row that had lost to the bias when the next one came."""
        self._needs_evidence = False
        """A map that says what the bias says may not fly for that alone."""
        self._falls: list[Fall] = []
        self._swaps: deque[tuple[float, float]] = deque()
        """Time and jump of each swap of the last second."""
        self._time_s, self._next_check_s = 0.0, 0.0
        self._due: list[int] = []
        self._adapting = False

    def _watch(self, channel: int, learner: AdaptiveAugmentation, gains: ChannelGains) -> ChannelWatch:
        law = learner.last_layer.config
        rates = law.composite_gain, law.tracking_gain
        return ChannelWatch(
            self._config.watch, channel, (gains.stiffness(), gains.rate_gain()), rates, learner.tracking_weights
        )

    def _learnt(self) -> tuple[Learnt | None, Learnt | None]:
        position, attitude = (self._learners[i].learnt() if i in self._learners else None for i in (0, 1))
        return position, attitude

    # --- every tick --------------------------------------------------------------------------------------------------

    def step(self, channel: int, state: ChannelState, telemetry: ChannelTelemetry, inputs: ControlInputs) -> Array:
        """One tick of a channel's law; returns the nu_ad [3] to command and writes it into the telemetry."""
        demand, before = telemetry.demand.tolist(), telemetry.adaptive.tolist()
        nu = self._augmentations[channel].step(state, telemetry)
        learner = self._learners.get(channel)
        if learner is None:
            telemetry.adaptive[:] = nu
            return nu
        watch = self._watches[channel]
        if state.adapt:
            watch.step(state, telemetry.residual, telemetry.adaptive_now, nu, self.level)
        commanded = vector(nu.tolist())
        if self.level is not Level.MAP:
            commanded = watch.d if self.level is Level.BIAS else (0.0, 0.0, 0.0)
            telemetry.adaptive_now[:] = commanded
        if self._config.room.enabled:
            (x, y, z), (a, b, c) = demand, before
            (thrust_n, scale), need = inputs.thrust, (x + a, y + b, z + c)
            room = self._room.attitude(scale, thrust_n, need) if channel else self._room.position(scale, need)
            telemetry.room[:] = room
            bounded = _within(commanded, room)
            self.limited[channel] += bounded != commanded
            commanded = bounded
            telemetry.adaptive_now[:] = _within(vector(telemetry.adaptive_now.tolist()), room)
        telemetry.adaptive[:] = commanded
        return telemetry.adaptive

    def judge(self, dt: float, adapting: bool) -> None:
        """Decide, once a tick and after both channels, which law flies from the next tick on."""
        self._time_s += dt
        self._adapting = adapting
        if not self._learners or not adapting or not self._config.watch.enabled:
            return None
        watch = self._config.watch
        for channel, one in self._watches.items():
            if one.failed and self.level is not Level.NONE:
                return self._fall(f"{one.worse(self.level, self.level + 1) or 'misfit'} of {CHANNELS[channel]}")
        if self.level is Level.MAP:
            if not self._proven and all(one.stands(watch.proof_s) for one in self._informed(watch.proof_s)):
                self._proven = bool(self._informed(watch.proof_s))
                self._losses = 0 if self._proven else self._losses
            return self._look_ahead()
        if self.level is Level.BIAS and self._may_fly(watch):
            self._enter(Level.MAP)
            self._say(0, f"version {self.version} flies after its audition")
        return None

    def _informed(self, evidence_s: float) -> list[ChannelWatch]:
        """The channels with enough evidence."""
        return [one for one in self._watches.values() if one.evidence_s >= evidence_s]

    def _may_fly(self, watch: WatchConfig) -> bool:
        """Whether the map that runs beside the bias-only law has passed its audition."""
        informed, every = self._informed(watch.audition_s), self._watches.values()
        agrees = not self._needs_evidence and all(one.agreed_s >= watch.agreement_s for one in every)
        return (
            self._strikes < self._config.strikes_max
            and (bool(informed) or agrees)
            and all(one.stands(watch.audition_s) for one in informed)
            and not any(one.worse(0, 1) for one in every)
        )

    def _look_ahead(self) -> None:
        """Check the map that flies on what is ahead now, one channel in a tick."""
        if not self._config.test.enabled or self.version == 0:
            return
        if not self._due and self._time_s >= self._next_check_s:
            self._next_check_s = self._time_s + self._config.test.check_s
            self._due = list(self._learners)
        if self._due:
            channel = self._due.pop()
            learner, test = self._learners[channel], self._tests[channel]
            if not test.still_good(learner.features, learner.prior_layer, learner.signals_now):
                self._fall(f"steep or high ahead in {CHANNELS[channel]}")

    # --- back and up -------------------------------------------------------------------------------------------------

    def _fall(self, reason: str) -> None:
        """One step back: to the last good version, or to the next simpler law."""
        bad = self.version if self.level is Level.MAP else 0
        back = self.level is Level.MAP and self.version != self._good.version
        if bad:
            self._strikes += 1
            self._refused.add(self._content)
        if back:
            self._take_back(reason)
        else:
            self._needs_evidence = True
            self._enter(Level(self.level + 1))
            self._say(bad, f"{reason}: {LAWS[self.level]} flies")

    def _take_back(self, reason: str) -> None:
        """From an unproven version to the last good one, and what the law had learnt with it."""
        bad = self.version
        for channel, learner in self._learners.items():
            kept = self._good.learnt[channel]
            assert kept is not None
            learner.restore(kept, self._watches[channel].d)
        self.version, self._content, self._proven = self._good.version, self._good.content, True
        self._enter(Level.MAP)
        self._say(bad, f"{reason}: version {bad} taken back, version {self.version} flies")

    def _loses(self) -> bool:
        """Whether the version that flies is worse than the bias so far, in a channel that has some evidence."""
        return any(one.loses(LOSES_S) for one in self._watches.values())

    def _enter(self, level: Level) -> None:
        self.level = level
        for one in self._watches.values():
            one.restart()

    def _say(self, refused: int, text: str) -> None:
        self._falls.append(Fall(refused, self.version, f"guard: {text}"))

    def take_falls(self) -> list[Fall]:
        """Return and clear what happened since the last call."""
        falls, self._falls = self._falls, []
        return falls

    def reset(self) -> None:
        """On the ground: what was measured in the air is void. Versions and their W stay."""
        for one in self._watches.values():
            one.reset()
            one.restart()
        if self.level is Level.NONE:
            self.level = Level.BIAS
        self._adapting = False

    # --- versions ----------------------------------------------------------------------------------------------------

    def offer(self, features: FeatureSet) -> str:
        """Test a version and swap to it, in both channels or none; returns "" or the refusal."""
        if not any(features.by_channel[i] is not None for i in self._learners):
            return "not_accepting"
        content = content_of(features)
        if content in self._refused:
            return "taken_back"
        if self._strikes >= self._config.strikes_max:
            return "not_trusted"
        plans, refusal = self._plans(features)
        refusal = refusal or self._too_often(plans)
        watched = self._config.watch.enabled and self.level is Level.MAP and not self._proven
        if plans and not refusal and watched and self._loses():
            self._losses += 1
            self._take_back("misfit of the version before")
            plans, refusal = self._plans(features)
        if refusal:
            return refusal
        if not plans:
            self._renumber(features.version)
            return ""
        if self._proven and self.level is Level.MAP:
            self._good = Kept(self.version, self._content, self._learnt())
        for channel, new, plan in plans:
            self._learners[channel].commit(new, plan)
        self.version, self._content, self._proven = features.version, content, False
        self._needs_evidence = self._losses >= self._config.losses_max
        at_once = self._adapting and self.level is Level.MAP and not self._needs_evidence
        self._enter(Level.MAP if at_once or not self._config.watch.enabled else Level.BIAS)
        return ""

    def _renumber(self, version: int) -> None:
        """What flies has come again under another number: a later refusal names the one that the trainer knows."""
        if self._good.version == self.version:
            self._good = self._good._replace(version=version)
        self.version = version

    def _plans(self, features: FeatureSet) -> tuple[list[Plan], str]:
        plans: list[Plan] = []
        for i, learner in self._learners.items():
            channel = features.by_channel[i]
            if channel is None or learner.flies(channel):
                continue  # a swap would forget S
            new, plan = learner.plan(channel)
            refusal = plan.refusal
            if not refusal and self._config.test.enabled:
                refusal = self._tests[i].refusal(new, learner.prior_of(plan), learner.signals_now, *learner.recent)
            if refusal:
                return [], refusal
            plans.append((i, new, plan))
        return plans, ""

    def _too_often(self, plans: Sequence[Plan]) -> str:
        """Whether one more swap would be too many in a second, or too much."""
        jump = sum(plan.step / self._learners[i].jump_max for i, _, plan in plans)
        while self._swaps and self._swaps[0][0] < self._time_s - 1.0:
            self._swaps.popleft()
        jumps = sum(one for _, one in self._swaps) + jump
        if len(self._swaps) + 1 > self._config.swaps_per_s_max or jumps > self._config.jumps_max:
            return "swap_rate"
        if plans:
            self._swaps.append((self._time_s, jump))
        return ""


def _within(nu: Vector3, room: Vector3) -> Vector3:
    (x, y, z), (a, b, c) = nu, room
    return min(max(x, -a), a), min(max(y, -b), b), min(max(z, -c), c)
