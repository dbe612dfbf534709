"""The handshake: samples and features of a peer with another `features` section or sample layout are refused."""

from configs.flight_tree import Choices
from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import resolve
from offboard.core import OffboardCore
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.messages import FeatureChunk, TimeSyncReply, TimeSyncRequest

MS = 1_000_000
LEARNING = ("offboard.trainer.minimum_samples=16", "offboard.gate.trigger=0.0")
CHUNK = FeatureChunk(1, 0, 1, bytes(16), b"x")


def test_chunks_are_refused_until_the_peer_shows_the_same_layout() -> None:
    onboard = Endpoint("onboard", 1, None, layout=b"12345678")
    offboard = Endpoint("offboard", 2, None, layout=b"12345678")
    assert onboard.decode(offboard.encode(CHUNK, 0), 0) is None
    assert onboard.statistics.rejected["layout"] == 1
    onboard.encode(TimeSyncRequest(5), 5)
    assert onboard.decode(offboard.encode(TimeSyncReply(5, 6, 6), 6), 7) is not None
    assert onboard.decode(offboard.encode(CHUNK, 8), 8) is not None
    restarted = Endpoint("offboard", 3, None, layout=b"12345678")
    assert onboard.decode(restarted.encode(CHUNK, 9), 9) is None, "a new session shows its own"


def test_a_flight_with_two_feature_sections_flies_on_and_both_sides_name_both_digests() -> None:
    config = resolve("figure8_calm", Choices("dmrac", 1, 20.0, LEARNING))
    other = resolve("figure8_calm", Choices("dmrac", 1, 20.0, (*LEARNING, "features.trained.count=12")))
    lockstep, onboard, _, _ = build(config)
    offboard = OffboardCore(other.offboard, 2, None)
    lockstep.attach_offboard(offboard)
    events: list[str] = []
    for _ in range(2400):
        result = lockstep.step()
        assert result.offboard is not None
        events += [text for _, text in (*result.onboard.events, *result.offboard.events)]
    digests = [feature_digest(one.features).hex()[:8] for one in (config, other)]
    reports = [text for text in events if "samples and features are refused" in text]
    assert len(reports) == 2, "once on each side"
    assert all(digest in text for text in reports for digest in digests)
    assert lockstep.crash_reason == ""
    assert onboard.summary()["features"]["swaps"] == 0
    assert offboard.learner.samples == 0
    assert offboard.endpoint.statistics.rejected["layout"] > 50
    assert onboard.status(0)["mode"] == "FLYING", "poses are still used"
