"""Mode bench under the stand-in for the firmware: one motor at a time, with pauses, and never two."""

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from mambo.build import Built
from mambo.fake.wire import Answer, Calls
from tests.mambo.rig import OWN_PORT, PERIOD_NS, Rig, board, write

START, STOP, RUN = 1, 2, 3
COMMAND, TURN_S, PAUSE_S = 75, 0.25, 0.125
TURN, PAUSE = round(TURN_S * 1e9 / PERIOD_NS), round(PAUSE_S * 1e9 / PERIOD_NS)
"""Calls."""


Make = Callable[..., Rig]
"""A rig that has not been called yet, in a mode, with settings of the board."""


@pytest.fixture
def make(native: Built, tmp_path: Path) -> Iterator[Make]:
    rigs: list[Rig] = []

    def one(mode: str = "bench", **values: Any) -> Rig:
        record = {"bench_command": COMMAND, "bench_turn_s": TURN_S, "bench_pause_s": PAUSE_S}
        write(tmp_path, board(mode, record=record, **values), cleared=False)
        rigs.append(Rig(native, tmp_path))
        return rigs[-1]

    yield one
    for rig in rigs:
        rig.process.close()


def turning(answer: Answer) -> list[int]:
    """Motors of the firmware, 1 to 4, that turn."""
    return [motor for motor, speed in enumerate(answer.speeds, 1) if speed != 0]


def test_each_motor_turns_alone_in_its_turn(make: Make) -> None:
    rig = make()
    answers = [rig.call() for _ in range(4 * (PAUSE + TURN) + 50)]
    expected = [turn for motor in (1, 2, 3, 4) for turn in [[]] * PAUSE + [[motor]] * TURN] + [[]] * 50
    assert [turning(one) for one in answers] == expected
    for answer in answers:
        assert sorted(answer.speeds)[3] == (COMMAND if turning(answer) else 0)
    words = [one.word for one in answers]
    assert words == ([STOP] * PAUSE + [START] + [RUN] * (TURN - 1)) * 4 + [STOP] * 50
    assert all(one.view["mode"] == 0 for one in answers)  # BOOT: no flight mode is left


def test_the_motors_are_the_firmwares_whatever_their_order_in_flight(make: Make) -> None:
    rig = make(motors={"order": (1, 2, 3, 4)})
    assert turning(rig.run(PAUSE + TURN)) == [1]


def test_a_call_that_comes_twice_changes_nothing(make: Make) -> None:
    rig = make()
    answer = rig.run(PAUSE + 5)
    assert rig.call(calls=Calls.CONTROL | Calls.TWICE).speeds == answer.speeds


def test_the_firmwares_stop_ends_the_turns(make: Make) -> None:
    rig = make(watchdogs={"heed_stop": True})
    assert turning(rig.run(PAUSE + 5)) == [1]
    assert turning(rig.call(calls=Calls.CONTROL | Calls.STOPS_MOTORS)) == []
    assert all(turning(rig.call()) == [] for _ in range(4 * (PAUSE + TURN)))
    assert rig.events == ["motors off: the firmware stopped them"]


def test_without_calls_the_turn_passes(make: Make) -> None:
    """The firmware's own stop must hold the motors then; the library goes on where it should be by now."""
    rig = make()
    assert turning(rig.run(PAUSE + 5)) == [1]
    assert turning(rig.call(gap_ns=(TURN + PAUSE) * PERIOD_NS)) == [2]


@pytest.mark.parametrize("mode", ["record", "bench"])
def test_no_port_is_opened(make: Make, mode: str) -> None:
    make(mode).run(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", OWN_PORT))


def test_in_mode_record_no_motor_turns(make: Make) -> None:
    rig = make("record")
    answers = [rig.call() for _ in range(4 * (PAUSE + TURN))]
    assert all(turning(one) == [] and one.word == STOP for one in answers)
