"""Restarts and clocks that jump, of both sides of the link, in lockstep flights with the real cores."""

from typing import Any

import pytest

from experiments.flights.lockstep_flight import build_offboard
from experiments.flights.scenario import Choices, resolve
from onboard.core import OnboardCore
from onboard.flight.modes import Command, FlightMode
from onboard.record.tick import OFFSET
from protocol.endpoint import Endpoint
from protocol.messages import TimeSyncReply, TimeSyncRequest
from protocol.session import session_number
from tests.experiments.link.link_flight import KEY, MS, UP_FOR_NS, Flight, S, Shifted, Side, Wire


def test_a_flight_survives_a_trainer_that_is_killed_and_restarted_repeatedly() -> None:
    flight = Flight().fly(4.0)
    checkpoint = None
    for life in range(3):
        checkpoint = flight.offboard.final_checkpoint() or checkpoint
        flight.lockstep.remove_offboard()
        flight.fly(0.3)
        flight.offboard = build_offboard(flight.config, 10 + life)
        if checkpoint is not None and life % 2:
            flight.offboard.resume(checkpoint)
        flight.lockstep.attach_offboard(flight.offboard)
        flight.fly(0.7)
    assert checkpoint is not None, "it is meant to have trained"
    assert len(flight.reported("offboard restarted")) == 3
    assert flight.mode is FlightMode.FLYING
    assert max(flight.errors_m[-200:]) < 0.3
    assert flight.last("pose_age") < 0.1
    assert flight.offboard.learner.samples >= 5, "the last one is received and trained for as well"


def test_both_sides_reconnect_after_restarts_with_the_wall_clock_set_back() -> None:
    config = Flight("pid", assignments=()).config
    today, yesterday = (session_number(day * 86_400 * S, 5) for day in (20_000, 19_999))
    offboard = Side(config, today)
    first = Wire(OnboardCore(config.onboard, today, KEY), offboard)
    first.run(0, 1.0)
    assert offboard.core.endpoint.peer_session == today
    recording = list(first.sent_up)
    second = Wire(OnboardCore(config.onboard, yesterday, KEY), offboard)
    second.run(1 * S, 0.9)
    assert offboard.core.endpoint.peer_session == today, "the silence is still too short"
    second.run(round(1.9 * S), 1.0)
    assert offboard.core.endpoint.peer_session == yesterday
    received = offboard.core.endpoint.statistics.received
    for datagram in recording:  # and the old session stays closed
        offboard.core.receive_onboard(datagram, UP_FOR_NS + 60 * S)
    assert offboard.core.endpoint.statistics.received == received
    assert offboard.core.endpoint.peer_session == yesterday


@pytest.mark.parametrize("jump_s", [0.3, -3600, pytest.param(3600, marks=pytest.mark.full)])
def test_offboards_clock_jumps(jump_s: float) -> None:
    flight = Flight("mrac")
    flight.lockstep.attach_offboard(Shifted(flight.offboard, UP_FOR_NS * 2, (4 * S, round(jump_s * S))))
    flight.fly(4.0)
    flight.errors_m.clear()
    flight.fly(3.0)
    assert flight.mode is FlightMode.FLYING
    assert max(flight.errors_m) < 0.3
    assert flight.last("pose_age") < 0.1, "poses are used again"


def test_onboards_clock_is_set_back() -> None:
    flight = Flight("mrac")
    shifted: Any = Shifted(flight.onboard, UP_FOR_NS, (4 * S, -1000 * S))
    flight.lockstep._onboard = shifted
    flight.fly(4.0)
    flight.errors_m.clear()
    flight.fly(3.0)
    assert flight.mode is FlightMode.FLYING
    assert max(flight.errors_m) < 0.3
    assert 0.0 <= flight.last("pose_age") < 0.1


def test_time_requests_are_frequent_until_the_offset_is_known() -> None:
    """Over a link that loses nine of ten datagrams, a request per second would be answered after a hundred seconds."""
    config = resolve("hover", Choices("pid", 3)).onboard
    onboard, offboard = OnboardCore(config, 5, None), Endpoint("offboard", 7, None)
    asked: list[int] = []
    replies: list[bytes] = []
    for now_ns in range(0, 6 * S, 5 * MS):
        to_offboard = onboard.tick(now_ns, from_offboard=replies).to_offboard
        replies = []
        for datagram in to_offboard:
            message = offboard.decode(datagram, now_ns)
            if isinstance(message, TimeSyncRequest):
                asked.append(now_ns)
                if now_ns >= 2 * S:
                    reply = TimeSyncReply(message.origin_ns, now_ns, now_ns)
                    replies.append(offboard.encode(reply, now_ns))
    unanswered = [now_ns for now_ns in asked if now_ns < 2 * S]
    assert len(unanswered) == pytest.approx(2.0 / config.status_period_s, abs=2)
    assert len(asked) - len(unanswered) == pytest.approx(4.0 / config.time_sync_period_s, abs=2)


def test_an_onboard_that_restarts_in_the_air_leaves_the_motors_off() -> None:
    """It cannot distinguish a fall from a throw by hand; docs/link.md gives the reasons."""
    flight = Flight("mrac").fly(4.0)
    successor = flight.lockstep._onboard = OnboardCore(flight.config.onboard, 99, None)
    ticks, refusals = 0, set()
    while not flight.lockstep.crash_reason and ticks < 400:
        refusals.add(successor._supervisor.command(Command.ARM, flight.lockstep.now_ns))
        tick = flight.lockstep.step().onboard.tick
        assert tick[OFFSET["mode"]] == FlightMode.BOOT
        assert not tick[OFFSET["motor_1"] : OFFSET["motor_1"] + 4].any()
        ticks += 1
    assert 40 < ticks < 200, "it falls for as long as that"
    assert "" not in refusals, "nor may a person arm it"
