"""The vehicle's clock: a wrong stamp is refused, a jump or a restart is followed."""

import pytest

from onboard.links.vehicle_clock import SHORT_STEP_SUSPECTS, SUSPECTS, VehicleClock

MS = 1_000_000
STEP_NS = 5 * MS
RESTART_NS = 500 * MS


class Vehicle:
    """Stamps every 5 ms; arrival 1 ms later."""

    def __init__(self, steps: int = 100) -> None:
        self.clock = VehicleClock(RESTART_NS)
        self.now_ns = 10**12
        self.shift_ns = 0
        for _ in range(steps):
            assert self.send() == ""

    def send(self, ahead_ms: float = 0.0, late_ms: float = 0.0) -> str:
        self.now_ns += STEP_NS
        self.stamp_ns = self.now_ns - 9 * 10**11 + self.shift_ns + int(ahead_ms * MS)
        self.arrival_ns = self.now_ns + MS + int(late_ms * MS)
        return self.clock.accept(self.stamp_ns, self.arrival_ns)

    @property
    def error_ms(self) -> float:
        return (self.clock.to_onboard(self.stamp_ns, self.arrival_ns) - self.now_ns) / MS - 1.0


@pytest.mark.parametrize("ahead_ms", [60.0, 200.0, 510.0, 10_000.0])
def test_a_lone_stamp_ahead_costs_one_sample(ahead_ms: float) -> None:
    vehicle = Vehicle()
    assert vehicle.send(ahead_ms) == "time_ahead"
    for _ in range(400):
        assert vehicle.send() == ""
        assert vehicle.error_ms == 0.0
    assert vehicle.clock.restarts == 0


@pytest.mark.parametrize("jump_ms", [60, 200, 510, -60, -200, -499])
def test_a_jump_of_the_clock_costs_few_samples(jump_ms: int) -> None:
    vehicle = Vehicle()
    vehicle.shift_ns = jump_ms * MS
    refused, suspects = ("time_ahead", SUSPECTS) if jump_ms > 0 else ("time_backwards", SHORT_STEP_SUSPECTS)
    assert [vehicle.send() for _ in range(suspects - 1)] == [refused] * (suspects - 1)
    assert [vehicle.send() for _ in range(3)] == ["jump", "", ""]
    assert vehicle.error_ms == 0.0
    assert vehicle.clock.restarts == 0


def test_datagrams_that_were_held_up_are_no_jump() -> None:
    vehicle = Vehicle()
    held = [vehicle.stamp_ns - count * STEP_NS for count in range(8, 0, -1)]
    for stamp_ns in held:
        assert vehicle.clock.accept(stamp_ns, vehicle.arrival_ns) == "time_backwards"
    assert vehicle.send() == ""
    assert vehicle.clock.interleaved == 0


@pytest.mark.parametrize("stall_ms", [5, 20, 34, 50])
def test_a_stall_of_the_receiver_is_not_seen_in_the_mapped_time(stall_ms: int) -> None:
    vehicle = Vehicle()
    for late_ms in range(stall_ms, 0, -5):
        assert vehicle.send(late_ms=late_ms) == ""
        assert vehicle.error_ms == 0.0


def test_a_map_that_started_late_is_corrected_at_once() -> None:
    vehicle = Vehicle(steps=0)
    assert vehicle.send(late_ms=34.0) == ""
    assert [vehicle.send() for _ in range(4)] == ["time_ahead", "time_ahead", "jump", ""]
    assert vehicle.error_ms == 0.0
