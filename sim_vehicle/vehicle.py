"""The simulated vehicle: motor commands in, sensor datagrams and truth out. No clock, no socket, no file.

Time is flight time, ns from 0. The vehicle moves on a grid of 1 ms sub-steps: `step` integrates up to the last grid
point at or before its time. Sensors sample on every fifth grid point (200 Hz), independently of the times of the calls.
"""

from collections import Counter, deque
from math import cos, sin
from typing import Any, Final, TypeVar, cast

import numpy as np

import sim_vehicle.physics.layout as at
from protocol.conventions import GRAVITY, Array
from protocol.named_tuple import of_members
from sim_vehicle.config import SimVehicleConfig
from sim_vehicle.link.mavlink import VehicleCodec
from sim_vehicle.link.radio import Radio
from sim_vehicle.physics.advance import CLEARANCE, WORK_ROWS, write_truth
from sim_vehicle.physics.choice import physics_of
from sim_vehicle.physics.crash import crash_limits, crash_reason
from sim_vehicle.physics.draws import SUBSTEPS_MAX
from sim_vehicle.physics.packing import COULOMB_PER_MAH, SUBSTEP_NS
from sim_vehicle.records import TRUTH, VehicleOutput
from sim_vehicle.sensors.battery import Battery
from sim_vehicle.sensors.flow import Flow
from sim_vehicle.sensors.imu import Imu
from sim_vehicle.sensors.motion_capture import MotionCapture
from sim_vehicle.sensors.ultrasonic import Ultrasonic
from sim_vehicle.world.world import World

PERIOD_NS: Final = 5 * SUBSTEP_NS
"""IMU period, and step of the real-time process."""
IMU_STREAM, ULTRASONIC_STREAM, FLOW_STREAM, CAPTURE_STREAM, BATTERY_STREAM, WIRE_STREAM = 1, 2, 3, 4, 5, 6
"""Random streams [seed, n] of the sensors and of the vehicle's link."""
_TRUTH_SIZE: Final = len(TRUTH.fields)
SampleT = TypeVar("SampleT")
_output: Final = of_members(VehicleOutput)


class SimVehicle:
    """One Mambo in its world, and the motion capture that sees it.

    key, capture_key: of the MAVLink of vehicle and motion capture; None: unsigned.

    Raises ConfigError if its physics cannot be used.
    """

    def __init__(
        self, config: SimVehicleConfig, seed: int, key: bytes | None = None, capture_key: bytes | None = None
    ) -> None:
        self._world = World(config, seed)
        self._physics = physics_of(config)
        self._state = initial_state(config)
        self._sums: Array = np.zeros(at.SUMS_SIZE)
        self._work: Array = np.zeros((WORK_ROWS, at.RIGID))
        self._commands: Array = np.zeros(4)
        self._limits: Array = crash_limits(config)
        hover_thrust_n = config.body.mass_kg * GRAVITY / 4
        sensors = config.sensors
        self._imu = Imu(sensors.imu, hover_thrust_n, seed, IMU_STREAM)
        self._ultrasonic = Ultrasonic(sensors.ultrasonic, seed, ULTRASONIC_STREAM)
        self._flow = Flow(sensors.flow, seed, FLOW_STREAM)
        self._capture = MotionCapture(sensors.motion_capture, seed, CAPTURE_STREAM)
        self._battery = Battery(sensors.battery_noise_v, config.battery.capacity_mah, seed, BATTERY_STREAM)
        self._slow = tuple(one.schedule for one in (self._flow, self._ultrasonic, self._battery, self._capture))
        self._capture_latency_ns = round(sensors.motion_capture.latency_s * 1e9)
        self._codec = VehicleCodec(config.link, sensors.ultrasonic, sensors.motion_capture, key, capture_key)
        self.start_capture: Final = self._codec.start_capture
        self._last_samples: dict[str, Any] = {}
        self._clock_offset_us = round(config.link.clock_offset_s * 1e6)
        self._command_min = config.motors.command_min
        self._command_delay_ns = round(config.motors.command_delay_s * 1e9)
        self._command_timeout_ns = round(config.motors.command_timeout_s * 1e9)
        self._wire: Radio | None = None
        if config.impairment is not None:
            self._wire = Radio(config.impairment, np.random.default_rng([seed, WIRE_STREAM]), start_ns=0)
        self._poses: deque[tuple[int, bytes]] = deque()
        self._pending: deque[tuple[int, tuple[float, float, float, float], bool]] = deque(maxlen=256)
        self._armed = False
        self._commanded_ns = 0
        self._time_ns = 0
        self._sample_ns = PERIOD_NS
        self._slow_due_ns = 0
        """When the next of the other sensors is due; the IMU always is."""
        self.crash_reason = ""
        """Empty until the vehicle crashes. The motors are off from then on."""

    @property
    def armed(self) -> bool:
        """Whether the motors may run: as last commanded, false after a silence of the commands."""
        return self._armed

    @property
    def rejected(self) -> Counter[str]:
        """Motor frames dropped, by reason."""
        return self._codec.rejected

    def receive(self, datagram: bytes, now_ns: int) -> None:
        """Receive a datagram from onboard. Its motor command acts from `now_ns` plus the configured delay.

        A datagram without a valid motor command is counted in `rejected` and dropped.
        """
        if self._wire is None:
            self._queue_command(datagram, now_ns)
        else:
            self._wire.send("down", datagram, now_ns)

    def _queue_command(self, datagram: bytes, now_ns: int) -> None:
        command = self._codec.motor_command(datagram)
        if command is not None:
            self._pending.append((now_ns + self._command_delay_ns, command[0], command[1]))

    def step(self, now_ns: int) -> VehicleOutput:
        """Advance to `now_ns` and sample the sensors that are due. Time does not go backwards."""
        to_onboard: list[bytes] = []
        end_ns = now_ns - now_ns % SUBSTEP_NS
        while self._time_ns < end_ns:
            self._run(min(end_ns, self._sample_ns, self._world.next_event_ns, self._apply_command()))
            if self._time_ns >= self._world.next_event_ns:
                self._world.apply(self._time_ns)
            if self._time_ns >= self._sample_ns:
                self._sample_ns += PERIOD_NS
                self._sample(to_onboard)
                if self._wire is not None:
                    for datagram in to_onboard:
                        self._wire.send("up", datagram, self._time_ns)
                    to_onboard.clear()
        if self._wire is not None:
            to_onboard = self._wire.due("up", now_ns)
        to_motion_capture = []
        while self._poses and self._poses[0][0] <= now_ns:
            to_motion_capture.append(self._poses.popleft()[1])
        truth = np.empty(_TRUTH_SIZE)
        write_truth(self._state, self._sums, self._world.condition.parameters, truth)
        return _output((to_onboard, to_motion_capture, truth))

    def _apply_command(self) -> int:
        """Apply the command that is due, and return the time of the next change, ns."""
        arrival_ns = None
        if self._wire is not None:
            for datagram in self._wire.due("down", self._time_ns):
                self._queue_command(datagram, self._time_ns)
            arrival_ns = self._wire.next_due_ns("down")
        while self._pending and self._pending[0][0] <= self._time_ns:
            due_ns, fractions, self._armed = self._pending.popleft()
            self._commanded_ns = due_ns
            least = self._command_min
            if not self._armed:
                self._commands[:] = 0.0
            elif min(fractions) >= least:
                self._commands[:] = fractions
            else:
                self._commands[:] = [max(least, value) for value in fractions]
        timeout_ns = self._commanded_ns + self._command_timeout_ns
        if self._armed and self._time_ns >= timeout_ns:
            self._armed = False
        if not self._armed or self.crash_reason:
            self._commands[:] = 0.0
        next_ns = timeout_ns if self._armed else self._time_ns + SUBSTEPS_MAX * SUBSTEP_NS
        if self._pending:
            next_ns = min(next_ns, self._pending[0][0])
        if arrival_ns is not None:
            next_ns = min(next_ns, arrival_ns)
        return -(-next_ns // SUBSTEP_NS) * SUBSTEP_NS

    def _run(self, end_ns: int) -> None:
        count = (end_ns - self._time_ns) // SUBSTEP_NS
        world = self._world
        crash = self._physics(
            self._state,
            self._commands,
            world.condition.parameters,
            world.rows,
            world.memories,
            world.normals.take(count),
            self._sums,
            self._work,
            self._time_ns * 1e-9,
            count,
            self._limits,
        )
        self._time_ns = end_ns
        if crash and not self.crash_reason:
            self.crash_reason = crash_reason(crash, self._state, self._sums)

    def _sample(self, to_onboard: list[bytes]) -> None:
        """Sample every sensor that is due now."""
        now_ns, state, sums, codec, sent = self._time_ns, self._state, self._sums, self._codec, self._sent
        condition = self._world.condition
        capture_us = now_ns // 1000 + self._clock_offset_us
        time_us = max(0, capture_us + condition.clock_jump_ns // 1000)
        imu = sent("imu", self._imu.sample(state, sums, condition.shaking))
        if imu is not None:
            to_onboard.append(codec.imu(imu, time_us))
        if now_ns < self._slow_due_ns:
            return
        flows, ultrasonics, batteries, poses = self._slow
        if now_ns >= flows.due_ns and flows.is_due(now_ns):
            flow = sent("flow", self._flow.sample(state, sums))
            if flow is not None:
                to_onboard.append(codec.flow(flow, time_us))
        if now_ns >= ultrasonics.due_ns and ultrasonics.is_due(now_ns):
            distance_m = sent("ultrasonic", self._ultrasonic.sample(state))
            if distance_m is not None:
                to_onboard.append(codec.distance(distance_m, time_us))
        if now_ns >= batteries.due_ns and batteries.is_due(now_ns):
            to_onboard.append(codec.heartbeat(self._armed))
            battery = sent("battery", self._battery.sample(state, sums))
            if battery is not None:
                to_onboard.append(codec.battery(battery))
        if now_ns >= poses.due_ns and poses.is_due(now_ns):
            pose = sent("motion_capture", self._capture.sample(state, now_ns))
            if pose is not None:
                self._poses.append((now_ns + self._capture_latency_ns, codec.pose(pose, capture_us)))
        self._slow_due_ns = min(flows.due_ns, ultrasonics.due_ns, batteries.due_ns, poses.due_ns)

    def _sent(self, sensor: str, sample: SampleT | None) -> SampleT | None:
        """What the sensor sends: `sample` unless it has a fault. None: nothing."""
        faults = self._world.condition.sensor_faults
        if faults and (fault := faults.get(sensor)) is not None:
            return cast(SampleT | None, fault(sample, self._last_samples.get(sensor)))
        if sample is not None:
            self._last_samples[sensor] = sample
        return sample


def initial_state(config: SimVehicleConfig) -> Array:
    """[STATE_SIZE] at flight time 0."""
    state = np.zeros(at.STATE_SIZE)
    initial, floor = config.initial, config.floor
    weight_n = config.body.mass_kg * GRAVITY
    sunk_m = weight_n / (4 * floor.stiffness_n_m) if config.physics != "mujoco" else 0.0  # it settles by itself
    rest_d = sunk_m - floor.foot_drop_m
    state[: at.VELOCITY] = (0.0, 0.0, rest_d) if initial.position_ned_m is None else initial.position_ned_m
    state[at.VELOCITY : at.QUATERNION] = initial.velocity_ned_m_s
    state[at.QUATERNION] = cos(initial.yaw_rad / 2)
    state[at.QUATERNION + 3] = sin(initial.yaw_rad / 2)
    if initial.hovering:
        state[at.THRUST : at.ROTOR_PHASE] = weight_n / 4
    state[at.CHARGE_USED] = config.battery.charge_used * config.battery.capacity_mah * COULOMB_PER_MAH
    span = config.battery.full_v - config.battery.empty_v
    state[at.VOLTAGE] = config.battery.full_v - span * config.battery.charge_used
    state[at.AIRBORNE] = float(state[at.POSITION + 2] < -floor.foot_drop_m - CLEARANCE)
    return state
