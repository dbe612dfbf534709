"""From chunks to a complete feature version, and what became of it: in use, or refused and why.

The core decodes a version in the tick in which its last chunk arrives. From the next tick on a controller that can
prepares it, in parts (onboard.control.preparation), and swaps it in one tick; any other one swaps it at once. The
version that is being prepared is finished first. Of those that come meanwhile the newest waits: if the newest one went
first, versions at 40 Hz would keep any of them from ever flying.
"""

from collections import deque
from typing import Final, NamedTuple

from onboard.control.guard import Fall
from onboard.control.interface import Controller, GuardedController, LearningController, PreparingController
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
        self._preparing: FeatureSet | None = None
        self._void = False
        """Whether the version that is being prepared is one of a peer that has restarted."""
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
        self._complete, self._void = None, self._preparing is not None
        self._refused.clear()
        self._reports = 0

    def swap(self, controller: Controller, now_ns: int) -> tuple[list[Event], list[Event]]:
        """Offer the complete version that waits, or go on with the one before, and note what the guard did.

        Returns events, and those of them that the pilot should see.
        """
        events: list[Event] = []
        features = self._preparing or self._complete
        answer = None if features is None else self._answer(controller, features)
        if features is not None and answer is not None:
            events.append((now_ns, self.conclude(features, answer, now_ns)))
        falls = controller.take_falls() if isinstance(controller, GuardedController) else []
        return events, [(now_ns, self._fall_back(fall, now_ns)) for fall in falls]

    def _answer(self, controller: Controller, features: FeatureSet) -> str | None:
        """The controller's answer to a version; None while it prepares it."""
        if isinstance(controller, PreparingController):
            return self._prepared(controller)
        self._complete = None
        return controller.offer_features(features) if isinstance(controller, LearningController) else "not_accepting"

    def _prepared(self, controller: PreparingController) -> str | None:
        """One part of the version that is being prepared, and its answer; the next one begins when it is over."""
        if self._void:
            controller.cancel_features()
            self._preparing, self._void = None, False
        answer = None if self._preparing is None else controller.advance_features()
        if answer is not None:
            self._preparing = None
        elif self._preparing is None and self._complete is not None:
            self._preparing, self._complete = self._complete, None
            controller.begin_features(self._preparing)
        return answer

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
