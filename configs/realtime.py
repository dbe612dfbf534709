"""How the onboard loop keeps its pace."""

from pydantic import Field

from configs.loader import ConfigRecord


class RealtimeConfig(ConfigRecord):
    """The 200 Hz loop's claim on the machine. None of it changes what the loop computes."""

    priority: int = Field(ge=0, le=90, description="SCHED_FIFO priority that is asked for; 0 asks for none")
    spin_us: int = Field(ge=0, le=2000, description="us of busy waiting before each deadline; 0 sleeps all the way")
    escapes_max: int = Field(ge=1, le=1000, description="exceptions that may escape a step before the flight is ended")
    landing_limit_s: float = Field(gt=0, le=60, description="s that a landing on request may take")
