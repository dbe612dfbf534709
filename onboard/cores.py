"""The two onboard cores by name: `onboard.core.OnboardCore` with numpy, `onboard.c.compiled_core.CompiledCore` in C.

A lockstep flight and a replay use either by the interface `AnyCore`; the process uses numpy's.
"""

from typing import Any, Final, Protocol

from onboard.config import OnboardConfig
from onboard.core import OnboardCore, OnboardOutput
from onboard.preflight.certificate import CLEAR, Clearance
from protocol.arrival import Datagrams
from protocol.keys import LinkKeys

NUMPY: Final = "numpy"
CORES: Final = (NUMPY, "c")
PRECISIONS: Final = ("double", "float")
"""Of the numbers of the C core: 64 or 32 bits. numpy's are double."""


class AnyCore(Protocol):
    """Bytes and time in, bytes out."""

    controller: Any
    """For what a flight starts from and has learnt (experiments.flights.carried_experience)."""

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


def build_core(
    name: str,
    config: OnboardConfig,
    session: int,
    keys: LinkKeys,
    clearance: Clearance = CLEAR,
    precision: str = "double",
) -> AnyCore:
    """A core by its name, one of CORES; the other parameters as of OnboardCore.

    precision: of the C core, one of PRECISIONS.

    Raises
    ------
    ConfigError
        If the C core cannot be built here, or does not have the configured controller.
    """
    given = config, session, keys.offboard, keys.vehicle, keys.ground, clearance
    if name == "c":
        from onboard.c.compile import Variant
        from onboard.c.compiled_core import CompiledCore  # nothing else needs it, or its compiler

        return CompiledCore(*given, variant=Variant(precision))
    return OnboardCore(*given)


def check_core(name: str, config: OnboardConfig) -> None:
    """Build a core once and drop it, before many flights use it. Raises ConfigError as `build_core` does."""
    build_core(name, config, session=1, keys=LinkKeys(None, None, None))


def core_option(name: str) -> list[str]:
    """The words that choose this core on the command line; none for the default."""
    return [] if name == NUMPY else ["--core", name]
