"""Reception during a flood: the peer's newest message is among what a step uses, and the rest is counted."""

import pytest

from runtime.intake import REFUSED, REPORT_PERIOD_NS, SCREENED_MAX, Intake
from runtime.sockets import DatagramSocket, Stamped

FEW, KIND_MAX = 16, 4


class Source:
    """Gives everything that was put in at once, as a socket does."""

    def __init__(self) -> None:
        self.waiting: list[bytes] = []
        self.dropped = 0

    def receive_stamped(self, limit: int) -> list[Stamped]:
        taken, self.waiting = self.waiting[:limit], self.waiting[limit:]
        return [Stamped(datagram, index) for index, datagram in enumerate(taken)]


def kind_of(datagram: bytes) -> int:
    """Good messages begin with a digit, their kind."""
    return datagram[0] - ord("0") if datagram[:1].isdigit() else REFUSED


def junk(count: int, tag: str = "junk") -> list[bytes]:
    return [f"{tag} {index}".encode() for index in range(count)]


def intake(source: Source) -> Intake:
    return Intake("vehicle", source, FEW, KIND_MAX, kind_of)


def datagrams(stamped: list[Stamped]) -> list[bytes]:
    return [one.datagram for one in stamped]


def test_a_few_datagrams_are_passed_on_as_they_are() -> None:
    source = Source()
    source.waiting = junk(FEW)
    one = intake(source)
    assert datagrams(one.receive()) == junk(FEW), "the core counts what is wrong with each"
    assert one.dropped.total() == 0


@pytest.mark.parametrize("before", [0, 20, 300])
@pytest.mark.parametrize("after", [20, 300])
def test_the_one_message_in_a_flood_is_found(before: int, after: int) -> None:
    source = Source()
    source.waiting = [*junk(before, "a"), b"1 reading", *junk(after, "b")]
    one = intake(source)
    assert datagrams(one.receive()) == [b"1 reading"]
    assert source.waiting == [], "nothing waits for the next step"
    assert one.dropped.total() == before + after
    assert one.dropped["unread"] == max(0, before + 1 + after - SCREENED_MAX)


def test_of_each_kind_the_newest_are_used_in_their_order() -> None:
    source = Source()
    source.waiting = [f"1 {index}".encode() for index in range(50)]
    source.waiting[10:10] = [b"2 rare"]
    one = intake(source)
    assert datagrams(one.receive()) == [b"2 rare", b"1 46", b"1 47", b"1 48", b"1 49"]
    assert one.dropped == {"surplus": 46, "refused": 0, "repeated": 0, "unread": 0}


def test_after_missed_ticks_more_is_used() -> None:
    source = Source()
    source.waiting = [*junk(100), *(f"1 {index}".encode() for index in range(50))]
    assert len(intake(source).receive(periods=3)) == 3 * KIND_MAX


def test_a_repeated_datagram_is_used_once() -> None:
    source = Source()
    source.waiting = [b"1 old"] * 100 + [b"1 new"] + [b"1 old"] * 100
    one = intake(source)
    assert datagrams(one.receive()) == [b"1 new", b"1 old"]
    assert one.dropped["repeated"] == 199


def test_a_flood_is_reported_with_its_rate_and_so_is_its_end() -> None:
    source = Source()
    one = intake(source)
    assert one.report(REPORT_PERIOD_NS) == ""
    source.waiting = [*junk(99), b"1 reading"]
    one.receive()
    source.dropped = 1
    assert one.report(REPORT_PERIOD_NS + 1) == "", "not more than once a second"
    assert one.report(3 * REPORT_PERIOD_NS) == "vehicle port flooded: 50 datagrams/s dropped"
    assert one.report(4 * REPORT_PERIOD_NS) == "vehicle port: the flood is over"
    assert one.report(5 * REPORT_PERIOD_NS) == ""
    assert one.summary() == {"refused": 99, "overflowed": 1}


def test_a_reading_behind_a_real_queue_is_found_where_a_bounded_read_misses_it() -> None:
    """The fault that this file mends: 16 datagrams a tick, oldest first, never reach the reading."""
    here = DatagramSocket("here", "127.0.0.1:0", None)
    there = DatagramSocket("there", "127.0.0.1:0", here.local_address)
    try:
        for _ in range(2):
            for datagram in (*junk(100, "a"), b"1 reading", *junk(100, "b")):
                there.send(datagram)
            if _ == 0:
                assert b"1 reading" not in here.receive(FEW)
                here.receive(1000)
        assert datagrams(intake(here).receive()) == [b"1 reading"]
    finally:
        here.close()
        there.close()


def test_a_datagram_with_a_secret_goes_nowhere_and_is_reported() -> None:
    source = Source()
    source.waiting = [b"1 good", b"1 the secret", b"1 also good"]
    one = Intake("ground", source, FEW, KIND_MAX, kind_of, lambda datagram: b"secret" in datagram)
    assert datagrams(one.receive()) == [b"1 good", b"1 also good"]
    assert one.summary() == {"secret": 1, "overflowed": 0}
    assert "SETUP_SIGNING" in one.report(REPORT_PERIOD_NS)
    assert one.report(2 * REPORT_PERIOD_NS) == ""
