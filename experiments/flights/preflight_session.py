"""The sequence of a preflight check: what the person is asked, what is recorded, which motor turns when.

Wire and person are arguments, so a test can play both. Motors turn only in `_spin_motors`, after the person's consent,
one at a time. An error or a silent vehicle stops them.
"""

from typing import Final, Protocol

from onboard.preflight.checks import (
    MOTORS,
    VEHICLE_RECEIVED,
    Check,
    MotorAnswer,
    PreflightConfig,
    Result,
    Step,
    check_motors,
    check_still,
    skipped,
)
from onboard.preflight.motion_checks import check_motion
from onboard.preflight.recorder import PoseSample, StepData, StepRecorder
from protocol.mavlink.vehicle import OFF

STILL_S: Final = 6.0
MOTION_S: Final = 8.0
COMMAND_PERIOD_NS: Final = 20_000_000
"""Period of motor commands at rest, zero and disarmed: a bridge that waits for the first command starts to send."""
SPIN_PERIOD_NS: Final = 5_000_000
SILENT_NS: Final = 200_000_000
"""After this silence of the vehicle its motors are stopped."""
STOPS: Final = 5
PAUSE_S: Final = 1.0


class Wire(Protocol):
    """The vehicle, the motion capture and the clock."""

    def now_ns(self) -> int:
        """Monotonic time."""

    def exchange(self, wait_s: float) -> tuple[list[bytes], list[PoseSample]]:
        """Wait at most `wait_s` for data; returns the vehicle's datagrams and the poses."""

    def send(self, datagram: bytes) -> None:
        """Send one datagram to the vehicle."""


class Person(Protocol):
    """The person who moves the vehicle and watches its rotors."""

    def ready(self, step: Step, seconds: float) -> None:
        """Explain a step; returns when the person begins."""

    def consents(self) -> bool:
        """Whether motors may turn: only a typed yes counts."""

    def saw(self, motor: int) -> MotorAnswer:
        """Which rotor turned, and in which direction."""

    def saw_it_stop(self) -> bool:
        """Whether the last motor stopped by itself at the end of the commands."""

    def tell(self, checks: list[Check]) -> None:
        """Show new results."""


class PreflightSession:
    """One run through all steps."""

    def __init__(
        self, wire: Wire, person: Person, recorder: StepRecorder, config: PreflightConfig, with_pose: bool
    ) -> None:
        self._wire = wire
        self._person = person
        self._recorder = recorder
        self._config = config
        self._with_pose = with_pose
        self.checks: list[Check] = []

    def run(self, motion: bool, motors: bool) -> list[Check]:
        """All steps; the ones not requested are rows "not done". Ends at once if nothing arrives from the vehicle."""
        self._add(check_still(self._record(Step.STILL, STILL_S), self._config, self._with_pose))
        if self.checks[0].name == VEHICLE_RECEIVED:
            return self.checks
        steps = [step for step in Step if step is not Step.STILL and (self._with_pose or step is not Step.FORWARD)]
        for step in steps:
            name = step.name.lower().replace("_", " ")
            if not motion:
                self._add([skipped(name, "left out as asked")])
                continue
            self._add(check_motion(step, self._record(step, MOTION_S), self._config, self._with_pose))
        if not motors or not self._person.consents():
            self._add([skipped("motor order", "no consent to turn motors" if motors else "left out as asked")])
        else:
            self._add(self._spin_motors())
        return self.checks

    def _add(self, checks: list[Check]) -> None:
        self.checks += checks
        self._person.tell(checks)

    def _record(self, step: Step, seconds: float) -> StepData:
        self._person.ready(step, seconds)
        self._drain()
        self._recorder.begin()
        end_ns = self._wire.now_ns() + round(seconds * 1e9)
        next_ns = 0
        while (now_ns := self._wire.now_ns()) < end_ns:
            if now_ns >= next_ns:
                self._wire.send(self._recorder.link.encode_motors(OFF, False, now_ns))
                next_ns = now_ns + COMMAND_PERIOD_NS
            self._listen()
        return self._recorder.end()

    def _listen(self) -> None:
        datagrams, poses = self._wire.exchange(0.005)
        now_ns = self._wire.now_ns()
        for datagram in datagrams:
            self._recorder.receive(datagram, now_ns)
        for pose in poses:
            self._recorder.receive_pose(pose)

    def _drain(self) -> None:
        """Discard what arrived while the person was reading: its arrival times would be wrong."""
        while any(self._wire.exchange(0.0)):
            pass

    def _spin_motors(self) -> list[Check]:
        answers: dict[int, MotorAnswer] = {}
        for motor in MOTORS:
            complete = self._spin(motor)
            self._stop()
            if not complete:
                hint = "the vehicle was silent while a motor turned"
                return [Check(f"motor {motor}", Result.FAIL, "stopped", "IMU all the time", hint)]
            answers[motor] = self._person.saw(motor)
        self._spin(len(MOTORS))
        self._pause(PAUSE_S)  # no command: the vehicle has to stop by itself
        stopped = self._person.saw_it_stop()
        self._stop()
        return check_motors(answers, stopped)

    def _spin(self, motor: int) -> bool:
        """Turn one motor for a moment; False if the vehicle was silent. An exception stops the motor."""
        fractions = tuple(self._config.spin_fraction if number == motor else 0.0 for number in MOTORS)
        command = (fractions[0], fractions[1], fractions[2], fractions[3])
        self._drain()
        start_ns = next_ns = self._wire.now_ns()
        end_ns = start_ns + round(self._config.spin_s * 1e9)
        try:
            while (now_ns := self._wire.now_ns()) < end_ns:
                if now_ns - max(start_ns, self._recorder.link.last_received_ns) > SILENT_NS:
                    return False
                if now_ns >= next_ns:
                    self._wire.send(self._recorder.link.encode_motors(command, True, now_ns))
                    next_ns = now_ns + SPIN_PERIOD_NS
                self._listen()
        except BaseException:
            self._stop()
            raise
        return True

    def _stop(self) -> None:
        for _ in range(STOPS):
            self._wire.send(self._recorder.link.encode_motors(OFF, False, self._wire.now_ns()))
            self._listen()

    def _pause(self, seconds: float) -> None:
        end_ns = self._wire.now_ns() + round(seconds * 1e9)
        while self._wire.now_ns() < end_ns:
            self._listen()
