"""From chunks to a complete feature version, and what became of it: in use, or refused and why.

The core decodes a version and swaps it in the same tick, the one in which its last chunk arrives.
"""

from collections import deque
from typing import Final, NamedTuple

from onboard.control.guard import Fall
from onboard.control.interface import Controller, GuardedController, LearningController
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS, FeatureChunk
from protocol.transfer import FeatureReceiver

Event = tuple[int, str]
"""Time, ns, and text."""
REFUSALS_KEPT: Final = 8
"""Refusals that wait to be reported; of more the oldest are dropped."""
REPORTS: Final = 3
"""Statuses that name a refusal before they name the next one: a status may be lost."""


class ReceptionStatus(NamedTuple):
    """The reception as the status message reports it (protocol.messages.Status)."""

    version: int
    transfer_version: int
    received_chunks: bytes
    refused_version: int
    refusal: int


class FeatureReception:
    """The feature versions that arrive, and the one in use."""

    def __init__(self) -> None:
        self._receiver = FeatureReceiver()
        self._complete: FeatureSet | None = None
        self._refused: deque[tuple[int, int]] = deque(maxlen=REFUSALS_KEPT)
        """Versions refused and the reasons, indices into REFUSALS. The first is being reported; the last one stays."""
        self._reports = 0
        """Statuses that have named the first one."""
        self.version = 0
        """In use; 0 for the start features."""
        self.swapped_ns: int | None = None
        self.swaps = 0
        self.refusals = 0
        self.taken_back = 0
        """Versions that flew and were taken back."""

    def receive(self, chunk: FeatureChunk) -> None:
        """Add one chunk. A version that is complete and valid waits for `take_complete`."""
        refused_before = self._receiver.refused
        complete = self._receiver.receive(chunk)
        if complete is not None:
            self._complete = complete
        if self._receiver.refused != refused_before:
            self._refuse(*self._receiver.refused)

    def restart(self) -> None:
        """Start over for a new session of the peer: its versions may count from 1 again."""
        self._receiver.reset()
        self._complete = None
        self._refused.clear()
        self._reports = 0

    def swap(self, controller: Controller, now_ns: int) -> tuple[list[Event], list[Event]]:
        """Offer the complete version that waits, if any, and take note of what the guard did.

        Returns events, and those of them that the pilot should see.
        """
        events: list[Event] = []
        features, self._complete = self._complete, None
        if features is not None:
            learner = controller if isinstance(controller, LearningController) else None
            refusal = "not_accepting" if learner is None else learner.offer_features(features)
            events.append((now_ns, self.conclude(features, refusal, now_ns)))
        falls = controller.take_falls() if isinstance(controller, GuardedController) else []
        return events, [(now_ns, self._fall_back(fall, now_ns)) for fall in falls]

    def _fall_back(self, fall: Fall, now_ns: int) -> str:
        """The guard has taken a version back, or lets one fly again."""
        if fall.refused:
            self.taken_back += 1
            self._refuse(fall.refused, REFUSALS.index("probation"))
        if fall.flying != self.version:
            self.version, self.swapped_ns = fall.flying, now_ns if fall.flying else None
        return fall.text

    def conclude(self, features: FeatureSet, refusal: str, now_ns: int) -> str:
        """Note what the controller answered; returns the event.

        refusal: why the controller refused the version, of protocol.messages.REFUSALS; "" if it is in use.
        """
        if refusal:
            self.refusals += 1
            self._refuse(features.version, REFUSALS.index(refusal))
            return f"features {features.version} refused: {refusal}"
        self.version, self.swapped_ns = features.version, now_ns
        self.swaps += 1
        return f"features {features.version} in use, parent {features.parent}, {features.samples} samples"

    def age_s(self, now_ns: int) -> float:
        """Time since the features in use were swapped in; -1 for the start features."""
        return -1.0 if self.swapped_ns is None else (now_ns - self.swapped_ns) * 1e-9

    def _refuse(self, version: int, reason: int) -> None:
        """Note a refusal for the status; it is named after those that wait."""
        self._refused.append((version, reason))
        self._name_next()

    def _name_next(self) -> None:
        if self._reports >= REPORTS and len(self._refused) > 1:
            self._refused.popleft()
            self._reports = 0

    @property
    def status(self) -> ReceptionStatus:
        """What the status message says."""
        refused = self._refused[0] if self._refused else (0, 0)
        return ReceptionStatus(self.version, self._receiver.transfer_version, self._receiver.received_chunks, *refused)

    def note_status(self) -> None:
        """A status was sent: after REPORTS of them the next refusal is named, so that the trainer learns of each."""
        self._reports += bool(self._refused)
        self._name_next()
