"""What a peer's rubbish is called: counted by reason and dropped, it never leaves the endpoint as an exception."""


class ProtocolError(Exception):
    """Bytes that do not stand for a valid message or feature set.

    `reason` is a short word to count by; the text says more and is for people.
    """

    def __init__(self, reason: str, text: str = "") -> None:
        super().__init__(f"{reason}: {text}" if text else reason)
        self.reason = reason
