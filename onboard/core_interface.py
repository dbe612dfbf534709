"""The interface of an onboard core: what the process, a lockstep flight and a replay need of it.

There are two: `onboard.core.OnboardCore`, with numpy, and `onboard.c.compiled_core.CompiledCore`, in C.
"""

from typing import Any, Protocol

from onboard.core import OnboardOutput
from protocol.arrival import Datagrams


class AnyCore(Protocol):
    """Bytes and time in, bytes out."""

    @property
    def controller(self) -> Any:
        """The controller, for what a flight starts from and has learnt (experiments.flights.carried_experience)."""

    @property
    def airborne(self) -> bool:
        """Whether the flight mode is one of those in the air."""

    def tick(
        self,
        now_ns: int,
        from_vehicle: Datagrams = (),
        from_offboard: Datagrams = (),
        from_ground: Datagrams = (),
        land: bool = False,
        missed_ticks: int = 0,
    ) -> OnboardOutput:
        """One tick (`onboard.core.OnboardCore.tick`)."""

    def safe_output(self, now_ns: int) -> OnboardOutput:
        """Motors off and nothing else."""

    def status(self, now_ns: int) -> dict[str, Any]:
        """A few numbers for the live status line."""

    def summary(self) -> dict[str, Any]:
        """Mode, features and counters, for the flight record."""
