"""What happens in a soak: drawn from a seed, the same for the same seed and length.

Nothing here may cost the vehicle. So the process of the vehicle itself is left alone, because no vehicle stands still
in the air, and onboard is not killed in the air, where nothing could replace it: it is killed once on the ground. In
the air onboard is stopped for up to 50 ms, half of what the motors wait for a command. The trainer is killed and
restarted in the first part only, so that its last life is long enough for the slope of its memory.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

BEGIN_S: Final = 12.0
"""Flight time of the first disruption: the vehicle flies its path by then."""
END_BEFORE_S: Final = 12.0
"""No disruption so long before the end."""
PAUSE_MIN_S: Final = 2.0
PAUSE_MEAN_S: Final = 5.0
LIVES_SHARE: Final = 0.4
"""Share of the flight in which the trainer is killed and restarted."""
FLOOD_RATES_HZ: Final = (1_000, 5_000, 20_000)
BLACKOUT_EVERY_S: Final = 40.0


class Action(StrEnum):
    """What is done to a process."""

    STOP = "stop"
    """SIGSTOP, and SIGCONT after `seconds`."""
    KILL = "kill"
    """SIGKILL; started again after `seconds`."""
    RESTART = "restart"
    """SIGTERM; started again after `seconds`."""
    FLOOD = "flood"
    """Datagrams with the address of the port's peer, for `seconds`."""


@dataclass(frozen=True, slots=True)
class Disruption:
    """One thing that happens."""

    at_s: float
    """Flight time."""
    action: Action
    target: str
    """A process, or the port that is flooded, of experiments.link.flood.PORTS."""
    seconds: float
    rate_hz: int = 0

    def __str__(self) -> str:
        """Return what is done, without its time."""
        if self.action is Action.FLOOD:
            return f"flood {self.target}, {self.rate_hz} a second for {self.seconds:.1f} s"
        if self.action is Action.STOP:
            return f"stop {self.target} for {self.seconds * 1e3:.0f} ms"
        return f"{self.action} {self.target}, again after {self.seconds:.1f} s"


CHOICES: Final[tuple[tuple[float, Action, str, tuple[float, float]], ...]] = (
    (4.0, Action.STOP, "onboard", (0.005, 0.05)),
    (2.0, Action.STOP, "offboard", (0.1, 3.0)),
    (2.0, Action.STOP, "capture", (0.1, 2.0)),
    (1.0, Action.STOP, "ground", (0.1, 5.0)),
    (1.0, Action.KILL, "offboard", (0.2, 2.0)),
    (1.0, Action.RESTART, "offboard", (0.2, 2.0)),
    (1.0, Action.KILL, "capture", (0.2, 3.0)),
    (0.5, Action.RESTART, "capture", (0.2, 3.0)),
    (0.5, Action.KILL, "ground", (0.2, 5.0)),
    (0.5, Action.RESTART, "ground", (0.2, 5.0)),
    (0.6, Action.FLOOD, "vehicle", (1.0, 4.0)),
    (0.6, Action.FLOOD, "offboard", (1.0, 4.0)),
    (0.6, Action.FLOOD, "ground", (1.0, 4.0)),
    (0.6, Action.FLOOD, "onboard", (1.0, 4.0)),
    (0.6, Action.FLOOD, "motion capture", (1.0, 4.0)),
)
"""Weight, what, to whom, and the range of `seconds`."""


def draw(seed: int, duration_s: float, floods: bool) -> list[Disruption]:
    """Draw the disruptions of a flight, in order of time.

    floods: whether ports may be flooded: the sender needs root.
    """
    rng = np.random.default_rng([seed, 1])
    found: list[Disruption] = []
    at_s = BEGIN_S
    while at_s < duration_s - END_BEFORE_S:
        early = at_s < LIVES_SHARE * duration_s
        allowed = [one for one in CHOICES if _allowed(one[1], one[2], early, floods)]
        weights = np.array([one[0] for one in allowed])
        _, action, target, (least, most) = allowed[int(rng.choice(len(allowed), p=weights / weights.sum()))]
        seconds = float(rng.uniform(least, most))
        rate_hz = int(rng.choice(FLOOD_RATES_HZ)) if action is Action.FLOOD else 0
        found.append(Disruption(at_s, action, target, seconds, rate_hz))
        at_s += PAUSE_MIN_S + float(rng.exponential(PAUSE_MEAN_S - PAUSE_MIN_S))
    return found


def _allowed(action: Action, target: str, early: bool, floods: bool) -> bool:
    if action is Action.FLOOD:
        return floods
    return early or target != "offboard" or action is Action.STOP


def blackouts(seed: int, duration_s: float) -> list[str]:
    """Draw windows in which the radio carries nothing, each direction its own; return them as assignments."""
    rng = np.random.default_rng([seed, 2])
    assignments = []
    for direction in ("up", "down"):
        windows, at_s = [], BEGIN_S
        while (at_s := at_s + float(rng.exponential(BLACKOUT_EVERY_S))) < duration_s - END_BEFORE_S:
            end_s = at_s + float(rng.uniform(0.2, 8.0))
            windows.append(f"{{start_s: {at_s:.2f}, end_s: {end_s:.2f}}}")
            at_s = end_s
        assignments.append(f"radio.{direction}.blackouts=[{', '.join(windows)}]")
    return assignments
