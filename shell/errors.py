"""What keeps a process from starting."""


class StartError(Exception):
    """A process or flight that cannot be started. The message says why and, where possible, what to do."""
