"""Trouble that one line explains to the person at the terminal."""


class PlainError(Exception):
    """The command line prints its message and ends with status 2."""


class StartError(PlainError):
    """A process or flight that cannot be started. The message says why and, where possible, what to do."""
