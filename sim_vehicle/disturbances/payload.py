from pydantic import Field

from protocol.conventions import Array
from protocol.geometry import Vector3
from sim_vehicle.world.interface import Condition, Disturbance


class Payload(Disturbance):
    """A point mass fixed to the frame. It has the vehicle's velocity when it comes and when it goes."""

    mass_kg: float = Field(gt=0.0, le=0.1, description="kg")
    offset_m: Vector3 = Field(default=(0.0, 0.0, 0.02), description="m, body FRD, from the centre")

    def change(self, condition: Condition, drawn: Array) -> None:
        """Add the mass."""
        condition.payloads.append((self.mass_kg, self.offset_m))
