"""Lockstep: the same scenario and seed give the same flight, also in another interpreter; the delays are modelled."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import Choices, resolve
from sim_vehicle.lockstep import Lockstep

ROOT = Path(__file__).parents[2]
PERIOD_NS = 5_000_000
SECONDS = 8.0
"""Long enough for take-off, a path in wind, training rounds and a swap."""
EARLY_S = 3.0
FLIGHT = """
import sys
from tests.sim_vehicle.test_lockstep import fly
print(fly(int(sys.argv[1]))[0])
"""
QUICK_LEARNING = (
    "offboard.trainer.minimum_samples=16",
    "offboard.trainer.batches=20",
    "offboard.gate.minimum_validation=2",
    "offboard.gate.trigger=0.0",
    "offboard.gate.margin=0.0",
    "offboard.gate.significance=0.0",
    "onboard.guidance.trajectory.settle_s=0.0",
)


def fly(seed, seconds=SECONDS):
    """Trace hash, trace hash of the first seconds, summary of onboard, number of training results."""
    config = resolve("figure8_wind", Choices("dmrac", seed, None, QUICK_LEARNING))
    lockstep, onboard, _, _ = build(config)
    trained, early = 0, ""
    for tick in range(round(seconds * 200)):
        if tick == round(EARLY_S * 200):
            early = lockstep.trace_sha256
        trained += len(lockstep.step().training)
    return lockstep.trace_sha256, early, onboard.summary(), trained


def test_the_same_flight_has_the_same_trace_in_another_interpreter():
    other = subprocess.Popen(
        [sys.executable, "-c", FLIGHT, "11"],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": "77", "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        trace, early, summary, trained = fly(11)
        again, *_ = fly(11, EARLY_S)  # in an interpreter that has flown and trained
        fresh, _ = other.communicate(timeout=120)
    finally:
        other.kill()
    assert trained >= 1, "the flight should contain training"
    assert summary["features"]["swaps"] >= 1, "and a swap"
    assert again == early
    assert fresh.split()[-1] == trace


def test_another_seed_gives_another_trace():
    assert fly(11, 1.0)[0] != fly(12, 1.0)[0]


# --- time, with stand-ins for the cores ---------------------------------------------------------------------------


class FakeVehicle:
    crash_reason = ""

    def __init__(self):
        self.received = []

    def step(self, now_ns):
        return SimpleNamespace(to_onboard=[b"s%d" % now_ns], to_motion_capture=[b"m%d" % now_ns], truth=now_ns)

    def receive(self, datagram, now_ns):
        self.received.append((datagram, now_ns // PERIOD_NS))


class FakeOnboard:
    def __init__(self):
        self.from_vehicle, self.received, self.ticks = [], [], 0

    def tick(self, now_ns, from_vehicle, from_offboard):
        self.from_vehicle += [(datagram, now_ns) for datagram in from_vehicle]
        self.received += [(datagram, now_ns // PERIOD_NS) for datagram in from_offboard]
        self.ticks += 1
        return SimpleNamespace(to_vehicle=[b"c%d" % (self.ticks - 1)], to_offboard=[b"u%d" % (self.ticks - 1)])


class FakeOffboard:
    def __init__(self, job_at=None):
        self.received, self.poses, self.trained, self.tick, self.job_at = [], [], [], 0, job_at

    def receive_motion_capture(self, datagram, now_ns):
        self.poses.append(datagram)

    def receive_onboard(self, datagram, now_ns):
        self.received.append((datagram, now_ns // PERIOD_NS))

    def receive_training(self, result, now_ns):
        self.trained.append((result, now_ns // PERIOD_NS))

    def step(self, now_ns):
        job = SimpleNamespace(run=lambda: "trained features") if self.tick == self.job_at else None
        self.tick += 1
        return SimpleNamespace(to_onboard=[b"d%d" % (self.tick - 1)], job=job)


class FakeRadio:
    """Everything arrives three ticks later."""

    def __init__(self):
        self.air = {"up": [], "down": []}

    def send(self, direction, datagram, now_ns):
        self.air[direction].append((now_ns + 3 * PERIOD_NS, datagram))

    def due(self, direction, now_ns):
        due = [datagram for when, datagram in self.air[direction] if when <= now_ns]
        self.air[direction] = [entry for entry in self.air[direction] if entry[0] > now_ns]
        return due


def lockstep_of_fakes(ticks, job_at=None, training_ticks=0):
    vehicle, onboard, offboard = FakeVehicle(), FakeOnboard(), FakeOffboard(job_at)
    lockstep = Lockstep(vehicle, FakeRadio(), onboard, offboard, PERIOD_NS, training_ticks * PERIOD_NS)
    for _ in range(ticks):
        lockstep.step()
    return lockstep, vehicle, onboard, offboard


def test_a_command_acts_one_tick_after_it_was_computed():
    _, vehicle, _, _ = lockstep_of_fakes(4)
    assert vehicle.received == [(b"c0", 1), (b"c1", 2), (b"c2", 3)]


def test_sensors_reach_onboard_in_their_own_tick():
    _, _, onboard, offboard = lockstep_of_fakes(3)
    assert onboard.from_vehicle == [(b"s%d" % (k * PERIOD_NS), k * PERIOD_NS) for k in range(3)]
    assert len(offboard.poses) == 3


def test_both_directions_pass_through_the_radio():
    _, _, onboard, offboard = lockstep_of_fakes(6)
    assert offboard.received == [(b"u0", 3), (b"u1", 4), (b"u2", 5)]
    assert onboard.received == [(b"d0", 3), (b"d1", 4), (b"d2", 5)]


def test_training_takes_its_modelled_time():
    _, _, _, offboard = lockstep_of_fakes(12, job_at=2, training_ticks=5)
    assert offboard.trained == [("trained features", 7)]


def test_offboard_may_stop_and_start_again():
    lockstep, vehicle, onboard, _ = lockstep_of_fakes(3, job_at=1, training_ticks=5)
    lockstep.remove_offboard()
    for _ in range(8):
        assert lockstep.step().offboard is None
    assert [datagram for datagram, _ in onboard.received] == [b"d0", b"d1", b"d2"]  # what was on its way
    assert len(vehicle.received) == 10
    new = FakeOffboard()
    lockstep.attach_offboard(new)
    lockstep.step()
    assert new.trained == []
    assert new.received == [(b"u8", 11)]


def test_the_trace_covers_every_datagram_in_order():
    one, *_ = lockstep_of_fakes(5)
    two, *_ = lockstep_of_fakes(5)
    assert one.trace_sha256 == two.trace_sha256
    two.step()
    assert one.trace_sha256 != two.trace_sha256
