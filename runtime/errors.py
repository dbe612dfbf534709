"""Errors whose message, one line, is shown to the user."""


class PlainError(Exception):
    """An error for the user: the command line prints its message and exits with status 2."""


class StartError(PlainError):
    """A process or flight cannot be started. The message states the reason and, where possible, the remedy."""
