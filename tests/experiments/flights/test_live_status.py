"""The live status, in a terminal and elsewhere."""

import io

from rich.console import Console

from experiments.flights.live_status import SILENT_S, FlightStatus, LiveStatus

ONBOARD = {"process": "onboard", "kind": "status", "mode": "FLYING", "tracking_error_m": 0.0314, "missed_ticks": 2}
ONBOARD |= {"feature_version": 3, "feature_age_s": 1.26}
OFFBOARD = {"process": "offboard", "kind": "status", "rounds": 7}
OFFBOARD |= {"validation_loss_position": 0.12345, "validation_loss_attitude": None}
LINK = {"up": {"sent": 200, "lost": 10}, "down": {"sent": 0, "lost": 0}}
SIM = {"process": "sim", "kind": "status", "time_s": 12.34, "link": LINK}
EVENT = {"process": "onboard", "kind": "event", "text": "features 3 in use [bold]"}


def test_the_important_values_are_shown() -> None:
    status = FlightStatus()
    for entry in (ONBOARD, OFFBOARD, SIM):
        status.receive(entry)
    assert dict(status.rows()) == {
        "time": "12.3 s",
        "mode": "FLYING",
        "tracking error": "0.031 m",
        "features": "version 3, 1.3 s old",
        "link loss": "up 5.0 %, down -",
        "missed ticks": "2",
        "held-out loss": "0.123 (m/s^2)^2, - (rad/s^2)^2, round 7",
    }


def test_values_of_a_silent_process_are_not_shown() -> None:
    now = [100.0]
    status = FlightStatus(lambda: now[0])
    status.receive(OFFBOARD)
    now[0] += SILENT_S
    assert dict(status.rows())["held-out loss"] == "-"


def test_a_terminal_gets_one_table_that_is_redrawn() -> None:
    out = io.StringIO()
    with LiveStatus(Console(file=out, force_terminal=True, width=100)) as live:
        for entry in (ONBOARD, OFFBOARD, SIM, EVENT):
            live(entry)
    text = out.getvalue()
    assert "FLYING" in text
    assert "features 3 in use [bold]" in text


def test_other_outputs_get_a_line_every_two_seconds_and_every_event() -> None:
    out = io.StringIO()
    with LiveStatus(Console(file=out, width=80)) as live:
        for _ in range(10):
            for entry in (ONBOARD, OFFBOARD, SIM):
                live(entry)
        live(EVENT)
    lines = out.getvalue().splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("time 12.3 s  mode FLYING  tracking error 0.031 m")
    assert lines[1] == "onboard: features 3 in use [bold]"
