from pydantic import Field

from protocol.conventions import Array
from sim_vehicle.world.interface import Condition, Disturbance


class ClockJump(Disturbance):
    """The vehicle's clock (not that of motion capture) jumps. Minus the onset: it counts from 0, as after a restart."""

    jump_s: float = Field(ge=-3600.0, le=3600.0, description="s; the clock never shows less than 0")

    def change(self, condition: Condition, drawn: Array) -> None:
        """Shift the clock."""
        condition.clock_jump_ns += round(1e9 * self.jump_s)
