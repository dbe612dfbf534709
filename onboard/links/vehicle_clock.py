"""Maps the vehicle's clock to onboard's, and detects a vehicle whose clock restarted or jumped."""

from typing import Final

from protocol.clock_map import ClockMap
from protocol.conventions import NEVER_NS

SUSPECTS: Final = 3
"""This many wrong stamps in a row mean that the vehicle's clock restarted or jumped."""
SHORT_STEP_SUSPECTS: Final = 5
"""The same for a short step back, which a late datagram makes too."""
AGREE_NS: Final = 4_000_000
"""The delays of the stamps after a short step back differ by no more than this: others were held up on the way."""


class VehicleClock:
    """Accepts the IMU's time stamps. A stamp that is ahead of its cause, or goes back, is a suspect and is refused."""

    def __init__(self, restart_ns: int) -> None:
        """`restart_ns`: a step back of more may be a restart; a smaller one is a late datagram or a jump."""
        self._restart_ns = restart_ns
        self._map = ClockMap()
        self.to_onboard: Final = self._map.to_ours
        """Onboard time of a vehicle time stamp with its arrival: never after that."""
        self._suspects: list[int] = []  # their delays
        self._suspect_ns = NEVER_NS
        self._far = False
        self.newest_ns = NEVER_NS
        """The newest accepted stamp, vehicle's clock."""
        self.restarts = 0
        """How often the vehicle's clock restarted."""
        self.interleaved = 0
        """How often stamps of a time far away came between good ones."""

    @property
    def known(self) -> bool:
        """Whether there is a mapping."""
        return self._map.known

    def accept(self, stamp_ns: int, arrival_ns: int) -> str:
        """Check an IMU time stamp. Returns "" (good), "restart" or "jump" (good, on a new clock), or why it is refused.

        A short step back is a jump only if the delays agree: those of datagrams that were held up differ.
        """
        step_ns, delay_ns = stamp_ns - self.newest_ns, arrival_ns - stamp_ns
        if step_ns == 0:
            return "time_repeated"
        ahead = self._map.is_ahead(delay_ns)
        if step_ns > 0 and not ahead:
            self.interleaved += bool(self._suspects) and self._far
            self._suspects.clear()
            self.newest_ns = stamp_ns
            self._map.add(delay_ns, arrival_ns)
            return ""
        restart = step_ns <= -self._restart_ns
        if not self._is_confirmed(stamp_ns, delay_ns, short_step_back=not restart and step_ns < 0):
            self._far = abs(delay_ns - self._map.offset_ns) >= self._restart_ns
            return "time_ahead" if step_ns > 0 else "time_backwards"
        self.reset()
        self.restarts += restart
        self.accept(stamp_ns, arrival_ns)
        return "restart" if restart else "jump"

    def _is_confirmed(self, stamp_ns: int, delay_ns: int, short_step_back: bool) -> bool:
        """Add a suspect; whether enough of them in a row are on one clock."""
        if stamp_ns <= self._suspect_ns:
            self._suspects.clear()
        self._suspect_ns = stamp_ns
        self._suspects = [*self._suspects[1 - SHORT_STEP_SUSPECTS :], delay_ns]
        if not short_step_back:
            return len(self._suspects) >= SUSPECTS
        agree = max(self._suspects) - min(self._suspects) <= AGREE_NS
        return agree and len(self._suspects) == SHORT_STEP_SUSPECTS

    def reset(self) -> None:
        """Forget the mapping; the next stamp starts a new one."""
        self.newest_ns = self._suspect_ns = NEVER_NS
        self._suspects.clear()
        self._map.reset()
