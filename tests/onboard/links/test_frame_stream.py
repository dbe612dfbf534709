"""Frame stream: with any cuts and any noise, each good frame is returned once and whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from onboard.links.frame_stream import FrameStream
from protocol.mavlink.frames import FrameWriter
from protocol.mavlink.vehicle import encode_motors


def frames(count, key=None):
    writer = FrameWriter(1, 1, key)
    values = np.random.default_rng(3).random((count, 4))
    return [writer.write(encode_motors(7, tuple(map(float, row)), True), 7000) for row in values]


@pytest.mark.parametrize("key", [None, b"k" * 32])
@pytest.mark.parametrize("size", [1, 7, 64, 1000])
def test_any_cut_of_the_stream_gives_the_frames(size, key):
    sent, stream = frames(20, key), FrameStream()
    data = b"".join(sent)
    got = [frame for start in range(0, len(data), size) for frame in stream.feed(data[start : start + size])]
    assert got == sent
    assert not stream.skipped


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(st.lists(st.one_of(st.binary(max_size=40), st.just(b"\xfd"), st.just(b"\xfd\xff\x00")), min_size=3, max_size=3))
def test_noise_between_frames_loses_no_frame(noise):
    sent, stream = frames(12), FrameStream()
    data = b"".join(sent[:4]) + noise[0] + b"".join(sent[4:8]) + noise[1] + b"".join(sent[8:]) + noise[2] + bytes(300)
    got = [frame for start in range(0, len(data), 33) for frame in stream.feed(data[start : start + 33])]
    assert got == sent


def test_a_truncated_frame_loses_only_itself():
    sent, stream = frames(3), FrameStream()
    got = stream.feed(sent[0] + sent[1][:30] + sent[2] + bytes(300))
    assert got == [sent[0], sent[2]]
    assert stream.skipped["checksum"] == 1


def test_the_waiting_bytes_are_bounded():
    stream = FrameStream()
    rng = np.random.default_rng(1)
    for _ in range(200):
        stream.feed(rng.bytes(500))
        assert len(stream._waiting) <= 280
    assert stream.feed(b"\xfd\x05\x00" + bytes(4) + b"\xff\xff\x7f") == []
    assert stream.skipped["unknown_frame"] > 0
