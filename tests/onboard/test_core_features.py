"""Feature versions in the onboard core: accepted, refused, restarted."""

import dataclasses

import numpy as np
import pytest

from onboard.control.feature_reception import REFUSALS_KEPT, REPORTS, FeatureReception
from onboard.control.feature_swap import SwapConfig
from onboard.control.features import random_channel
from onboard.control.guard import Fall
from protocol.feature_codec import encode_feature_set
from protocol.feature_set import FeatureSet
from protocol.messages import REFUSALS, FeatureChunk
from protocol.transfer import split
from tests.onboard.loop import CLOCK_NS, Loop, Peer, in_flight


def features(version=1, gain=1.0, last_layer=0.0):
    rng = np.random.default_rng(version)
    start = random_channel(("position_n", "velocity_n"), np.zeros(2), np.ones(2), (8, 5), rng)
    weights = tuple(gain * W for W in start.weights)
    source = dataclasses.replace(start, weights=weights, last_layer=np.full((6, 3), last_layer))
    return FeatureSet(version, 0, 100, source, source)


def test_good_features_come_into_use_and_are_reported():
    loop = in_flight("dmrac")
    loop.peer.sender.offer(features(), loop.now_ns)
    loop.fly(2.0)
    assert loop.said("features 1 in use")
    assert loop.peer.statuses[-1].feature_version == 1
    assert loop.column("feature_version")[-1] == 1
    assert 0.0 < loop.column("feature_age")[-1] < 2.0
    assert loop.core.summary()["features"] == {"version": 1, "swaps": 1, "refused": 0, "taken_back": 0}
    assert loop.peer.batches[-1].feature_version == 1
    assert loop.peer.sender.outstanding_version == 0
    assert loop.vehicle.crash_reason == ""


@pytest.mark.parametrize(
    ("controller", "sent", "reason"),
    [
        ("dmrac", features(gain=100.0), "lipschitz"),
        ("dmrac", features(last_layer=100.0), "weight_norm"),
        ("pid", features(), "not_accepting"),
    ],
)
def test_features_are_refused_with_the_reason(controller, sent, reason):
    loop = in_flight(controller)
    loop.peer.sender.offer(sent, loop.now_ns)
    loop.fly(1.2)
    status = loop.peer.statuses[-1]
    assert (status.refused_version, REFUSALS[status.refusal]) == (1, reason)
    assert status.feature_version == 0
    assert loop.said(f"features 1 refused: {reason}")
    assert loop.peer.sender.outstanding_version == 0


def test_features_that_jump_too_far_are_refused_in_flight():
    """nu is continuous at the present state, so the path has to lead somewhere else, and what is there to be flown."""
    loop = in_flight("dmrac")
    position = loop.core.controller.augmentations[0]
    position._config = position._config.model_copy(update={"swap": SwapConfig(jump_max=1e-6)})
    position._signals = position._signals + np.array([0.0, 0.5, 0.0])
    position.last_layer._skill.shares = [1.0, 1.0, 1.0]
    position.step = lambda channel, telemetry: np.zeros(3)  # the next tick would see hover again
    loop.peer.sender.offer(features(last_layer=1.0), loop.now_ns)
    loop.fly(1.2)
    assert REFUSALS[loop.peer.statuses[-1].refusal] == "swap_jump"


def test_undecodable_features_are_refused_on_arrival():
    loop = Loop("dmrac", peer=Peer()).fly(1.0)
    loop.waiting += split(b"no feature set" * 30, 4, 1000)
    loop.fly(1.2)
    assert loop.peer.statuses[-1].refused_version == 4
    assert loop.peer.statuses[-1].refusal > 0


def test_a_controller_that_does_not_learn_refuses():
    class Plain:
        def step(self, inputs):
            raise AssertionError

    reception = FeatureReception()
    for chunk in split(encode_feature_set(features(), "float32"), 1, 1000):
        reception.receive(chunk)
    assert reception.swap(Plain(), 5) == ([(5, "features 1 refused: not_accepting")], [])
    assert reception.status[-2:] == (1, REFUSALS.index("not_accepting"))
    assert reception.swap(Plain(), 6) == ([], [])


def test_a_version_taken_back_is_reported_to_the_trainer_and_on_the_pilots_screen():
    loop = in_flight("dmrac")
    loop.peer.sender.offer(features(), loop.now_ns)
    loop.fly(1.2)
    loop.core.controller.guard._watches[0]._worse_s = 1.0
    texts = []
    send_text = loop.core._ground_link.send_text
    loop.core._ground_link.send_text = lambda text: (texts.append(text), send_text(text))
    loop.fly(0.3)
    status = loop.peer.statuses[-1]
    assert (status.feature_version, status.refused_version) == (0, 1)
    assert REFUSALS[status.refusal] == "probation"
    assert loop.said("guard: ")
    assert texts == loop.said("guard: ")
    assert loop.core.summary()["features"]["taken_back"] == 1
    assert loop.peer.batches[-1].feature_version == 0


def test_chunks_of_a_peer_that_has_not_proven_life_are_not_taken():
    loop = Loop("dmrac", peer=Peer())
    take_in = loop.peer.take_in
    loop.peer.take_in = lambda datagram, now_ns: [
        one for one in take_in(datagram, now_ns) if type(one).__name__ != "TimeSyncReply"
    ]
    loop.core._offboard_link.endpoint.layout = loop.peer.endpoint.layout = bytes(8)  # the layout has a check of its own
    loop.peer.sender.offer(features(), loop.now_ns)
    loop.fly(1.2)
    assert loop.core.summary()["features"]["version"] == 0
    assert loop.core.summary()["rejected"]["not_alive"] > 0
    loop.peer.take_in = take_in
    loop.fly(3.0)
    assert loop.core.summary()["features"]["version"] == 1


def test_features_that_wait_are_void_when_the_peer_restarts():
    class Plain:
        pass

    reception = FeatureReception()
    for chunk in split(encode_feature_set(features(), "float32"), 1, 1000):
        reception.receive(chunk)
    reception.restart()
    assert reception.swap(Plain(), 0) == ([], [])
    assert reception.status[-2:] == (0, 0)


def test_every_refusal_is_named_by_some_statuses_and_the_last_one_stays():
    """Also those that come between two statuses, and an older version than the last one refused."""

    class Plain:
        pass

    reception = FeatureReception()
    for number in (1, 2, 3):
        for chunk in split(encode_feature_set(features(number), "float32"), number, 1000):
            reception.receive(chunk)
        reception.swap(Plain(), 0)
    reception._fall_back(Fall(2, 0, "guard: a fall"), 0)
    named = []
    for _ in range(20):
        named.append(reception.status[-2:])
        reception.note_status()
    reasons = [(version, REFUSALS[reason]) for version, reason in dict.fromkeys(named)]
    assert reasons == [(1, "not_accepting"), (2, "not_accepting"), (3, "not_accepting"), (2, "probation")]
    assert [named.count(one) for one in dict.fromkeys(named)] == [REPORTS, REPORTS, REPORTS, 20 - 3 * REPORTS]


def test_of_too_many_refusals_the_oldest_are_dropped():
    reception = FeatureReception()
    for number in range(1, 2 * REFUSALS_KEPT):
        reception._fall_back(Fall(number, 0, "guard: a fall"), 0)
    assert reception.status[-2:] == (REFUSALS_KEPT, REFUSALS.index("probation"))


def test_a_version_is_prepared_over_many_ticks_and_swapped_in_one():
    loop = Loop("dmrac", peer=Peer()).fly(1.0)
    chunks = split(encode_feature_set(features(), "float32"), 1, 300)
    loop.extra = [loop.peer.endpoint.encode(chunk, loop.now_ns + CLOCK_NS) for chunk in chunks[:-1]]
    loop.step()
    assert loop.core.summary()["features"]["version"] == 0
    assert isinstance(chunks[-1], FeatureChunk)
    loop.extra = [loop.peer.endpoint.encode(chunks[-1], loop.now_ns + CLOCK_NS)]
    ticks = 0
    while loop.core.summary()["features"]["version"] == 0:
        loop.step()
        ticks += 1
        assert ticks < 250
    assert ticks > 20
    assert loop.column("feature_version")[-1] == 1


def test_the_version_in_preparation_is_finished_first_and_the_newest_of_the_others_comes_next():
    loop = Loop("dmrac", peer=Peer()).fly(1.0)
    for number in (1, 2, 3):
        loop.extra = [
            loop.peer.endpoint.encode(chunk, loop.now_ns + CLOCK_NS)
            for chunk in split(encode_feature_set(features(number), "float32"), number, 1000)
        ]
        loop.step()
    loop.fly(2.4)
    assert [text for text in loop.said("in use") if "features" in text] == [
        "features 1 in use, parent 0, 100 samples",
        "features 3 in use, parent 0, 100 samples",
    ]
    assert loop.core.summary()["features"]["swaps"] == 2


def test_a_version_in_preparation_is_void_when_the_peer_restarts():
    loop = Loop("dmrac", peer=Peer(session=2)).fly(1.0)
    chunks = split(encode_feature_set(features(), "float32"), 1, 1000)
    loop.extra = [loop.peer.endpoint.encode(chunk, loop.now_ns + CLOCK_NS) for chunk in chunks]
    loop.fly(0.05)
    loop.join(Peer(session=3))
    loop.fly(1.0)
    assert loop.said("offboard restarted")
    assert loop.core.summary()["features"]["version"] == 0


def test_a_version_is_swapped_in_while_offboard_is_silent():
    loop = Loop("dmrac", peer=Peer()).fly(1.0)
    chunks = split(encode_feature_set(features(), "float32"), 1, 1000)
    loop.extra = [loop.peer.endpoint.encode(chunk, loop.now_ns + CLOCK_NS) for chunk in chunks]
    loop.step()
    loop.peer, loop.waiting = None, []
    loop.fly(1.2)
    assert loop.core.summary()["features"]["version"] == 1


def test_a_restarted_peer_may_number_its_features_anew():
    loop = Loop("dmrac", peer=Peer(session=2)).fly(1.0)
    loop.peer.sender.offer(features(version=9), loop.now_ns)
    loop.fly(1.5)
    assert loop.column("feature_version")[-1] == 9
    loop.join(Peer(session=3))
    loop.fly(1.2)
    assert loop.said("offboard restarted")
    loop.waiting += split(encode_feature_set(features(version=1), "float32"), 1, 1000)
    loop.fly(1.2)
    assert loop.column("feature_version")[-1] == 1
