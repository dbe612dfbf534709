"""A stall of the simulator makes a flight invalid if it was long or had consequences for the vehicle."""

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


def test_motors_stopped_in_a_stall_make_a_flight_invalid() -> None:
    stalls = Stalls()
    stalls.note(2 * S, 58 * MS)
    stalls.note_stop(2 * S + 5 * MS)
    assert stalls.invalid_reason == "the motors were stopped when the simulator stood still for 58 ms at 2.00 s"


def test_motors_stopped_later_are_a_landing() -> None:
    stalls = Stalls()
    stalls.note(2 * S, 58 * MS)
    stalls.note_stop(2 * S + 100 * MS)
    assert stalls.invalid_reason == ""


def test_a_vehicle_never_armed_is_an_invalid_flight_only_with_stalls() -> None:
    smooth, stalling = Stalls(), Stalls()
    for second in range(4):
        smooth.note(second * S, 5 * MS)
        stalling.note(second * S, (20 + second % 3 * 10) * MS)
    smooth.note_no_flight()
    stalling.note_no_flight()
    assert smooth.invalid_reason == ""
    assert stalling.invalid_reason == "the vehicle was never armed; the simulator stood still for 40 ms at 2.00 s"
