"""Supervisor and table of modes: the C core against numpy's, events and their texts included."""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from onboard.c.event_text import refusal_text, supervisor_text
from onboard.c.library import Core
from onboard.flight.modes import TRANSITIONS, Command, Event, FlightMode
from onboard.flight.supervisor import Supervisor, SupervisorConfig, SupervisorInputs
from tests.onboard.c.parity import SETTINGS, configured

PREFLIGHT = {0: "", 1: "pose at 12 Hz", 2: "no optical flow"}
CALIBRATION = {0: "", 1: "calibrating the IMU"}
GOOD: dict[str, Any] = {
    "imu_age_s": 0.005,
    "pose_age_s": 0.02,
    "velocity_aid_age_s": 0.02,
    "offboard_age_s": 0.1,
    "ground_age_s": 0.1,
    "battery_age_s": 0.1,
    "battery_v": 4.0,
    "battery_remaining": 0.8,
    "tilt_rad": 0.01,
    "height_m": 0.0,
    "climb_m_s": 0.0,
    "distance_m": 0.1,
    "position_sigma_m": 0.01,
    "thrust_to_weight": 1.0,
    "initialised": True,
    "preflight": 0,
    "calibration": 0,
    "fault": False,
    "gyro_stuck": False,
}
ODD = {
    "imu_age_s": [0.06],
    "pose_age_s": [0.6, 1e9],
    "velocity_aid_age_s": [0.6, 2.1],
    "offboard_age_s": [1.5],
    "ground_age_s": [3.0],
    "battery_age_s": [3.0],
    "battery_v": [0.0, 3.1, 3.4, 5.0, 11.1],
    "battery_remaining": [-1.0, 0.05],
    "tilt_rad": [0.4, 1.5, float("nan")],
    "height_m": [0.05, 0.9, 1.2, 6.0, -0.3],
    "climb_m_s": [0.5, -0.5],
    "distance_m": [12.0],
    "position_sigma_m": [0.6],
    "thrust_to_weight": [0.3],
    "initialised": [False],
    "preflight": [1, 2],
    "calibration": [1],
    "fault": [True],
    "gyro_stuck": [True],
}
CHANGE = st.sampled_from([(name, value) for name, values in ODD.items() for value in values])
CONFIGS = [
    SupervisorConfig(),
    SupervisorConfig(auto_arm=True, ground_silent_s=2.0, battery_silent_s=2.0, on_pose_stale="continue"),
    SupervisorConfig(arm_needs_pose=False, touch_down_for_s=0.0, healthy_for_s=0.0, back_for_s=0.0),
]
STEP_NS = 100_000_000


class Both:
    """The two supervisors, side by side."""

    def __init__(self, core: Core, config: SupervisorConfig) -> None:
        self.core, self.theirs, self.ours = core, Supervisor(config), core.Supervisor()
        core.supervisor_init(self.ours, configured(core, config))
        self.now_ns = 0

    def command(self, command: Command) -> None:
        refusal = self.core.ArmingRefusal()
        self.core.supervisor_command(self.ours, list(Command).index(command), self.now_ns, refusal)
        assert refusal_text(refusal, PREFLIGHT, CALIBRATION) == self.theirs.command(command, self.now_ns)
        self.same_events()

    def step(self, values: dict[str, Any]) -> FlightMode:
        self.now_ns += STEP_NS
        inputs = self.core.SupervisorInputs(now_ns=self.now_ns, **values)
        texts = {"preflight": PREFLIGHT[values["preflight"]], "calibration": CALIBRATION[values["calibration"]]}
        mode = self.theirs.step(SupervisorInputs(now_ns=self.now_ns, **{**values, **texts}))
        assert self.core.supervisor_step(self.ours, inputs) == mode
        self.same_events()
        return mode

    def same_events(self) -> None:
        events = (self.core.SupervisorEvent * 16)()
        count = self.core.supervisor_take_events(self.ours, events[0])
        ours = [(one.time_ns, supervisor_text(one, PREFLIGHT, CALIBRATION)) for one in events[:count]]
        assert ours == self.theirs.take_events()


STEPS = st.lists(
    st.tuples(st.lists(CHANGE, max_size=2), st.integers(1, 25), st.one_of(st.none(), st.sampled_from(list(Command)))),
    min_size=1,
    max_size=12,
)


@SETTINGS
@given(config=st.sampled_from(CONFIGS), steps=STEPS)
def test_any_inputs(core: Core, config: SupervisorConfig, steps: list[Any]) -> None:
    both = Both(core, config)
    for changes, count, command in steps:
        if command is not None:
            both.command(command)
        for _ in range(count):
            both.step(GOOD | dict(changes))


@pytest.mark.parametrize("config", CONFIGS)
@SETTINGS
@given(steps=STEPS)
def test_any_inputs_in_flight(core: Core, config: SupervisorConfig, steps: list[Any]) -> None:
    """Random inputs seldom take off: these begin in the air."""
    both = Both(core, config)
    for _ in range(8):
        both.step(GOOD)
    both.command(Command.ARM)
    both.step(GOOD)
    both.command(Command.TAKE_OFF)
    both.step(GOOD)
    flying = GOOD | {"height_m": 1.0}
    assert both.step(flying) is FlightMode.FLYING
    for changes, count, command in steps:
        if command is not None:
            both.command(command)
        for _ in range(count):
            both.step(flying | dict(changes))


def test_a_landing_that_gets_lower_goes_on_and_one_that_does_not_ends(core: Core) -> None:
    both = Both(core, SupervisorConfig(landing_max_s=2.0, level_max_s=2.0, touch_down_height_m=0.01))
    for _ in range(8):
        both.step(GOOD)
    both.command(Command.ARM)
    both.step(GOOD)
    both.command(Command.TAKE_OFF)
    both.step(GOOD)
    both.step(GOOD | {"height_m": 4.0})
    both.command(Command.LAND)
    for tick in range(60):
        both.step(GOOD | {"height_m": 4.0 - 0.05 * tick, "climb_m_s": -0.5})
    assert both.theirs.mode is FlightMode.LANDING
    modes = {both.step(GOOD | {"height_m": 1.0, "climb_m_s": -0.5}) for _ in range(60)}
    assert FlightMode.HOLD_LEVEL in modes


def test_more_commands_than_the_queue_holds(core: Core) -> None:
    both = Both(core, SupervisorConfig())
    for _ in range(8):
        both.step(GOOD)
    for _ in range(9):
        both.command(Command.ARM)
    for _ in range(12):
        both.step(GOOD)


def test_the_table(core: Core) -> None:
    for mode, row in TRANSITIONS.items():
        for index, (event, target) in enumerate(row):
            entry = core.Transition()
            assert core.transition(mode, index, entry)
            assert (entry.event, entry.target) == (list(Event).index(event), target)
        assert not core.transition(mode, len(row), core.Transition())


def test_events_that_nobody_takes_are_counted(core: Core) -> None:
    ours, refusal = core.Supervisor(), core.ArmingRefusal()
    core.supervisor_init(ours, configured(core, SupervisorConfig()))
    for _ in range(20):
        core.supervisor_command(ours, core.COMMAND_LAND, 0, refusal)
    assert (ours.event_count, ours.events_lost) == (16, 4)
