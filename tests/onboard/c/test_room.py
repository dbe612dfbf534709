"""The room for nu_ad: the C core against numpy's."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from onboard.c.library import Core
from onboard.control.room import Room, RoomConfig
from tests.onboard.c.parity import SETTINGS, array, configured, filled, numbers, real, same, vectors
from tests.onboard.control.fixture import AIRFRAME

PAIRS = st.tuples(st.floats(0.01, 2.0), st.floats(0.01, 2.0))


@SETTINGS
@given(
    limits=st.fixed_dictionaries({"share": PAIRS, "least": PAIRS}),
    tilt=st.floats(0.1, 1.2),
    scale=st.floats(0.3, 1.3),
    thrust=numbers(3.0, 0.0),
    needs=st.tuples(vectors(3, 12.0), vectors(3, 500.0)),
)
def test_room(core: Core, limits: Any, tilt: float, scale: float, thrust: float, needs: Any) -> None:
    config = RoomConfig(**limits)
    ours, theirs = core.Room(), Room(config, AIRFRAME, tilt)
    core.room_init(ours, configured(core, config), filled(core.AirframeConfig, AIRFRAME), tilt)
    position, attitude = array(core, [0.0] * 3), array(core, [0.0] * 3)
    core.room_position(ours, scale, array(core, needs[0]), position)
    core.room_attitude(ours, scale, thrust, array(core, needs[1]), attitude)
    for own, other in zip(position, theirs.position(scale, (*needs[0],)), strict=True):
        same(own, other)
    for own, other in zip(attitude, theirs.attitude(scale, thrust, (*needs[1],)), strict=True):
        same(own, other)


def test_without_thrust_to_spare_nothing_is_left_downwards(core: Core, core32: Core) -> None:
    """Motors that are too weak to hover: the reach is zero, not negative."""
    for one in (core, core32):
        ours, room = one.Room(), array(one, [9.0] * 3)
        one.room_init(ours, configured(one, RoomConfig()), filled(one.AirframeConfig, AIRFRAME), 0.5)
        one.room_position(ours, 0.1, array(one, [1.0, 2.0, 3.0]), room)
        assert room.dtype == real(one)
        assert room[2] == 0.0
        assert room[0] > room[1] > 0.0
