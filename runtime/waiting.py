"""Shows that a long step is at work: a spinner in a terminal, elsewhere one line if the step takes longer than 2 s."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console

LONG_S: Final = 2.0
"""A shorter step prints nothing where there is no terminal."""


@contextmanager
def waiting(text: str, console: Console | None = None, long_s: float = LONG_S) -> Iterator[None]:
    """Show `text` while the block runs.

    Parameters
    ----------
    text: what the program does, such as "writing the report".
    console: None: standard error, so that a program can read the result on standard output.
    long_s: s after which an output that is no terminal gets the line.
    """
    console = console or Console(stderr=True)
    if console.is_terminal:
        with console.status(text):
            yield
        return
    timer = threading.Timer(long_s, lambda: console.print(f"{text} ...", markup=False, highlight=False, soft_wrap=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
