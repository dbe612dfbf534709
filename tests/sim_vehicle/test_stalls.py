"""A stall of the simulator makes a flight invalid if it was long, or if the vehicle crashed soon after it."""

from sim_vehicle.stalls import Stalls

MS = 1_000_000
S = 10**9


def test_short_stalls_leave_a_flight_valid() -> None:
    stalls = Stalls()
    for second in range(20):
        stalls.note(second * S, 100 * MS)
    stalls.note_crash(30 * S)
    assert stalls.invalid_reason == "", "the crash came long after the last stall"


def test_a_long_stall_makes_a_flight_invalid() -> None:
    stalls = Stalls()
    stalls.note(4 * S, 300 * MS)
    stalls.note(5 * S, 400 * MS)
    assert stalls.invalid_reason == "the simulator stood still for 300 ms at 4.00 s"


def test_a_crash_soon_after_a_stall_makes_a_flight_invalid() -> None:
    stalls = Stalls()
    stalls.note(4 * S, 34 * MS)
    stalls.note_crash(5 * S)
    assert stalls.invalid_reason == "the vehicle crashed 1.00 s after the simulator stood still for 34 ms"


def test_a_crash_without_a_stall_is_a_lost_vehicle() -> None:
    stalls = Stalls()
    stalls.note(4 * S, 19 * MS)
    stalls.note_crash(5 * S)
    assert stalls.invalid_reason == ""
