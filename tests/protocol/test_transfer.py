"""Transfers of feature sets in virtual time. The link is a list; a loss is an index."""

from collections.abc import Callable
from dataclasses import replace

import msgpack
import numpy as np
import pytest

from protocol.config import TransferConfig
from protocol.feature_codec import decode_feature_set, encode_feature_set, encode_for_wire
from protocol.feature_set import FeatureSet
from protocol.messages import CHUNK_COUNT_MAX, REFUSALS, FeatureChunk, Status
from protocol.transfer import FeatureReceiver, FeatureSender, split

Make = Callable[..., FeatureSet]
MS = 1_000_000
S = 1_000_000_000
STEP = 5 * MS


def status_of(receiver: FeatureReceiver, flying: int = 0) -> Status:
    refused_version, refusal = receiver.refused
    return Status(
        0, flying, receiver.transfer_version, receiver.received_chunks, refused_version, refusal, 0, 0, -1, 0, 0, 0
    )


class Wire:
    """A sender and a receiver, stepped together; `down` and `up` return whether datagram i arrives."""

    def __init__(self, config: TransferConfig | None = None, status_period_ns: int = 100 * MS) -> None:
        self.sender = FeatureSender(config or TransferConfig())
        self.receiver = FeatureReceiver()
        self.now_ns = 0
        self.status_period_ns = status_period_ns
        self.down: Callable[[int], bool] = lambda _: True
        self.up: Callable[[int], bool] = lambda _: True
        self.chunks: list[tuple[int, FeatureChunk]] = []
        self.statuses = 0
        self.got: list[tuple[int, FeatureSet]] = []

    def step(self) -> None:
        for chunk in self.sender.poll(self.now_ns):
            self.chunks.append((self.now_ns, chunk))
            if self.down(len(self.chunks) - 1):
                features = self.receiver.receive(chunk)
                if features is not None:
                    self.got.append((self.now_ns, features))
        if self.now_ns % self.status_period_ns == 0:
            self.statuses += 1
            if self.up(self.statuses - 1):
                self.sender.receive_status(status_of(self.receiver), self.now_ns)
        self.now_ns += STEP

    def run(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * S)
        while self.now_ns < end:
            self.step()


def test_without_loss_each_chunk_is_sent_once(make_features: Make) -> None:
    wire = Wire(TransferConfig(resend_after_s=0.2))
    wire.sender.offer(make_features(), 0)
    assert wire.sender.outstanding_version == 1
    wire.run(1.0)
    assert [chunk.index for _, chunk in wire.chunks] == list(range(8))
    assert wire.sender.outstanding_version == 0
    assert wire.sender.delivery_ns is not None
    [(_, features)] = wire.got
    assert encode_feature_set(features, "float16") == encode_feature_set(make_features(), "float16")


def test_only_a_lost_chunk_is_sent_again(make_features: Make) -> None:
    wire = Wire(TransferConfig(resend_after_s=0.2))
    wire.down = lambda index: index != 3
    wire.sender.offer(make_features(), 0)
    wire.run(2.0)
    assert [chunk.index for _, chunk in wire.chunks] == [*range(8), 3]
    assert wire.sender.outstanding_version == 0
    assert len(wire.got) == 1


def test_lost_acknowledgements_cost_repeats_but_no_second_delivery(make_features: Make) -> None:
    wire = Wire()
    wire.up = lambda index: index >= 8
    wire.sender.offer(make_features(), 0)
    wire.run(2.0)
    assert len(wire.got) == 1
    assert wire.receiver.ignored == len(wire.chunks) - 8 > 0
    assert wire.sender.outstanding_version == 0


def test_a_newer_version_replaces_the_one_being_transferred(make_features: Make) -> None:
    wire = Wire()
    wire.sender.offer(make_features(1), 0)
    wire.run(0.06)
    assert wire.receiver.transfer_version == 1
    wire.sender.offer(make_features(2), wire.now_ns)
    wire.run(1.0)
    assert [features.version for _, features in wire.got] == [2]
    late = split(encode_feature_set(make_features(1), "float16"), 1, 1100)
    assert all(wire.receiver.receive(chunk) is None for chunk in late), "an older version is not resumed"
    assert wire.receiver.transfer_version == 2


def test_chunks_may_arrive_in_any_order_and_repeatedly(make_features: Make) -> None:
    chunks = split(encode_feature_set(make_features(), "float32"), 1, 1100)
    rng = np.random.default_rng(0)
    for _ in range(20):
        receiver = FeatureReceiver()
        order = [*rng.permutation(len(chunks)), *rng.permutation(len(chunks))]
        assert sum(receiver.receive(chunks[index]) is not None for index in order) == 1


def test_the_sender_backs_off_without_status(make_features: Make) -> None:
    wire = Wire()
    wire.down = wire.up = lambda _: False
    wire.sender.offer(make_features(), 0)
    wire.run(20.0)
    per_second = np.histogram([t / S for t, _ in wire.chunks], bins=20, range=(0, 20))[0]
    assert per_second[0] <= 40
    assert per_second[5:].max() <= 9, "one pass of eight in resend_max_s of 1 s"
    assert per_second[5:].min() >= 7, "but it never stops"
    wire.down = wire.up = lambda _: True
    wire.run(1.2)
    assert len(wire.got) == 1


def test_the_rate_limit_holds_at_any_polling_interval(make_features: Make) -> None:
    sender = FeatureSender(TransferConfig(dtype="float32", chunks_per_second=40.0, chunks_per_poll=4))
    sender.offer(make_features(), 0)
    assert len(sender.poll(0)) == 4
    assert len(sender.poll(MS)) == 0
    assert len(sender.poll(25 * MS)) == 1
    assert len(sender.poll(10 * S)) == 4
    fast = FeatureSender(TransferConfig(dtype="float32", chunks_per_second=40.0, chunks_per_poll=1))
    fast.offer(make_features(), 0)
    times = [t for t in range(0, S // 2, MS) for _ in fast.poll(t)]
    assert len(times) == 20
    assert np.diff(times).min() >= 24 * MS


def test_a_refusal_ends_the_transfer(make_features: Make) -> None:
    wire = Wire()
    wire.sender.offer(make_features(3), 0)
    wire.step()
    status = replace(status_of(wire.receiver), refused_version=3, refusal=REFUSALS.index("lipschitz"))
    wire.sender.receive_status(status, wire.now_ns)
    assert wire.sender.outstanding_version == 0
    assert wire.sender.next_version == 4


def test_a_restarted_sender_continues_the_version_numbers(make_features: Make) -> None:
    wire = Wire()
    wire.sender.offer(make_features(7), 0)
    wire.run(1.0)
    wire.sender = FeatureSender(TransferConfig())
    assert wire.sender.next_version == 1
    wire.run(0.2)
    assert wire.sender.next_version == 8
    with pytest.raises(ValueError, match="next one is 8"):
        wire.sender.offer(make_features(7), wire.now_ns)
    wire.sender.offer(make_features(8), wire.now_ns)
    wire.run(1.0)
    assert [features.version for _, features in wire.got] == [7, 8]


def test_a_receiver_that_restarts_during_a_transfer_receives_everything_again(make_features: Make) -> None:
    wire = Wire()
    wire.sender.offer(make_features(), 0)
    wire.down = lambda index: index != 2
    wire.run(0.1)
    assert wire.receiver.transfer_version == 1
    assert not wire.got
    wire.receiver = FeatureReceiver()
    wire.run(1.5)
    assert len(wire.got) == 1
    assert wire.sender.outstanding_version == 0


def test_reset_discards_the_versions(make_features: Make) -> None:
    wire = Wire()
    wire.sender.offer(make_features(7), 0)
    wire.run(1.0)
    wire.receiver.reset()
    wire.sender = FeatureSender(TransferConfig())
    wire.sender.offer(make_features(1), wire.now_ns)
    wire.run(1.0)
    assert [features.version for _, features in wire.got] == [7, 1]


def refusal_of(chunks: tuple[FeatureChunk, ...]) -> str:
    receiver = FeatureReceiver()
    assert all(receiver.receive(chunk) is None for chunk in chunks)
    version, reason = receiver.refused
    assert version == chunks[0].version
    return REFUSALS[reason]


def test_a_complete_but_invalid_set_is_refused_with_its_reason(make_features: Make) -> None:
    data = encode_feature_set(make_features(), "float16")
    chunks = split(data, 1, 1100)
    corrupted = replace(chunks[2], data=b"\x00" + chunks[2].data[1:])
    assert refusal_of((*chunks[:2], corrupted, *chunks[3:])) == "digest"
    assert refusal_of(split(data[:-1], 1, 1100)) == "undecodable"
    assert refusal_of(split(data, 2, 1100)) == "undecodable"
    assert refusal_of(split(data.replace(b"pitch", b"bitch"), 1, 1100)) == "inputs"
    nan = np.float16(np.nan).tobytes()
    assert refusal_of(split(data[: -len(nan)] + nan, 1, 1100)) == "not_finite"
    signalling, wide = b"\x00\x00\xa0\x7f", encode_feature_set(make_features(), "float32")
    assert refusal_of(split(wide[:-4] + signalling, 1, 1100)) == "not_finite"


@pytest.mark.parametrize("place", [0, 3])
@pytest.mark.parametrize("depth", [1, 400, 1000, 60_000])
def test_lists_within_lists_are_refused_however_deep(place: int, depth: int) -> None:
    """As inputs or as widths. Their repr alone would exceed the interpreter's depth."""
    vector = msgpack.packb(bytes(8))
    channel = [msgpack.packb(["yaw", "roll"]), vector, vector, msgpack.packb([1]), msgpack.packb(bytes(18))]
    channel[place] = b"\x91" * depth + b"\xc0"
    data = b"\x97" + b"".join(map(msgpack.packb, (1, 2, 1, 0, 5))) + b"\x95" + b"".join(channel) + b"\xc0"
    assert refusal_of(split(data, 1, 1100)) in ("inputs", "undecodable")


def test_chunks_that_disagree_with_their_version_are_ignored(make_features: Make) -> None:
    chunks = split(encode_feature_set(make_features(), "float16"), 1, 1100)
    receiver = FeatureReceiver()
    receiver.receive(chunks[0])
    receiver.receive(replace(chunks[1], digest=bytes(16)))
    receiver.receive(replace(chunks[1], count=9))
    assert receiver.ignored == 2
    assert [receiver.receive(chunk) is not None for chunk in chunks[1:]] == [False] * 6 + [True]


def test_memory_is_bounded() -> None:
    receiver = FeatureReceiver()
    for version in range(1, 200):
        for index in range(CHUNK_COUNT_MAX - 1):
            receiver.receive(FeatureChunk(version, index, CHUNK_COUNT_MAX, bytes(16), b"x"))
        assert len(receiver.received_chunks) == 8
    assert len(receiver._pieces) == CHUNK_COUNT_MAX - 1


def test_a_set_with_too_many_chunks_raises() -> None:
    with pytest.raises(ValueError, match="allowed are 64"):
        split(bytes(64 * 1100 + 1), 1, 1100)


def chance(rng: np.random.Generator, loss: float) -> Callable[[int], bool]:
    return lambda _: bool(rng.random() >= loss)


@pytest.mark.parametrize("dtype", ["float16", "float32"])
@pytest.mark.parametrize("loss", [0.0, 0.3, 0.5])
def test_delivery_in_time(make_features: Make, dtype: str, loss: float) -> None:
    """At 50 % loss each way, a pair of 6-32-32-20 networks arrives within 2 s at the default rate."""
    times = []
    for seed in range(30):
        rng = np.random.default_rng([5, seed])
        wire = Wire(TransferConfig.model_validate({"dtype": dtype}))
        wire.down = wire.up = chance(rng, loss)
        wire.sender.offer(make_features(), 0)
        while not wire.got:
            wire.step()
        times.append(wire.got[0][0] / S)
    assert max(times) <= (2.0 if loss else 0.4)


@pytest.mark.parametrize("loss", [0.9, 0.97])
def test_a_very_lossy_link_delivers_eventually(make_features: Make, loss: float) -> None:
    rng = np.random.default_rng(3)
    wire = Wire()
    wire.down = wire.up = chance(rng, loss)
    wire.sender.offer(make_features(), 0)
    wire.run(120.0)
    assert wire.got


def test_a_parameter_too_large_for_float16_is_sent_in_float32(make_features: Make) -> None:
    features = make_features()
    channel = features.position or features.attitude
    assert channel is not None
    last_layer = channel.last_layer.copy()
    last_layer[0, 0] = 70_000.0
    large = replace(features, position=replace(channel, last_layer=last_layer))
    arrived = decode_feature_set(encode_for_wire(large, "float16"))
    assert arrived.position is not None
    assert arrived.position.last_layer[0, 0] == 70_000.0
    assert encode_for_wire(features, "float16") == encode_feature_set(features, "float16")
    sender = FeatureSender(TransferConfig(dtype="float16"))
    sender.offer(large, 0)
    assert sender.outstanding_version == large.version
    last_layer[0, 0] = 2e6
    with pytest.raises(ValueError, match="too large to send"):
        sender.offer(replace(large, version=large.version + 1, position=replace(channel, last_layer=last_layer)), 0)
