"""A peer that lies: it relays the motion capture like offboard, and sends feature versions that are to do harm.

It takes the place of the offboard core in a lockstep flight. It has the key, a right layout and an honest clock:
nothing but the content of its versions is wrong. What it sends is a case (experiments.attacks.cases).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from configs.loader import fill
from experiments.flights.scenario import FlightConfig
from offboard.core import OffboardOutput
from offboard.links.pose_relay import PoseRelay
from offboard.training.job import TrainingResult
from onboard.control.cascade import CascadeSettings
from onboard.control.features import NetworkFeatures
from onboard.control.slope import SlopeLimits
from onboard.control.version_test import VersionTest
from protocol.config import TransferConfig
from protocol.conventions import Array
from protocol.endpoint import Endpoint
from protocol.feature_config import ChannelName, TrainedFeatures, feature_digest
from protocol.feature_set import ChannelFeatures, FeatureSet
from protocol.keys import load_key
from protocol.messages import REFUSALS, Message, Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.transfer import FeatureSender

TRANSFER: Final = TransferConfig(dtype="float32", chunks_per_second=1000.0, chunks_per_poll=16)


@dataclass
class View:
    """What a bad learner knows when it makes a version: what an honest one is told, and the limits."""

    networks: TrainedFeatures
    limits: tuple[float, float]
    """W_max of the two channels."""
    tests: tuple[VersionTest, VersionTest]
    """The test that onboard makes, with its limits."""
    rng: np.random.Generator
    time_s: float = 0.0
    """s since the first sample."""
    signals: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """[n, SIGNAL_COUNT], every sample so far, the oldest first, 50 a second."""
    adaptive: Array = field(default_factory=lambda: np.zeros((0, 2, 3)))
    """[n, 2, 3], nu_ad at the samples."""
    sent: int = 0
    """Versions sent so far."""
    refused: dict[int, str] = field(default_factory=dict)
    """Reason for each version that onboard has refused."""
    flying: int = 0
    """Version in use."""

    def is_accepted(self, name: ChannelName, channel: ChannelFeatures) -> bool:
        """Whether onboard's test of a version accepts this one now, as far as a learner can know."""
        test, theta = self.tests[name == "attitude"], channel.last_layer
        recent, nu = self.signals[-RECENT:].T, self.adaptive[-RECENT:, int(name == "attitude")]
        return not test.refusal(NetworkFeatures(channel), theta, recent[:, -1], recent, nu)


RECENT: Final = 50
"""Samples of the last second."""
Channels = tuple[ChannelFeatures | None, ChannelFeatures | None]
Case = Callable[[View], Channels | None]
"""Called in every tick with samples; returns the channels of a new version, or None."""


def _tests(config: FlightConfig) -> tuple[VersionTest, VersionTest]:
    settings = fill(CascadeSettings, {**config.onboard.controller.settings, "features": config.features}, "attack")
    gains = settings.position.gains, settings.attitude.gains

    def test(index: int, channel: ChannelName) -> VersionTest:
        shares = getattr(settings, channel).augmentation.slope_shares
        return VersionTest(settings.guard.test, index, SlopeLimits.of(channel, *gains, shares))

    return test(0, "position"), test(1, "attitude")


class BadLearner:
    """Stands in for offboard.core.OffboardCore in a lockstep flight."""

    def __init__(self, config: FlightConfig, session: int, case: Case) -> None:
        key = load_key(config.network.key_file)
        layout = feature_digest(config.features)
        self._endpoint = Endpoint("offboard", session, key, config.offboard.vehicle_id, layout)
        self._relay = PoseRelay(config.offboard.pose_relay)
        self._sender = FeatureSender(TRANSFER)
        self._case = case
        settings = config.onboard.controller.settings
        limits = tuple(
            float(settings[channel]["augmentation"]["law"]["weight_norm_max"]) for channel in ("position", "attitude")
        )
        rng = np.random.default_rng([config.seed, 666])
        self.view = View(config.features.trained, (limits[0], limits[1]), _tests(config), rng)
        self._first_ns: int | None = None
        self._batches: list[SampleBatch] = []
        self._poses: list[Pose] = []
        self._replies: list[tuple[int, int]] = []

    def receive_onboard(self, datagram: bytes, now_ns: int) -> None:
        """Samples and status for the case; a time sync request is answered."""
        message = self._endpoint.decode(datagram, now_ns)
        if isinstance(message, TimeSyncRequest):
            self._replies.append((message.origin_ns, now_ns))
        elif isinstance(message, SampleBatch):
            self._batches.append(message)
            self._first_ns = now_ns if self._first_ns is None else self._first_ns
        elif isinstance(message, Status):
            self._sender.receive_status(message, now_ns)
            self.view.flying = message.feature_version
            if message.refused_version:
                self.view.refused[message.refused_version] = REFUSALS[message.refusal]

    def receive_motion_capture(self, datagram: bytes, now_ns: int) -> None:
        """Relay a pose."""
        pose = self._relay.receive(datagram, now_ns)
        self._poses += [] if pose is None else [pose]

    def receive_training(self, result: TrainingResult, now_ns: int) -> None:
        """Never called: a bad learner does not train."""

    def step(self, now_ns: int) -> OffboardOutput:
        """Send the poses, the answers, and what the case makes."""
        self._attack(now_ns)
        replies = [TimeSyncReply(origin_ns, receive_ns, now_ns) for origin_ns, receive_ns in self._replies]
        messages: list[Message] = [*self._poses, *replies, *self._sender.poll(now_ns)]
        self._poses, self._replies = [], []
        return OffboardOutput(to_onboard=[self._endpoint.encode(message, now_ns) for message in messages])

    def _attack(self, now_ns: int) -> None:
        view = self.view
        if self._first_ns is None:
            return
        view.time_s = (now_ns - self._first_ns) * 1e-9
        if self._batches:
            fresh, self._batches = self._batches, []
            signals, adaptive = (np.concatenate([getattr(b, name) for b in fresh]) for name in ("signals", "adaptive"))
            old = view.signals if view.signals.size else view.signals.reshape(0, signals.shape[1])
            view.signals = np.vstack([old, signals.astype(np.float64)])
            view.adaptive = np.concatenate([view.adaptive, adaptive.astype(np.float64)])
        channels = self._case(view)
        if channels is None:
            return
        position, attitude = channels
        version = max(self._sender.next_version, view.sent + 1)
        self._sender.offer(FeatureSet(version, 0, len(view.signals), position, attitude), now_ns)
        view.sent = version

    def status(self, now_ns: int) -> dict[str, int | float | None]:
        """Nothing to report."""
        return {}

    def summary(self) -> dict[str, object]:
        """Versions sent, and why any were refused."""
        return {"sent": self.view.sent, "refused": dict(self.view.refused)}
