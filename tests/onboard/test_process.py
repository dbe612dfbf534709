"""The onboard loop around a stand-in core: failures, requests to end, and that the last word is motors off."""

import time
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from configs.realtime import RealtimeConfig
from onboard.core import OnboardOutput
from onboard.process import FINAL_SAFE_COMMANDS, OnboardProcess
from onboard.record.datagram_log import Entry, LoggedTick, read_tick
from protocol.mavlink.frames import FrameWriter, Message
from runtime.sockets import Stamped

PERIOD_NS = 1_000_000
REALTIME = RealtimeConfig(priority=0, spin_us=0, escapes_max=3)


PEERS = ("vehicle", "offboard", "ground")


class FakeCore:
    """Answers every step; `script` is called first and may raise or press a key."""

    def __init__(self, script: Any) -> None:
        self.screens = (lambda datagram: 0,) * 3
        self.script = script
        self.steps = 0
        self.airborne = True
        self.land_requests = 0
        self.received: list[tuple[str, bytes]] = []

    def tick(self, now_ns: int, *received: Any, missed_ticks: int = 0) -> OnboardOutput:
        self.steps += 1
        *datagrams, land = received
        self.land_requests += land
        arrivals = [(name, one) for name, many in zip(PEERS, datagrams, strict=True) for one in many]
        assert all(one.age_ns >= 0 for _, one in arrivals), "no arrival is later than now"
        self.received += [(name, one.datagram) for name, one in arrivals]
        self.script(self)
        return OnboardOutput([b"motors"], [b"sample"], [b"telemetry"], events=[(now_ns, "event")])

    def safe_output(self, now_ns: int) -> OnboardOutput:
        return OnboardOutput([b"off"])

    def status(self, now_ns: int) -> dict[str, Any]:
        return {}

    def summary(self) -> dict[str, Any]:
        return {"mode": "LANDED"}


class FakeSocket:
    def __init__(self, talks: bool) -> None:
        self.talks = talks
        self.sent: list[bytes] = []

    def receive_stamped(self, limit: int) -> list[Stamped]:
        return [Stamped(b"hello", time.monotonic_ns())] if self.talks else []

    def send(self, datagram: bytes) -> None:
        self.sent.append(datagram)


class Bench:
    """A process with everything around it faked but the clock."""

    def __init__(self, script: Any, vehicle_talks: bool = True) -> None:
        self.core = FakeCore(script)
        self.stop = SimpleNamespace(count=0)
        talking = {"vehicle": vehicle_talks, "offboard": True, "ground": True}
        self.sockets = SimpleNamespace(**{name: FakeSocket(talks) for name, talks in talking.items()})
        self.logged: list[tuple[str, np.ndarray]] = []
        self.events: list[str] = []
        self.datagram_log: list[LoggedTick] = []
        log = SimpleNamespace(
            write=lambda kind, time_ns, vector: self.logged.append((kind.topic, vector.copy())),
            event=lambda time_ns, text: self.events.append(text),
            write_bytes=lambda topic, time_ns, data: self.datagram_log.append(read_tick(data)),
        )
        self.said: list[str] = []
        status = SimpleNamespace(report=self.said.append, due=lambda now: False)
        make: Any = OnboardProcess
        self.process = make(self.core, REALTIME, PERIOD_NS, self.sockets, log, status, self.stop)


def test_takes_in_steps_gives_out_and_logs_until_asked_to_end() -> None:
    bench = Bench(lambda core: None)

    def script(core: FakeCore) -> None:
        if core.steps == 10:
            core.airborne = False
            bench.stop.count = 1

    bench.core.script = script
    assert bench.process.fly() == 0
    assert bench.core.steps == 10
    assert bench.sockets.vehicle.sent == [b"motors"] * 10 + [b"off"] * FINAL_SAFE_COMMANDS
    assert bench.sockets.offboard.sent == [b"sample"] * 10
    assert bench.sockets.ground.sent == [b"telemetry"] * 10
    assert set(bench.core.received) == {("vehicle", b"hello"), ("offboard", b"hello"), ("ground", b"hello")}
    assert [topic for topic, _ in bench.logged] == ["onboard/tick", "onboard/loop"] * 10
    assert [tick.number for tick in bench.datagram_log] == list(range(10))
    entries = (Entry.FROM_VEHICLE, Entry.FROM_OFFBOARD, Entry.FROM_GROUND)
    for tick in bench.datagram_log:
        assert [tick.of(entry) for entry in entries] == [[b"hello"]] * 3
        assert tick.of(Entry.TO_VEHICLE) == [b"motors"]
        assert not tick.failed
    summary = bench.process.summary()
    assert (summary["ticks"], summary["mode"], summary["escapes"]) == (10, "LANDED", 0)
    assert summary["tick_us"]["p50"] <= summary["tick_us"]["p99"] <= summary["tick_us"]["max"] + 1


def test_a_key_that_a_ground_station_sends_reaches_neither_core_nor_log() -> None:
    """SETUP_SIGNING has the key in clear, and the datagram log has every datagram of a tick."""
    bench = Bench(lambda core: None)
    key = bytes(range(100, 132))
    frame = FrameWriter(255, 190).write(Message(mavlink.MAVLink_setup_signing_message, (7, 1, 1, *key)), 0)
    arriving = [frame, b"noise" + frame, frame[:30], b"hello"]
    for socket in (bench.sockets.ground, bench.sockets.vehicle):
        socket.receive_stamped = lambda limit: [Stamped(one, time.monotonic_ns()) for one in arriving]

    def script(core: FakeCore) -> None:
        bench.stop.count = 2

    bench.core.script = script
    assert bench.process.fly() == 0
    assert {datagram for name, datagram in bench.core.received} == {b"hello"}
    (tick,) = bench.datagram_log
    assert {one.datagram for _, one in tick.entries if key[:8] in one.datagram} == set()
    assert tick.of(Entry.FROM_GROUND) == tick.of(Entry.FROM_VEHICLE) == [b"hello"]
    dropped = bench.process.summary()["dropped"]
    assert dropped["ground"]["secret"] == dropped["vehicle"]["secret"] == 3


def test_a_failing_step_is_answered_with_motors_off_and_flown_on(capsys: pytest.CaptureFixture[str]) -> None:
    bench = Bench(lambda core: None)

    def script(core: FakeCore) -> None:
        if core.steps == 3:
            raise RuntimeError("broken once")
        if core.steps == 5:
            bench.stop.count = 2

    bench.core.script = script
    assert bench.process.fly() == 0
    assert bench.sockets.vehicle.sent[:5] == [b"motors", b"motors", b"off", b"motors", b"motors"]
    assert bench.process.summary()["escapes"] == 1
    assert [tick.failed for tick in bench.datagram_log] == [False, False, True, False, False]
    assert "broken once" in bench.events[2]
    assert "broken once" in capsys.readouterr().err


def test_too_many_failures_end_the_flight_with_motors_off(capsys: pytest.CaptureFixture[str]) -> None:
    def script(core: FakeCore) -> None:
        raise ZeroDivisionError("always")

    bench = Bench(script)
    assert bench.process.fly() == 1
    assert bench.core.steps == REALTIME.escapes_max
    assert set(bench.sockets.vehicle.sent) == {b"off"}
    assert "a tick failed (3 of 3): ZeroDivisionError: always" in bench.said
    assert capsys.readouterr().err.count("Traceback") == 1, "the same failure is told in full once"


def test_a_core_that_cannot_even_be_safe_does_not_hold_the_loop(capsys: pytest.CaptureFixture[str]) -> None:
    def script(core: FakeCore) -> None:
        raise RuntimeError("step")

    bench = Bench(script)
    bench.core.safe_output = lambda now_ns: script(bench.core)  # type: ignore[method-assign,return-value,assignment]
    assert bench.process.fly() == 1
    assert bench.sockets.vehicle.sent == []


def test_the_first_request_lands_and_the_motors_run_until_the_vehicle_is_on_the_floor() -> None:
    def script(core: FakeCore) -> None:
        bench.stop.count = int(core.steps >= 5)
        core.airborne = core.steps < 1000

    bench = Bench(script)
    assert bench.process.fly() == 0
    assert bench.core.land_requests == 1
    assert bench.core.steps == 1000
    assert bench.sockets.vehicle.sent[-1] == b"off"


def test_a_request_to_land_in_a_step_that_fails_is_repeated() -> None:
    def script(core: FakeCore) -> None:
        bench.stop.count = int(core.steps >= 5)
        core.airborne = core.steps < 10
        if core.steps == 6:
            raise RuntimeError("broken once")

    bench = Bench(script)
    assert bench.process.fly() == 0
    assert bench.core.land_requests == 2


def test_the_second_request_ends_at_once() -> None:
    bench = Bench(lambda core: setattr(bench.stop, "count", 2) if core.steps == 5 else None)
    assert bench.process.fly() == 0
    assert bench.core.steps == 5
    assert bench.sockets.vehicle.sent[-1] == b"off"


def test_a_silent_vehicle_is_not_waited_for() -> None:
    bench = Bench(lambda core: setattr(bench.stop, "count", 1) if core.steps == 5 else None, vehicle_talks=False)
    assert bench.process.fly() == 0
    assert bench.core.steps <= 6
