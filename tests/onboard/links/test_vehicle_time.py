"""The link to the vehicle: mapped times, restarts, and other vehicles."""

import itertools

import numpy as np
import pytest

from tests.onboard.links.pymavlink_vehicle import LATENCY_NS, STEP_NS, Link, Vehicle


@pytest.fixture
def link():
    return Link()


def test_time_is_mapped_by_the_least_delay():
    """A vehicle clock 40 ppm fast, delays with a long tail: the mapped time is never after the arrival, and close."""
    rng = np.random.default_rng(4)
    link, vehicle = Link(), Vehicle()
    errors = []
    for count in range(4000):
        true_ns = 10**12 + count * STEP_NS
        stamp_ns = int(123e9 + (true_ns - 10**12) * (1 + 40e-6))
        arrival_ns = true_ns + LATENCY_NS + int(rng.exponential(2e6))
        (reading,) = link.receive(vehicle.imu(stamp_ns), arrival_ns)
        assert reading.time_ns <= arrival_ns
        errors.append(reading.time_ns - true_ns - LATENCY_NS)
    late = np.array(errors[400:]) * 1e-6
    assert np.abs(late).max() < 0.6
    assert np.abs(np.diff(late)).max() < 0.5


def test_a_late_or_repeated_sample_is_dropped(link):
    vehicle = Vehicle()
    vehicle.tick(link, 10)
    assert link.receive(vehicle.imu(), link.now_ns) == []
    assert link.receive(vehicle.imu(vehicle.clock_ns - 3 * STEP_NS), link.now_ns) == []
    assert (link.rejected["time_repeated"], link.rejected["time_backwards"]) == (1, 1)
    assert len(vehicle.tick(link)) == 1
    assert link.restarts == 0


def test_a_restarted_vehicle_is_used_again_and_reported(link):
    Vehicle(clock_ns=500 * 10**9).tick(link, 100)
    before_ns = link.now_ns
    again = Vehicle()
    readings = again.tick(link, 10)
    assert len(readings) == 8  # after two samples to be sure
    assert link.restarts == 1
    assert "vehicle restarted" in link.texts()
    assert not link.conflict
    times = [reading.time_ns for reading in readings]
    assert all(a < b for a, b in itertools.pairwise(times))
    assert times[0] > before_ns


def test_one_wrong_time_stamp_is_recovered_from(link):
    vehicle = Vehicle(clock_ns=10**9)
    vehicle.tick(link, 50)
    assert link.receive(vehicle.imu(10**15), link.now_ns) == []
    assert link.rejected["time_ahead"] == 1
    readings = vehicle.tick(link, 10)
    assert len(readings) == 10
    assert abs(readings[-1].time_ns - link.now_ns) < 1_000_000


# -- two vehicles -----------------------------------------------------------------------------------------------------


def test_only_the_first_vehicle_counts(link):
    first, second = Vehicle(1), Vehicle(2)
    first.tick(link)
    for _ in range(50):
        assert len(first.tick(link)) == 1
        assert second.tick(link) == []
    assert link.system == 1
    assert link.rejected["other_vehicle"] == 50
    texts = link.texts()
    assert texts.count("second vehicle (system id 2)") == 1  # reported, but not 200 times a second


def test_another_vehicle_counts_after_a_long_silence(link):
    Vehicle(1).tick(link)
    second = Vehicle(2)
    assert second.tick(link) == []
    link.now_ns += 11 * 10**9
    assert len(second.tick(link)) == 1
    assert link.system == 2


def test_a_configured_vehicle_is_the_only_one():
    link = Link(vehicle_system=9)
    assert Vehicle(1).tick(link) == []
    assert len(Vehicle(9).tick(link)) == 1


def test_two_vehicles_with_one_system_id_are_detected(link):
    one, two = Vehicle(1, clock_ns=900 * 10**9), Vehicle(1, clock_ns=10**9)
    for _ in range(400):
        one.tick(link)
        two.tick(link)
    assert link.conflict
    first, second = Link(), Vehicle(1, clock_ns=10**9)
    for _ in range(3):
        one.tick(first, 5)
        second.tick(first, 5)
    assert first.conflict
    assert "two vehicles with one system id" in first.texts()
