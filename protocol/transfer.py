"""Transfer of feature sets over a lossy link: chunks down, a bitmap of the received chunks up, selective repeat.

The sender sends each chunk once, at a limited rate. Then it sends only the chunks that the newest status shows as
missing, each at the earliest `resend_after_s` after it was last sent. When no status arrives, this interval doubles
from pass to pass, up to `resend_max_s`; any status resets it. On both sides a newer version replaces the one being
transferred, and an older one is ignored. The receiver stores one transfer of at most CHUNK_COUNT_MAX chunks. It
returns a feature set only when all chunks have arrived, the digest is right and the bytes decode.

Version numbers continue when the sender restarts: it numbers its feature sets from `next_version`, above all numbers
in the status of the peer, which would otherwise ignore them as old.
"""

import hashlib

from protocol.config import TransferConfig
from protocol.conventions import NEVER_NS
from protocol.errors import ProtocolError
from protocol.feature_codec import decode_feature_set, encode_for_wire
from protocol.feature_set import FeatureSet
from protocol.messages import CHUNK_COUNT_MAX, DIGEST_BYTES, REFUSALS, FeatureChunk, Status


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
    """BLAKE2b of 16 bytes, without key: the digest in each chunk."""
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()


class FeatureSender:
    """Sends the newest feature set until the peer has received or refused it."""

    def __init__(self, config: TransferConfig) -> None:
        self._config = config
        self._period_ns = round(1e9 / config.chunks_per_second)
        self._chunks: tuple[FeatureChunk, ...] = ()
        self._missing: list[int] = []
        self._last_sent_ns: list[int] = []
        self._next_ns = NEVER_NS
        self._status_ns = NEVER_NS
        self._interval_ns = 0
        self._started_ns = 0
        self._newest_version = 0
        self.chunks_sent = 0
        """Chunks sent since start, repeats included."""
        self.delivery_ns: int | None = None
        """Time from the offer of the last delivered version to the first status that reports it as complete."""

    @property
    def next_version(self) -> int:
        """The number for the next feature set: above all offered here or named in a status."""
        return self._newest_version + 1

    @property
    def outstanding_version(self) -> int:
        """The version being transferred; 0 once the peer reports that it has received or refused the newest one."""
        return self._chunks[0].version if self._chunks else 0

    def offer(self, features: FeatureSet, now_ns: int) -> None:
        """Start to send a feature set, in place of the one being transferred.

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
        self._last_sent_ns = [NEVER_NS] * len(self._chunks)
        self._interval_ns = round(self._config.resend_after_s * 1e9)
        self._started_ns = now_ns

    def receive_status(self, status: Status, now_ns: int) -> None:
        """Receive a status of the peer."""
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
        """The chunks to send now, at most `chunks_per_poll`; mostly none."""
        out: list[FeatureChunk] = []
        if not self._chunks:
            return out
        burst_ns = (self._config.chunks_per_poll - 1) * self._period_ns
        self._next_ns = max(self._next_ns, now_ns - burst_ns)  # at most one full poll is made up for
        while self._next_ns <= now_ns and (index := self._due(now_ns)) is not None:
            self._last_sent_ns[index] = now_ns
            self._next_ns += self._period_ns
            self.chunks_sent += 1
            out.append(self._chunks[index])
        return out

    def _due(self, now_ns: int) -> int | None:
        """The missing chunk sent longest ago, if it may be sent again; a pass without a status doubles the interval."""
        if not self._missing:
            return None
        index = min(self._missing, key=self._last_sent_ns.__getitem__)
        last_ns = self._last_sent_ns[index]
        if last_ns != NEVER_NS and now_ns - last_ns < self._interval_ns:
            return None
        pass_without_status = last_ns != NEVER_NS and index == self._missing[0] and self._status_ns < last_ns
        if pass_without_status:
            self._interval_ns = min(2 * self._interval_ns, round(self._config.resend_max_s * 1e9))
        return index


class FeatureReceiver:
    """Collects the chunks of the newest version."""

    def __init__(self) -> None:
        self.transfer_version = 0
        """Version being received, or the last complete one; 0 for none."""
        self.refused: tuple[int, int] = (0, 0)
        """Newest version refused here and its index in REFUSALS; (0, 0) for none."""
        self._digest = b""
        self._count = 0
        self._pieces: dict[int, bytes] = {}
        self._bits = 0
        self.ignored = 0
        """Unused chunks: duplicates, old versions, or at odds with the first chunk of their version."""

    @property
    def received_chunks(self) -> bytes:
        """Bitmap for Status: chunk i of `transfer_version` is bit i % 8 of byte i // 8."""
        return self._bits.to_bytes(-(-self._count // 8), "little")

    def reset(self) -> None:
        """Discard everything, as after a restart of the peer, whose version numbers may start anew."""
        self.transfer_version, self._digest, self._count, self._bits = 0, b"", 0, 0
        self._pieces = {}
        self.refused = (0, 0)

    def receive(self, chunk: FeatureChunk) -> FeatureSet | None:
        """Receive a chunk; returns the feature set if it was the last missing chunk and the set is valid."""
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
        self._pieces = {}  # the bits are kept: status continues to report that all chunks arrived
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
            raise ProtocolError("undecodable", "the version differs from that of its chunks")
        return features
