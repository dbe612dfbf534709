"""Values of a peer with the right key that cannot be: refused before anything is learnt from them."""

from dataclasses import replace

import numpy as np
import pytest

from protocol.endpoint import AHEAD_MAX_NS, Endpoint
from protocol.messages import APART_MAX_NS, MODES, VERSION_MAX, FeatureChunk, Pose, SampleBatch, Status

KEY = bytes(range(32))
S = 10**9
YEAR_2500_NS = 530 * 31_556_952 * S
STATUS = Status(4, 3, 3, b"", 0, 0, 10, 0, 5, 10, 0, 0)
BATCH = SampleBatch(
    0, 5 * S, 20_000_000, 3, *(np.zeros(shape, np.float32) for shape in ((1, 21), (1, 2, 3), (1, 2, 3)))
)
POSE = Pose(5 * S, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))


@pytest.mark.parametrize("version", [VERSION_MAX + 1, 2**32 - 1])
@pytest.mark.parametrize("name", ["feature_version", "transfer_version", "refused_version"])
def test_no_message_names_a_version_that_no_trainer_reaches(name: str, version: int) -> None:
    with pytest.raises(ValueError, match="version"):
        replace(STATUS, **{name: version})
    with pytest.raises(ValueError, match="version"):
        replace(BATCH, feature_version=version)
    with pytest.raises(ValueError, match="version"):
        FeatureChunk(version, 0, 1, bytes(16), b"data")
    assert replace(STATUS, **{name: VERSION_MAX})


def test_a_mode_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match="number"):
        replace(STATUS, mode=MODES)


@pytest.mark.parametrize("apart_ns", [APART_MAX_NS + 1, -APART_MAX_NS - 1])
def test_samples_and_poses_are_of_the_time_at_which_they_are_sent(apart_ns: int) -> None:
    onboard, offboard = Endpoint("onboard", 1, KEY), Endpoint("offboard", 2, KEY)
    now_ns = 1000 * S
    for sender, receiver, message in ((onboard, offboard, BATCH), (offboard, onboard, POSE)):
        assert receiver.decode(sender.encode(replace(message, time_ns=now_ns + apart_ns), now_ns), now_ns) is None
        assert receiver.statistics.rejected == {"value": 1}
        assert receiver.decode(sender.encode(replace(message, time_ns=now_ns), now_ns), now_ns) is not None


@pytest.mark.parametrize("ahead_ns", [AHEAD_MAX_NS + 1, YEAR_2500_NS])
def test_a_sender_whose_clock_is_centuries_ahead_is_refused_and_not_learnt(ahead_ns: int) -> None:
    onboard, offboard = Endpoint("onboard", 1, KEY), Endpoint("offboard", 2, KEY)
    assert offboard.decode(onboard.encode(STATUS, 5 * S), 5 * S) is not None
    assert offboard.decode(onboard.encode(STATUS, 6 * S + ahead_ns), 6 * S) is None
    assert offboard.statistics.rejected == {"value": 1}
    assert offboard.decode(onboard.encode(STATUS, 7 * S), 7 * S) is not None
    assert offboard.statistics.delay_ns == 0


def test_a_first_time_of_the_year_2500_is_refused() -> None:
    onboard, offboard = Endpoint("onboard", 1, KEY), Endpoint("offboard", 2, KEY)
    assert offboard.decode(onboard.encode(STATUS, YEAR_2500_NS), 5 * S) is None
