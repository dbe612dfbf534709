"""How the onboard loop keeps its pace."""

from pydantic import Field

from configs.loader import ConfigRecord


class RealtimeConfig(ConfigRecord):
    """What the 200 Hz loop requests of the machine. None of it changes what the loop computes."""

    priority: int = Field(default=40, ge=0, le=90, description="SCHED_FIFO priority to request; 0: none")
    spin_us: int = Field(default=0, ge=0, le=2000, description="us of busy waiting before each deadline; 0: sleep")
    escapes_max: int = Field(default=20, ge=1, le=1000, description="exceptions of a step after which the flight ends")
