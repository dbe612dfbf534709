"""Versions that onboard names: those of an earlier trainer are learnt once, others that were never sent are refused."""

from dataclasses import replace

from offboard.core import OffboardCore
from onboard.flight.modes import FlightMode
from protocol.endpoint import Endpoint
from protocol.messages import MODES, VERSION_MAX, Status
from tests.offboard.flights import offboard_config

MS = 1_000_000
STATUS = Status(4, 0, 0, b"", 0, 0, 10, 0, 5, 10, 0, 0)


def test_numbers_go_on_from_what_an_earlier_trainer_sent_and_from_nothing_else() -> None:
    core = OffboardCore(offboard_config(), 5, None)
    onboard = Endpoint("onboard", 1, None)

    def told(now_ms: int, **versions: int) -> int:
        core.receive_onboard(onboard.encode(replace(STATUS, **versions), now_ms * MS), now_ms * MS)
        return core.learner.version

    assert told(0, feature_version=40) == 40, "the first status of a session: an earlier trainer sent them"
    assert told(100, feature_version=40, refused_version=39) == 40
    for name in ("feature_version", "transfer_version", "refused_version"):
        assert told(200, **{name: VERSION_MAX}) == 40
    assert core.endpoint.statistics.rejected == {"version_not_sent": 3}
    events = [text for _, text in core.step(300 * MS).events if "never sent" in text]
    assert events == [f"onboard names version {VERSION_MAX}, which was never sent: status refused"], "once"
    onboard = Endpoint("onboard", 2, None)
    assert told(400, feature_version=41) == 41, "another session"


def test_the_protocol_knows_all_flight_modes() -> None:
    assert len(FlightMode) == MODES
