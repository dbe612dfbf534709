"""Mode bench under the stand-in for the firmware: one motor at a time, with pauses, and never two."""

from pathlib import Path
from typing import Any

import pytest

from mambo.build import Built
from mambo.fake.wire import Answer, Calls
from tests.mambo.rig import PERIOD_NS, Rig, board, write

START, STOP, RUN = 1, 2, 3
COMMAND, TURN_S, PAUSE_S = 75, 0.25, 0.15
TURN, PAUSE = round(TURN_S * 1e9 / PERIOD_NS), round(PAUSE_S * 1e9 / PERIOD_NS)
"""Calls."""


def bench(built: Built, folder: Path, **values: Any) -> Rig:
    """A rig that has not been called yet."""
    record = {"bench_command": COMMAND, "bench_turn_s": TURN_S, "bench_pause_s": PAUSE_S}
    write(folder, board("bench", record=record, **values), cleared=False)
    return Rig(built, folder)


def turning(answer: Answer) -> list[int]:
    """Motors of the firmware, 1 to 4, that turn."""
    return [motor for motor, speed in enumerate(answer.speeds, 1) if speed != 0]


def test_each_motor_turns_alone_in_its_turn(native: Built, tmp_path: Path) -> None:
    rig = bench(native, tmp_path)
    answers = [rig.call() for _ in range(4 * (PAUSE + TURN) + 50)]
    expected = [turn for motor in (1, 2, 3, 4) for turn in [[]] * PAUSE + [[motor]] * TURN] + [[]] * 50
    assert [turning(one) for one in answers] == expected
    for answer in answers:
        assert sorted(answer.speeds)[3] == (COMMAND if turning(answer) else 0)
    words = [one.word for one in answers]
    assert words == ([STOP] * PAUSE + [START] + [RUN] * (TURN - 1)) * 4 + [STOP] * 50
    assert all(one.view["mode"] == 0 for one in answers)  # BOOT: no flight mode is left


def test_the_motors_are_the_firmwares_whatever_their_order_in_flight(native: Built, tmp_path: Path) -> None:
    rig = bench(native, tmp_path, motors={"order": (1, 2, 3, 4)})
    assert turning(rig.run(PAUSE + TURN)) == [1]


def test_a_call_that_comes_twice_changes_nothing(native: Built, tmp_path: Path) -> None:
    rig = bench(native, tmp_path)
    answer = rig.run(PAUSE + 5)
    assert rig.call(calls=Calls.CONTROL | Calls.TWICE).speeds == answer.speeds


def test_the_firmwares_stop_ends_the_turns(native: Built, tmp_path: Path) -> None:
    rig = bench(native, tmp_path, watchdogs={"heed_stop": True})
    assert turning(rig.run(PAUSE + 5)) == [1]
    assert turning(rig.call(calls=Calls.CONTROL | Calls.STOPS_MOTORS)) == []
    assert all(turning(rig.call()) == [] for _ in range(4 * (PAUSE + TURN)))
    assert rig.events == ["motors off: the firmware stopped them"]


def test_without_calls_the_turn_passes(native: Built, tmp_path: Path) -> None:
    """The firmware's own stop must hold the motors then; the library goes on where it should be by now."""
    rig = bench(native, tmp_path)
    assert turning(rig.run(PAUSE + 5)) == [1]
    assert turning(rig.call(gap_ns=(TURN + PAUSE) * PERIOD_NS)) == [2]


@pytest.mark.parametrize("mode", ["record", "bench"])
def test_no_port_is_opened(native: Built, tmp_path: Path, mode: str) -> None:
    import socket

    write(tmp_path, board(mode), cleared=False)
    rig = Rig(native, tmp_path)
    rig.run(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 24571))


def test_in_mode_record_no_motor_turns(native: Built, tmp_path: Path) -> None:
    write(tmp_path, board("record"), cleared=False)
    rig = Rig(native, tmp_path)
    answers = [rig.call() for _ in range(4 * (PAUSE + TURN))]
    assert all(turning(one) == [] and one.word == STOP for one in answers)
