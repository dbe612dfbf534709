"""Feature sets across a lossy link: chunks down, a bitmap of what arrived up, selective repair, newest wins.

The sender gives out each chunk once, at a pace, and then only those that the newest status shows missing, each not
sooner than `resend_after_s` after it last left. When status falls silent the interval doubles from pass to pass up
to `resend_max_s`; any status resets it. A newer version replaces the one on its way on both sides, an older one is
ignored. The receiver holds one transfer, at most CHUNK_COUNT_MAX chunks, and gives out a feature set only when it
is whole, its digest right and its decoding valid.

Version numbers outlive a sender: one that starts anew numbers its feature sets from `next_version`, above all that
the peer's status names, or the peer would take them for old ones.
"""

import hashlib
from typing import Final

from protocol.codec import decode_feature_set, encode_for_wire
from protocol.config import TransferConfig
from protocol.errors import ProtocolError
from protocol.feature_set import FeatureSet
from protocol.messages import CHUNK_COUNT_MAX, DIGEST_BYTES, REFUSALS, FeatureChunk, Status

_NEVER: Final = -(10**18)


def split(data: bytes, version: int, chunk_bytes: int) -> tuple[FeatureChunk, ...]:
    """The chunks of an encoded feature set.

    Raises
    ------
    ValueError
        If it takes more than CHUNK_COUNT_MAX chunks.
    """
    count = -(-len(data) // chunk_bytes)
    if count > CHUNK_COUNT_MAX:
        raise ValueError(f"{len(data)} bytes need {count} chunks of {chunk_bytes}, allowed are {CHUNK_COUNT_MAX}")
    digest = digest_of(data)
    pieces = (data[start : start + chunk_bytes] for start in range(0, len(data), chunk_bytes))
    return tuple(FeatureChunk(version, index, count, digest, piece) for index, piece in enumerate(pieces))


def digest_of(data: bytes) -> bytes:
    """BLAKE2b, 16 bytes, unkeyed: the digest that travels in each chunk."""
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()


class FeatureSender:
    """Sends the newest feature set until the peer has it, or has refused it."""

    def __init__(self, config: TransferConfig) -> None:
        self._config = config
        self._period_ns = round(1e9 / config.chunks_per_second)
        self._chunks: tuple[FeatureChunk, ...] = ()
        self._missing: list[int] = []
        self._last_sent_ns: list[int] = []
        self._next_ns = _NEVER
        self._status_ns = _NEVER
        self._interval_ns = 0
        self._started_ns = 0
        self._newest_version = 0
        self.chunks_sent = 0
        """Chunks given out since start, repairs included."""
        self.delivery_ns: int | None = None
        """Time from offer to the first status that says whole, of the last version that arrived."""

    @property
    def next_version(self) -> int:
        """The number to give the next feature set: above every one offered here or named in a status."""
        return self._newest_version + 1

    @property
    def outstanding_version(self) -> int:
        """The version on its way; 0 when the peer is known to have, or to have refused, the newest."""
        return self._chunks[0].version if self._chunks else 0

    def offer(self, features: FeatureSet, now_ns: int) -> None:
        """Begins to send a feature set in place of the one on its way.

        Raises
        ------
        ValueError
            If its version is below `next_version`, or it is too large to send.
        """
        if features.version < self.next_version:
            raise ValueError(f"version {features.version} offered, the next one is {self.next_version}")
        data = encode_for_wire(features, self._config.dtype)
        self._chunks = split(data, features.version, self._config.chunk_bytes)
        self._newest_version = features.version
        self._missing = list(range(len(self._chunks)))
        self._last_sent_ns = [_NEVER] * len(self._chunks)
        self._interval_ns = round(self._config.resend_after_s * 1e9)
        self._started_ns = now_ns

    def receive_status(self, status: Status, now_ns: int) -> None:
        """Takes in what the peer has."""
        self._status_ns = now_ns
        named = max(status.feature_version, status.transfer_version, status.refused_version)
        self._newest_version = max(self._newest_version, named)
        self._interval_ns = round(self._config.resend_after_s * 1e9)
        version = self.outstanding_version
        if not version:
            return
        if status.transfer_version == version:
            bits = int.from_bytes(status.received_chunks, "little")
            self._missing = [index for index in range(len(self._chunks)) if not bits >> index & 1]
        has_it = status.feature_version == version or (status.transfer_version == version and not self._missing)
        if has_it:
            self.delivery_ns = now_ns - self._started_ns
        if has_it or status.refused_version == version or status.transfer_version > version:
            self._chunks = ()

    def poll(self, now_ns: int) -> list[FeatureChunk]:
        """The chunks to send now: paced, at most `chunks_per_poll`, empty most of the time."""
        out: list[FeatureChunk] = []
        if not self._chunks:
            return out
        burst_ns = (self._config.chunks_per_poll - 1) * self._period_ns
        self._next_ns = max(self._next_ns, now_ns - burst_ns)  # no credit for more than one full poll
        while self._next_ns <= now_ns and (index := self._due(now_ns)) is not None:
            self._last_sent_ns[index] = now_ns
            self._next_ns += self._period_ns
            self.chunks_sent += 1
            out.append(self._chunks[index])
        return out

    def _due(self, now_ns: int) -> int | None:
        """The missing chunk that has waited longest, if it may leave; a pass in silence doubles the interval."""
        if not self._missing:
            return None
        index = min(self._missing, key=self._last_sent_ns.__getitem__)
        last_ns = self._last_sent_ns[index]
        if last_ns != _NEVER and now_ns - last_ns < self._interval_ns:
            return None
        starts_pass_in_silence = last_ns != _NEVER and index == self._missing[0] and self._status_ns < last_ns
        if starts_pass_in_silence:
            self._interval_ns = min(2 * self._interval_ns, round(self._config.resend_max_s * 1e9))
        return index


class FeatureReceiver:
    """Gathers the chunks of the newest version."""

    def __init__(self) -> None:
        self.transfer_version = 0
        """Version being received, or the last one that was whole; 0 for none."""
        self.refused: tuple[int, int] = (0, 0)
        """Newest version refused here and its index in REFUSALS; (0, 0) for none."""
        self._digest = b""
        self._count = 0
        self._pieces: dict[int, bytes] = {}
        self._bits = 0
        self.ignored = 0
        """Chunks that brought nothing: duplicates, older versions, or at odds with the others of their version."""

    @property
    def received_chunks(self) -> bytes:
        """Bitmap for Status: bit i of byte i // 8 stands for chunk i of `transfer_version`."""
        return self._bits.to_bytes(-(-self._count // 8), "little")

    def reset(self) -> None:
        """Forgets everything, as after a restart of the peer, whose versions may begin anew."""
        self.transfer_version, self._digest, self._count, self._bits = 0, b"", 0, 0
        self._pieces = {}
        self.refused = (0, 0)

    def receive(self, chunk: FeatureChunk) -> FeatureSet | None:
        """Takes in a chunk; the feature set when it is the last one missing and the whole is valid."""
        if chunk.version > self.transfer_version:
            self._begin(chunk)
        fits = chunk.version == self.transfer_version and chunk.digest == self._digest and chunk.count == self._count
        if not fits or self._bits >> chunk.index & 1:
            self.ignored += 1
            return None
        self._pieces[chunk.index] = chunk.data
        self._bits |= 1 << chunk.index
        if len(self._pieces) < self._count:
            return None
        return self._finish()

    def _begin(self, chunk: FeatureChunk) -> None:
        self.transfer_version, self._digest, self._count = chunk.version, chunk.digest, chunk.count
        self._pieces = {}
        self._bits = 0

    def _finish(self) -> FeatureSet | None:
        data = b"".join(self._pieces[index] for index in range(self._count))
        self._pieces = {}  # the bits stay: status goes on saying that all arrived
        try:
            return self._verified(data)
        except ProtocolError as error:
            self.refused = (self.transfer_version, REFUSALS.index(error.reason))
            return None

    def _verified(self, data: bytes) -> FeatureSet:
        if digest_of(data) != self._digest:
            raise ProtocolError("digest")
        features = decode_feature_set(data)
        if features.version != self.transfer_version:
            raise ProtocolError("undecodable", "the version inside is another than outside")
        return features
