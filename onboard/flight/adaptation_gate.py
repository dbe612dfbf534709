"""When the laws may adapt: what is measured near the ground, or without an aid of velocity, teaches wrong things."""

from typing import Final

from onboard.estimation.state import VehicleState
from onboard.flight.modes import AIRBORNE, FlightMode

ADAPT_HEIGHT_M: Final = 0.2
"""No adaptation below this height: ground effect and contact are not disturbances to learn."""
ADAPT_CLIMB_M: Final = 0.05
"""A take-off adapts from this height above where the vehicle stood. It has no contact any more and soon leaves the
ground effect; the torque of a wind or of unequal rotors would turn it by up to 28 degrees meanwhile."""
VELOCITY_AID_MAX_S: Final = 0.3
"""No adaptation when velocity has had no aid for longer than this."""
TAKE_OFF: Final = FlightMode.TAKE_OFF


class AdaptationGate:
    """Tells in each tick whether the laws may adapt."""

    def __init__(self) -> None:
        self._stood_at_d = 0.0

    def take_off(self, state: VehicleState) -> None:
        """A take-off begins where the vehicle is."""
        self._stood_at_d = float(state.position[2])

    def allows(self, state: VehicleState, mode: FlightMode, now_ns: int) -> bool:
        """Whether what is measured now may be learnt from."""
        aided = (now_ns - state.last_velocity_aid_ns) * 1e-9 < VELOCITY_AID_MAX_S
        down = float(state.position[2])
        clear = self._stood_at_d - down > ADAPT_CLIMB_M if mode is TAKE_OFF else -down > ADAPT_HEIGHT_M
        return mode in AIRBORNE and clear and aided
