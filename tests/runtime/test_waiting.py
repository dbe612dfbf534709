"""What a long step prints."""

import io
import time

from rich.console import Console

from runtime.waiting import waiting

PATIENCE_S = 20.0


def test_a_long_step_prints_one_line_where_there_is_no_terminal() -> None:
    out = io.StringIO()
    with waiting("learning [all]", Console(file=out), long_s=0.0):
        deadline = time.monotonic() + PATIENCE_S
        while not out.getvalue() and time.monotonic() < deadline:
            time.sleep(0.001)
    assert out.getvalue() == "learning [all] ...\n"


def test_a_short_step_prints_nothing_there() -> None:
    out = io.StringIO()
    with waiting("reading", Console(file=out)):
        pass
    assert out.getvalue() == ""


def test_a_terminal_gets_a_spinner() -> None:
    out = io.StringIO()
    with waiting("reading", Console(file=out, force_terminal=True)):
        pass
    assert "reading" in out.getvalue()
