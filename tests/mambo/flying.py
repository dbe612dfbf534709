"""A vehicle that flies through the library in lockstep, whose firmware does something wrong at a given time."""

from collections.abc import Callable
from typing import Any

import pytest

from experiments.flights.lockstep_flight import LockstepOutcome, fly_lockstep
from experiments.flights.scenario import Choices, resolve
from mambo.fake import firmware_core
from mambo.fake.firmware_process import FirmwareProcess
from mambo.fake.wire import Answer, Calls
from onboard.flight.modes import FlightMode

Change = Callable[[int, bytes], list[bytes]]
"""From the time, ns, and a request to the requests that the firmware makes of it; none: it does not call."""


def fly_with(
    monkeypatch: pytest.MonkeyPatch, change: Change, duration_s: float = 10.0, *assignments: str, **board: Any
) -> tuple[LockstepOutcome, list[Answer]]:
    """Fly a hover with every request changed. Returns the outcome, and the library's answers."""
    answers: list[Answer] = []

    class Changed(FirmwareProcess):
        """The stand-in behind a firmware that does something wrong."""

        def call(self, request: bytes) -> Answer:
            now_ns = int.from_bytes(request[:8], "little")
            for one in change(now_ns, request):
                answers.append(super().call(one))
            return answers[-1]

    monkeypatch.setattr(firmware_core, "FirmwareProcess", Changed)
    if board:
        given = firmware_core.board_config
        monkeypatch.setattr(firmware_core, "board_config", lambda values: given(values={**values, **board}))
    choices = Choices("pid", duration_s=duration_s, assignments=assignments)
    outcome = fly_lockstep(resolve("hover", choices), with_offboard=False, core="mambo-native")
    return outcome, answers


def texts(outcome: LockstepOutcome) -> str:
    """All events of the library in one text."""
    return "\n".join(text for _, process, text in outcome.events if process == "onboard")


def modes(outcome: LockstepOutcome) -> list[str]:
    """The flight modes of a flight, in order."""
    seen: list[str] = []
    for number in outcome.trace.mode:
        name = FlightMode(int(number)).name
        if not seen or seen[-1] != name:
            seen.append(name)
    return seen


def with_calls(request: bytes, calls: Calls) -> bytes:
    """The request with these flags, too."""
    flags = int.from_bytes(request[24:28], "little") | int(calls)
    return request[:24] + flags.to_bytes(4, "little") + request[28:]


def with_time(request: bytes, now_ns: int) -> bytes:
    """The request at another time."""
    return now_ns.to_bytes(8, "little") + request[8:]


def with_duration(request: bytes, spent_ns: int) -> bytes:
    """The request of a call that takes so long."""
    return request[:16] + spent_ns.to_bytes(8, "little") + request[24:]
