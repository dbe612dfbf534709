"""The course of a preflight check: what the person is asked, what is recorded meanwhile, which motor turns when.

The wire and the person are passed in, so that a test can play both. Motors turn only in `spin_motors`, which begins
by asking for consent, one at a time, and are told to stop whatever happens.
"""

from typing import Final, Protocol

from onboard.preflight.checks import (
    MOTORS,
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

STILL_S: Final = 6.0
MOTION_S: Final = 8.0
COMMAND_PERIOD_NS: Final = 20_000_000
"""Motor commands at rest: zero and disarmed, so that a bridge that waits for its master begins to talk."""
SPIN_PERIOD_NS: Final = 5_000_000
SILENT_NS: Final = 200_000_000
"""A vehicle silent for so long gets no more commands to spin."""
STOPS: Final = 5
PAUSE_S: Final = 1.0
OFF: Final = (0.0, 0.0, 0.0, 0.0)


class Wire(Protocol):
    """The vehicle, the motion capture and the clock."""

    def now_ns(self) -> int:
        """The time."""

    def exchange(self, wait_s: float) -> tuple[list[bytes], list[PoseSample]]:
        """Waits at most so long for something to arrive; what has come from the vehicle, and poses."""

    def send(self, datagram: bytes) -> None:
        """One datagram to the vehicle."""


class Person(Protocol):
    """Who moves the vehicle and looks at its rotors."""

    def ready(self, step: Step, seconds: float) -> None:
        """Explains a step and returns when the person begins."""

    def consents(self) -> bool:
        """Whether motors may turn: only an explicit, typed yes counts."""

    def saw(self, motor: int) -> MotorAnswer:
        """Which rotor turned, and how."""

    def saw_it_stop(self) -> bool:
        """Whether the last motor stopped by itself, at once, when the commands ended."""

    def tell(self, checks: list[Check]) -> None:
        """Results as they come."""


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
        """All steps; those not wanted are rows "not done". A vehicle that is not heard ends it at once."""
        recording = self._record(Step.STILL, STILL_S)
        self._add(check_still(recording, self._config, self._with_pose))
        if self.checks[0].name == "vehicle heard":
            return self.checks
        steps = [step for step in Step if step is not Step.STILL and (self._with_pose or step is not Step.FORWARD)]
        for step in steps:
            name = step.name.lower().replace("_", " ")
            if not motion:
                self._add([skipped(name, "left out as asked")])
                continue
            recording = self._record(step, MOTION_S)
            self._add(check_motion(step, recording, self._config, self._with_pose))
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
                self._wire.send(self._recorder.motors(OFF, False, now_ns))
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
        """What waited while the person read is old; its arrival times would be wrong."""
        while any(self._wire.exchange(0.0)):
            pass

    def _spin_motors(self) -> list[Check]:
        answers: dict[int, MotorAnswer] = {}
        for motor in MOTORS:
            heard = self._spin(motor)
            self._stop()
            if not heard:
                hint = "the vehicle fell silent while a motor turned"
                return [Check(f"motor {motor}", Result.FAIL, "stopped", "IMU all the time", hint)]
            answers[motor] = self._person.saw(motor)
        self._spin(len(MOTORS))
        self._pause(PAUSE_S)  # no command: the vehicle has to stop by itself
        stopped = self._person.saw_it_stop()
        self._stop()
        return check_motors(answers, stopped)

    def _spin(self, motor: int) -> bool:
        """Turns one motor for a moment; False when the vehicle fell silent meanwhile. Stops it if anything fails."""
        fractions = tuple(self._config.spin_fraction if number == motor else 0.0 for number in MOTORS)
        command = (fractions[0], fractions[1], fractions[2], fractions[3])
        self._drain()
        start_ns = next_ns = self._wire.now_ns()
        end_ns = start_ns + round(self._config.spin_s * 1e9)
        try:
            while (now_ns := self._wire.now_ns()) < end_ns:
                if now_ns - max(start_ns, self._recorder.last_received_ns) > SILENT_NS:
                    return False
                if now_ns >= next_ns:
                    self._wire.send(self._recorder.motors(command, True, now_ns))
                    next_ns = now_ns + SPIN_PERIOD_NS
                self._listen()
        except BaseException:
            self._stop()
            raise
        return True

    def _stop(self) -> None:
        for _ in range(STOPS):
            self._wire.send(self._recorder.motors(OFF, False, self._wire.now_ns()))
            self._listen()

    def _pause(self, seconds: float) -> None:
        end_ns = self._wire.now_ns() + round(seconds * 1e9)
        while self._wire.now_ns() < end_ns:
            self._listen()
