"""Sends feature versions to onboard, and the latest one again when onboard does not know it."""

from typing import Final

from protocol.config import TransferConfig
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS, FeatureChunk, Status
from protocol.transfer import FeatureSender

RESEND_AFTER_NS: Final = 300_000_000
"""Time for which onboard's status must lack the latest version before it is sent again."""


class VersionSender:
    """One transfer at a time, and the check that onboard knows the latest version."""

    def __init__(self, config: TransferConfig) -> None:
        self._sender = FeatureSender(config)
        self._status: Status | None = None
        self._refused_version = 0
        self._unsendable_version = 0
        self._unknown_since_ns: int | None = None
        self._must_send = False

    @property
    def flying_version(self) -> int:
        """The version that onboard reported last; 0 for the random start features."""
        return 0 if self._status is None else self._status.feature_version

    def require_sending(self) -> None:
        """Send the latest version even if onboard reports a version with this number: after a warm start."""
        self._must_send = True

    def restart(self) -> None:
        """Discard the status of an onboard process that has been replaced by another one."""
        self._status = None
        self._unknown_since_ns = None

    def receive(self, status: Status, now_ns: int) -> str:
        """Receive onboard's status; returns an event to log, "" for none."""
        self._status = status
        self._sender.receive_status(status, now_ns)
        if status.refused_version == self._refused_version:
            return ""
        self._refused_version = status.refused_version
        return f"version {status.refused_version} refused: {REFUSALS[status.refusal]}"

    def must_resend(self, latest: FeatureSet, now_ns: int) -> bool:
        """Whether onboard does not know `latest`: either side restarted, or this side started from a version file."""
        status, unsendable = self._status, latest.version == self._unsendable_version
        if unsendable or status is None or self._sender.outstanding_version:
            self._unknown_since_ns = None
            return False
        known_version = max(status.feature_version, status.transfer_version, status.refused_version)
        if known_version >= latest.version and not self._must_send:
            self._unknown_since_ns = None
        elif self._unknown_since_ns is None:
            self._unknown_since_ns = now_ns
        return self._unknown_since_ns is not None and now_ns - self._unknown_since_ns >= RESEND_AFTER_NS

    def send(self, features: FeatureSet, now_ns: int) -> None:
        """Start to send a version, in place of the one on its way.

        Raises
        ------
        ValueError
            If the version cannot be sent: too many bytes, or a number too large. The one on its way goes on.
        """
        self._must_send = False
        try:
            self._sender.offer(features, now_ns)
        except ValueError:
            self._unsendable_version = features.version
            raise
        self._unknown_since_ns = None

    def chunks(self, now_ns: int) -> list[FeatureChunk]:
        """The chunks to send now."""
        return self._sender.poll(now_ns)
