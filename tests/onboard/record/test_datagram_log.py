import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.record.datagram_log import ENTRY_MAX_BYTES, HEAD, DatagramLogWriter, Entry, read_tick
from protocol.arrival import Arrival

arrivals = st.builds(Arrival, st.binary(max_size=300), st.integers(0, 2**62))
entries = st.lists(st.tuples(st.sampled_from(Entry), arrivals), max_size=20)


@given(st.lists(entries, max_size=5), st.integers(0, 2**62), st.integers(0, 2**31), st.booleans())
def test_what_goes_on_the_datagram_log_comes_back(
    ticks: list[list[tuple[Entry, Arrival]]], now_ns: int, missed: int, failed: bool
) -> None:
    writer = DatagramLogWriter()
    for number, put in enumerate(ticks):
        for kind, data in put:
            writer.put(kind, [data])
        tick = read_tick(writer.end_tick(now_ns, missed, failed))
        assert (tick.now_ns, tick.number, tick.missed_ticks, tick.failed) == (now_ns, number, missed, failed)
        assert tick.entries == tuple(put)


def test_a_request_to_land_is_logged() -> None:
    writer = DatagramLogWriter()
    writer.land_request()
    tick = read_tick(writer.end_tick(20, 0))
    assert len(tick.of(Entry.LAND_REQUEST)) == 1
    assert tick.of(Entry.FROM_VEHICLE) == []


def test_plain_bytes_have_age_0() -> None:
    writer = DatagramLogWriter()
    writer.put(Entry.FROM_VEHICLE, [b"now", Arrival(b"before", 7)])
    tick = read_tick(writer.end_tick(20, 0))
    assert tick.of(Entry.FROM_VEHICLE) == [b"now", b"before"]
    assert tick.arrivals(Entry.FROM_VEHICLE) == [Arrival(b"now", 0), Arrival(b"before", 7)]


@pytest.mark.parametrize("cut", [1, HEAD.size + 1, HEAD.size + 5])
def test_a_torn_record_is_refused(cut: int) -> None:
    writer = DatagramLogWriter()
    writer.put(Entry.TO_VEHICLE, [b"motors"])
    with pytest.raises(ValueError, match="of a datagram log"):
        read_tick(writer.end_tick(1, 0)[:cut])


@given(st.binary(max_size=200))
def test_any_bytes_are_a_record_or_a_value_error(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        read_tick(data)


def test_the_longest_datagram_fits() -> None:
    writer = DatagramLogWriter()
    writer.put(Entry.FROM_VEHICLE, [bytes(ENTRY_MAX_BYTES)])
    assert read_tick(writer.end_tick(1, 0)).of(Entry.FROM_VEHICLE) == [bytes(ENTRY_MAX_BYTES)]
