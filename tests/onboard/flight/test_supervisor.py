"""The supervisor: every mode with every event, stories of flights, and the effect of each limit."""

import math

import pytest

from onboard.flight.modes import AIRBORNE, SPINNING, TRANSITIONS, Command, Event, FlightMode
from onboard.flight.supervisor import Supervisor, SupervisorConfig, SupervisorInputs

M, E = FlightMode, Event
STEP_NS = 5_000_000
GOOD = SupervisorInputs(
    now_ns=0,
    imu_age_s=0.0,
    pose_age_s=0.02,
    velocity_aid_age_s=0.02,
    offboard_age_s=0.02,
    ground_age_s=0.1,
    battery_age_s=0.5,
    battery_v=3.9,
    battery_remaining=0.8,
    tilt_rad=0.05,
    height_m=0.5,
    climb_m_s=0.0,
    distance_m=0.3,
    position_sigma_m=0.01,
    thrust_to_weight=1.0,
    initialised=True,
)
"""Half a metre high, no fault."""

QUIET = {
    M.BOOT: {"initialised": False},
    M.HOLD: {"pose_age_s": 5.0},
    M.HOLD_LEVEL: {"velocity_aid_age_s": 5.0},
}
"""Inputs without an event in a mode, where they differ from GOOD."""

CAUSES = {
    E.IMU_SILENT_LANDED: {"imu_age_s": 0.06, "height_m": 0.1},
    E.IMU_SILENT: {"imu_age_s": 0.06},
    E.FAULT: {"fault": True},
    E.TILTED: {"tilt_rad": 1.5},
    E.VELOCITY_LOST: {"velocity_aid_age_s": 2.1},
    E.VELOCITY_BACK: {"velocity_aid_age_s": 0.05},
    E.POSITION_LOST: {"pose_age_s": 0.6},
    E.POSITION_BACK: {"pose_age_s": 0.05},
    E.GYRO_STUCK: {"gyro_stuck": True},
    E.BATTERY_LOW: {"battery_v": 3.1},
    E.BATTERY_SILENT: {"battery_age_s": 11.0},
    E.GROUND_SILENT: {"ground_age_s": 11.0},
    E.OUT_OF_BOUNDS: {"distance_m": 11.0},
    E.TOUCHED_DOWN: {"height_m": 0.02},
    E.AT_HEIGHT: {"height_m": 0.9, "climb_m_s": 0.4},
    E.HEALTHY: {"initialised": True},
    E.UNHEALTHY: {"preflight": "IMU at 90 Hz"},
}
COMMANDS = {
    E.TERMINATE: Command.TERMINATE,
    E.ARM: Command.ARM,
    E.DISARM: Command.DISARM,
    E.TAKE_OFF: Command.TAKE_OFF,
    E.LAND: Command.LAND,
}
ALL_LIMITS = {"ground_silent_s": 10.0, "battery_silent_s": 10.0, "level_max_s": 9.0}


class Pilot:
    """A supervisor with a clock and its inputs."""

    def __init__(self, mode=M.BOOT, **config):
        self.supervisor = Supervisor(SupervisorConfig(**config))
        self.supervisor.mode = mode
        self.now_ns = 10**12
        self.given = dict(QUIET.get(mode, {}))
        self.step()

    @property
    def mode(self):
        return self.supervisor.mode

    def step(self, seconds=0.0, **changes):
        """One step, or steps for `seconds`, with changed inputs that stay."""
        self.given.update(changes)
        for _ in range(max(1, round(seconds / 0.005))):
            self.now_ns += STEP_NS
            self.supervisor.step(GOOD._replace(now_ns=self.now_ns, **self.given))
        return self.mode

    def command(self, command):
        refusal = self.supervisor.command(command, self.now_ns)
        self.step()
        return refusal

    def fly(self):
        """From the ground to flight, as a pilot would."""
        self.step(0.6, initialised=True, height_m=0.0)
        assert self.command(Command.ARM) == ""
        assert self.command(Command.TAKE_OFF) == ""
        assert self.step(height_m=1.0) is M.FLYING
        return self

    def texts(self):
        return [text for _, text in self.supervisor.take_events()]


@pytest.mark.parametrize("mode", list(M), ids=lambda mode: mode.name)
@pytest.mark.parametrize("event", list(E), ids=lambda event: event.name)
def test_every_mode_against_every_event(mode, event):
    """An event in the row leads to the mode of the row; any other event changes nothing."""
    pilot = Pilot(mode, **ALL_LIMITS)
    assert pilot.mode is mode
    row = dict(TRANSITIONS[mode])
    if event in COMMANDS:
        refusal = pilot.command(COMMANDS[event])
        assert bool(refusal) == (event not in row)
    elif event is E.TIME_UP:
        pilot.step(21.0)
    else:
        pilot.step(**CAUSES[event])
        if mode not in (M.LANDED,):  # a second passes, and LANDED lasts no longer
            pilot.step(1.01)
    reached = [text.split()[2].rstrip(":") for text in pilot.texts() if "->" in text]
    if event is E.IMU_SILENT_LANDED and event not in row:
        event = E.IMU_SILENT  # which it is, too
    if (mode, event) == (M.READY, E.IMU_SILENT):
        event = E.UNHEALTHY  # which a silent IMU is, too
    if event in row:
        assert reached[0] == row[event].name
    else:
        assert reached == []


def test_each_mode_can_be_left_and_reached():
    reached = {M.BOOT} | {target for row in TRANSITIONS.values() for _, target in row}
    assert reached == set(M)
    assert all(TRANSITIONS[mode] for mode in M if mode is not M.TERMINATED)


def test_safety_rules_of_the_table():
    """The safety rules, independent of the table."""
    for mode, row in TRANSITIONS.items():
        targets = dict(row)
        if mode in SPINNING:
            for event in (E.IMU_SILENT, E.TILTED, E.FAULT):
                assert targets[event] is M.EMERGENCY
            assert targets[E.TERMINATE] is M.TERMINATED
            assert next(event for event, _ in row) is E.TERMINATE
        if mode in AIRBORNE:
            assert E.DISARM not in targets
            assert E.UNHEALTHY not in targets
            assert not set(targets.values()) & {M.BOOT, M.READY, M.ARMED}
        if mode not in SPINNING:
            starts = {event for event, target in row if target in SPINNING}
            assert starts <= {E.ARM}
        assert len(targets) == len(row)


# -- the story of a flight --------------------------------------------------------------------------------------------


def test_a_flight_from_boot_to_boot():
    pilot = Pilot().fly()
    pilot.command(Command.LAND)
    assert pilot.mode is M.LANDING
    assert pilot.step(height_m=0.02, climb_m_s=-0.3) is M.LANDING
    assert pilot.step(0.25, climb_m_s=0.0) is M.LANDING
    assert pilot.step(0.1) is M.LANDED
    assert pilot.mode not in SPINNING
    assert pilot.step(1.0) is M.BOOT
    assert pilot.step(0.6) is M.READY
    assert "FLYING -> LANDING: landing by command" in pilot.texts()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"initialised": False}, "attitude"),
        ({"imu_age_s": 0.2}, "IMU"),
        ({"pose_age_s": 0.7}, "pose"),
        ({"tilt_rad": 0.5}, "level"),
        ({"battery_v": 3.4}, "3.40 V"),
        ({"battery_remaining": 0.05}, "5%"),
        ({"preflight": "motors swapped"}, "motors swapped"),
        ({"calibration": "calibrating the IMU"}, "calibrating the IMU"),
        ({"battery_v": 0.0}, "battery"),
        ({"battery_v": 40.8}, "battery at 40.8 V: not one cell"),
        ({"distance_m": 11.2}, "11.2 m from the origin, the fence is at 10 m"),
        ({"battery_age_s": 20.0}, "too old"),
        ({"ground_age_s": 20.0}, "ground station"),
    ],
)
def test_arming_is_refused_with_a_reason(changes, reason):
    pilot = Pilot(M.READY, **ALL_LIMITS)
    supervisor = pilot.supervisor
    supervisor.step(GOOD._replace(now_ns=pilot.now_ns, **changes))
    supervisor.mode = M.READY
    assert reason in supervisor.command(Command.ARM, pilot.now_ns)
    assert any("refused to arm" in text for text in pilot.texts())


def test_a_lasting_reason_against_arming_is_reported_once():
    pilot = Pilot()
    pilot.texts()
    pilot.step(1.9, initialised=True, battery_v=3.41)
    assert not [text for text in pilot.texts() if "not ready" in text]
    for volt in (3.41, 3.42, 3.39):
        pilot.step(1.0, battery_v=volt)
    assert len([text for text in pilot.texts() if text.startswith("not ready to arm: battery at 3.4")]) == 1
    assert "battery at 3.3" in pilot.command(Command.ARM), "the reason, not the mode"
    pilot.texts()
    pilot.step(2.5, pose_age_s=9.0, battery_v=4.0)
    assert "not ready to arm: no fresh pose" in pilot.texts()


def test_the_end_of_readiness_is_reported_at_once():
    pilot = Pilot(M.READY)
    pilot.step(preflight="IMU at 90 Hz")
    assert "READY -> BOOT: sensors not healthy: IMU at 90 Hz" in pilot.texts()


def test_the_calibration_and_the_wait_for_health_run_together():
    pilot = Pilot(auto_arm=True)
    assert pilot.step(2.0, initialised=True, height_m=0.0, calibration="calibrating the IMU") is M.BOOT
    assert pilot.supervisor.not_ready == "calibrating the IMU"
    assert "calibrating" in pilot.command(Command.ARM)
    assert pilot.step(0.015, calibration="") is M.TAKE_OFF
    early = Pilot()
    early.step(0.3, initialised=True, calibration="calibrating the IMU")
    assert early.step(0.1, calibration="") is M.BOOT, "health has to last as well"


def test_a_vehicle_that_is_carried_away_must_rest_again():
    pilot = Pilot(M.READY)
    assert pilot.step(calibration="the vehicle moved") is M.BOOT
    assert "READY -> BOOT: sensors not healthy: the vehicle moved" in pilot.texts()
    assert pilot.step(0.6) is M.BOOT
    assert pilot.step(calibration="") is M.READY


def test_auto_arm_flies_once():
    pilot = Pilot(auto_arm=True)
    pilot.step(0.52, initialised=True, height_m=0.0)
    assert pilot.mode is M.TAKE_OFF
    pilot.step(height_m=1.0)
    pilot.command(Command.LAND)
    pilot.step(2.0, height_m=0.02)
    assert pilot.step(10.0) is M.READY


STORIES = {
    "arming needs half a second of health": (
        *(M.BOOT, {}, (0.45, {"initialised": True}, M.BOOT), (0.0, {"imu_age_s": 0.07}, M.BOOT)),
        *((0.45, {"imu_age_s": 0.0}, M.BOOT), (0.1, {}, M.READY)),
    ),
    "no pose needed": (M.BOOT, {"arm_needs_pose": False}, (0.6, {"initialised": True, "pose_age_s": 1e9}, M.READY)),
    "without auto_arm nothing starts": (M.BOOT, {}, (60.0, {"initialised": True}, M.READY)),
    "idle motors stop": (M.READY, {}, (0.0, Command.ARM, M.ARMED), (9.9, {}, M.ARMED), (0.2, {}, M.READY)),
    "a stale pose: hold, then back": (
        *(M.FLYING, {}, (0.0, {"pose_age_s": 0.49}, M.FLYING), (0.0, {"pose_age_s": 0.51}, M.HOLD)),
        *((0.25, {"pose_age_s": 0.1}, M.HOLD), (0.1, {}, M.FLYING)),
    ),
    "hold ends in a landing": (M.FLYING, {}, (20.1, {"pose_age_s": 1.0}, M.LANDING)),
    "continue while the estimate is good": (
        *(M.FLYING, {"on_pose_stale": "continue"}),
        *((10.0, {"pose_age_s": 10.0, "position_sigma_m": 0.4}, M.FLYING), (0.0, {"position_sigma_m": 0.6}, M.HOLD)),
        *((0.4, {"position_sigma_m": 0.3}, M.FLYING), (0.0, {"velocity_aid_age_s": 0.6}, M.HOLD)),
        (0.0, {"velocity_aid_age_s": 2.1}, M.HOLD_LEVEL),
    ),
    "no velocity for two seconds: level": (
        *(M.FLYING, {}, (0.0, {"velocity_aid_age_s": 1.99, "pose_age_s": 0.1}, M.FLYING)),
        *((0.0, {"velocity_aid_age_s": 2.01}, M.HOLD_LEVEL), (0.4, {"velocity_aid_age_s": 0.01}, M.LANDING)),
    ),
    "level ends with motors off": (M.HOLD_LEVEL, {}, (8.1, {}, M.LANDED)),
    "silence counts only if configured": (M.FLYING, {}, (0.0, {"ground_age_s": 1e9, "battery_age_s": 1e9}, M.FLYING)),
    "ground station silent": (M.FLYING, {"ground_silent_s": 5.0}, (0.0, {"ground_age_s": 6.0}, M.LANDING)),
    "battery silent": (M.FLYING, {"battery_silent_s": 5.0}, (0.0, {"battery_age_s": 6.0}, M.LANDING)),
    "a sag is not an empty battery": (
        *(M.FLYING, {}, (0.9, {"battery_v": 3.0}, M.FLYING), (0.2, {"battery_v": 3.6}, M.FLYING)),
        *((0.9, {"battery_v": 3.0}, M.FLYING), (0.2, {}, M.LANDING)),
    ),
    "little charge": (M.FLYING, {}, (1.1, {"battery_v": 0.0, "battery_remaining": 0.05}, M.LANDING)),
    "unknown charge": (M.FLYING, {}, (5.0, {"battery_v": 0.0, "battery_remaining": -1.0}, M.FLYING)),
    "touch-down is not a slow moment in the air": (
        *(M.LANDING, {}, (2.0, {"climb_m_s": -0.05, "thrust_to_weight": 0.9}, M.LANDING)),
        *((0.2, {"thrust_to_weight": 0.5}, M.LANDING), (0.2, {}, M.LANDED)),
    ),
    "an emergency ends by disarming": (M.EMERGENCY, {}, (30.0, {}, M.EMERGENCY), (0.0, Command.DISARM, M.BOOT)),
    "land on the ground": (M.READY, {}, (0.0, Command.LAND, M.READY)),
    "land in flight": (M.FLYING, {}, (0.0, Command.LAND, M.LANDING)),
    "a landed vehicle that falls silent has landed": (
        *(M.LANDING, {}, (0.2, {"height_m": 0.05}, M.LANDING), (0.0, {"imu_age_s": 0.06}, M.LANDED)),
        (1.1, {"imu_age_s": 1.2, "pose_age_s": 9.0, "ground_age_s": 9.0, "initialised": False}, M.BOOT),
    ),
    "silent in a landing at 0.3 m": (M.LANDING, {}, (0.0, {"height_m": 0.3, "imu_age_s": 0.06}, M.EMERGENCY)),
    "land when armed": (M.ARMED, {}, (0.0, Command.LAND, M.READY)),
    **{f"tilt {tilt}": (M.FLYING, {}, (0.0, {"tilt_rad": tilt}, M.EMERGENCY)) for tilt in (1.41, math.pi, math.nan)},
}
"""Start mode, configuration, and steps: seconds, changed inputs or a command, and the mode afterwards."""


@pytest.mark.parametrize("name", STORIES)
def test_a_story(name):
    mode, config, *steps = STORIES[name]
    pilot = Pilot(mode, **config)
    for seconds, cause, expected in steps:
        if isinstance(cause, Command):
            pilot.command(cause)
        else:
            pilot.step(seconds, **cause)
        assert pilot.mode is expected


@pytest.mark.parametrize(
    ("mode", "age_s", "next_mode"), [(M.LANDING, 0.02, M.HOLD_LEVEL), (M.HOLD_LEVEL, 5.0, M.LANDED)]
)
def test_a_descent_has_the_time_that_its_height_needs(mode, age_s, next_mode):
    pilot = Pilot(M.FLYING, landing_max_s=4.0, level_max_s=4.0)
    assert pilot.step(height_m=8.0, climb_m_s=-0.2, velocity_aid_age_s=age_s) is mode
    for decimetres in range(79, 4, -1):  # 75 s
        assert pilot.step(1.0, height_m=0.1 * decimetres - 0.01) is mode
    assert pilot.step(3.1) is next_mode


# -- ages -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", sorted(SPINNING), ids=lambda mode: mode.name)
def test_imu_silence_of_50_ms_stops_the_motors(mode):
    pilot = Pilot(mode)
    assert pilot.step(imu_age_s=0.05) is mode
    assert pilot.step(imu_age_s=0.055) is M.EMERGENCY
    assert pilot.mode not in SPINNING
    assert pilot.step(5.0, imu_age_s=0.0) is M.EMERGENCY


def test_silence_of_offboard_is_a_message_only():
    pilot = Pilot(M.FLYING)
    pilot.texts()
    assert pilot.step(30.0, offboard_age_s=30.0) is M.FLYING
    assert pilot.texts() == ["offboard silent"]
    pilot.step(offboard_age_s=0.1)
    assert pilot.texts() == ["offboard connected"]


def test_most_urgent_event_wins():
    pilot = Pilot(M.FLYING)
    pilot.supervisor.command(Command.LAND, pilot.now_ns)
    assert pilot.step(imu_age_s=1.0, tilt_rad=2.0, pose_age_s=9.0) is M.EMERGENCY
    assert pilot.texts()[-1] == "FLYING -> EMERGENCY: IMU silent"


# -- commands ---------------------------------------------------------------------------------------------------------


def test_termination_goes_first_and_is_final():
    pilot = Pilot(M.FLYING)
    for command in (Command.LAND, Command.TERMINATE):
        assert pilot.supervisor.command(command, pilot.now_ns) == ""
    assert pilot.step() is M.TERMINATED
    for command in Command:
        assert "TERMINATED" in pilot.command(command)
    assert pilot.step(60.0) is M.TERMINATED


def test_disarm_is_refused_in_flight():
    pilot = Pilot(M.FLYING)
    assert "FLYING" in pilot.command(Command.DISARM)
    assert pilot.mode is M.FLYING


def test_commands_before_the_first_step():
    supervisor = Supervisor(SupervisorConfig())
    assert supervisor.command(Command.ARM, 0) == "not in mode BOOT"
    supervisor.mode = M.READY
    assert supervisor.command(Command.ARM, 0) == "not running yet"
    assert supervisor.command(Command.TERMINATE, 0) == ""
    assert supervisor.step(GOOD) is M.TERMINATED


# -- ablations: a flight without the limit does not react --------------------------------------------------------------


@pytest.mark.parametrize(
    ("limit", "off", "cause"),
    [
        ("imu_silent_s", 1e9, {"imu_age_s": 10.0}),
        ("tilt_max_rad", 3.14, {"tilt_rad": 3.0}),
        ("velocity_lost_s", 1e9, {"velocity_aid_age_s": 60.0, "pose_age_s": 0.1}),
        ("pose_stale_s", 1e9, {"pose_age_s": 60.0}),
        ("battery_low_v", 0.1, {"battery_v": 2.5}),
        ("fence_m", 1e9, {"distance_m": 100.0}),
        ("ceiling_m", 1e9, {"height_m": 100.0}),
        ("ground_silent_s", 0.0, {"ground_age_s": 20.0}),
        ("battery_silent_s", 0.0, {"battery_age_s": 20.0}),
    ],
)
def test_without_the_limit_the_fault_has_no_effect(limit, off, cause):
    assert Pilot(M.FLYING, **(ALL_LIMITS | {limit: off})).step(3.0, **cause) is M.FLYING
    assert Pilot(M.FLYING, **ALL_LIMITS).step(3.0, **cause) is not M.FLYING
