"""The error of invalid bytes from the peer. The endpoint counts it by reason; it never leaves the endpoint."""


class ProtocolError(Exception):
    """Bytes that are not a valid message or feature set.

    `reason` is the short word under which the error is counted; the text explains it to a person.
    """

    def __init__(self, reason: str, text: str = "") -> None:
        super().__init__(f"{reason}: {text}" if text else reason)
        self.reason = reason
