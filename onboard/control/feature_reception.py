"""From chunks to features in use: gather, then swap one tick later, or refuse and say why.

Gathering (digest, decoding) and swapping (a k x k solve) are spread over two ticks, so that neither makes one late.
"""

from onboard.control.interface import Controller, LearningController
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS, FeatureChunk
from protocol.transfer import FeatureReceiver


class FeatureReception:
    """The feature-version state of the vehicle."""

    def __init__(self, controller: Controller) -> None:
        self._learner = controller if isinstance(controller, LearningController) else None
        self._receiver = FeatureReceiver()
        self._pending: FeatureSet | None = None
        self._refused: tuple[int, int] = (0, 0)
        self.version = 0
        """In use; 0 for the start features."""
        self.swapped_ns: int | None = None
        self.swaps = 0
        self.refusals = 0

    def receive(self, chunk: FeatureChunk) -> None:
        """Takes in one chunk; a whole and valid set waits for `step`."""
        whole = self._receiver.receive(chunk)
        if whole is not None:
            self._pending = whole

    def peer_restarted(self) -> None:
        """A new session of the peer: its versions may begin anew, and what was half gathered is void."""
        self._receiver.reset()
        self._pending = None
        self._refused = (0, 0)

    def step(self, now_ns: int, ready: bool) -> str:
        """Swaps to what waits, if the vehicle is `ready`; returns what happened as an event, or ""."""
        features = self._pending
        if features is None or not ready:
            return ""
        self._pending = None
        reason = self._learner.offer_features(features) if self._learner is not None else "not_accepting"
        if reason:
            self.refusals += 1
            self._refused = (features.version, REFUSALS.index(reason))
            return f"features {features.version} refused: {reason}"
        self.version, self.swapped_ns = features.version, now_ns
        self.swaps += 1
        return f"features {features.version} in use, parent {features.parent}, {features.samples} samples"

    def age_s(self, now_ns: int) -> float:
        """Time since the features in use were swapped in; -1 for the start features."""
        return -1.0 if self.swapped_ns is None else (now_ns - self.swapped_ns) * 1e-9

    @property
    def transfer_version(self) -> int:
        """For Status."""
        return self._receiver.transfer_version

    @property
    def received_chunks(self) -> bytes:
        """For Status."""
        return self._receiver.received_chunks

    @property
    def refused(self) -> tuple[int, int]:
        """Newest refused version and its reason's index: by content on arrival, or by the swap."""
        return max(self._refused, self._receiver.refused)
