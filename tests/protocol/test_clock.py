from hypothesis import given
from hypothesis import strategies as st

from protocol.clock import ForwardClock


def test_a_clock_that_is_set_back_repeats_its_time_once_and_continues() -> None:
    clock = ForwardClock()
    assert [clock.at(now) for now in (100, 105, 110, 10, 15, 20, 3, 5)] == [100, 105, 110, 110, 115, 120, 120, 122]
    assert clock.jumps == 2


def test_a_clock_that_runs_forward_is_not_changed() -> None:
    clock = ForwardClock()
    assert [clock.at(now) for now in (-5, 0, 0, 10**18)] == [-5, 0, 0, 10**18]
    assert clock.jumps == 0


@given(st.lists(st.integers(-(10**15), 10**15)))
def test_it_never_goes_back(times: list[int]) -> None:
    clock = ForwardClock()
    read = [clock.at(now) for now in times]
    assert read == sorted(read)
