"""A vehicle in a person's hands: scripted motions, genuine MAVLink frames, and mistakes that a bridge can make.

`mistakes` are words; each changes one thing. Time is virtual: it passes while the session waits.
"""

import numpy as np
from pymavlink.dialects.v20 import common as mavlink
from scipy.spatial.transform import Rotation

from onboard.preflight.checks import MAMBO_PLACES, MOTORS, MotorAnswer, Step
from onboard.preflight.recorder import PoseSample
from protocol.conventions import GRAVITY

TICK_NS = 5_000_000
BIAS = np.array([0.09, -0.06, 0.3])
PLACES = tuple(answer.place for answer in MOTORS.values())
MOTION = {
    Step.NOSE_DOWN: ("y", -0.55),
    Step.RIGHT_DOWN: ("x", 0.55),
    Step.TURN_RIGHT: ("z", 1.5),
}


def smooth(t):
    """0 to 1 between 2 s and 4 s."""
    u = float(np.clip((t - 2.0) / 2.0, 0.0, 1.0))
    return u * u * (3.0 - 2.0 * u)


class HeldVehicle:
    """Wire and person at once."""

    def __init__(self, mistakes=(), consent=True, seed=1):
        self.mistakes, self.consent = set(mistakes), consent
        self.now = 7_000_000_000
        self.rng = np.random.default_rng(seed)
        self.codec = mavlink.MAVLink(None, 3, 1)
        self.other = mavlink.MAVLink(None, 9, 1)
        self.step, self.began = Step.STILL, self.now
        self.heading = Rotation.from_euler("z", 0.4)
        self.attitude, self.place = self.heading, np.zeros(3)
        self.count, self.armed_commands, self.asked = 0, [], []
        self.last_command, self.commands = None, []
        self.told = []

    # the wire

    def now_ns(self):
        return self.now

    def exchange(self, wait_s):
        if wait_s <= 0.0:
            return [], []
        self.now += TICK_NS
        self.count += 1
        return self.frames(), self.poses()

    def send(self, datagram):
        message = mavlink.MAVLink(None).decode(bytearray(datagram))
        self.last_command = tuple(message.controls[:4]), bool(message.mode & 128)
        self.commands.append(self.last_command)

    # the person

    def ready(self, step, seconds):
        self.step, self.began = step, self.now
        self.attitude, self.place = self.heading, np.zeros(3)

    def consents(self):
        self.asked.append("consent")
        return self.consent

    def saw(self, motor):
        turned = [c[0] for c in self.commands if c[1]][-1]
        assert [i + 1 for i, f in enumerate(turned) if f > 0] == [motor]
        seen = MOTORS[motor]
        if "motors in the Mambo's order" in self.mistakes:
            seen = MotorAnswer(MAMBO_PLACES[motor - 1], "cw" if motor % 2 else "ccw")
        if "two motors swapped" in self.mistakes:
            seen = MOTORS[{1: 1, 2: 2, 3: 4, 4: 3}[motor]]
        if "propeller turns the other way" in self.mistakes and motor == 2:
            seen = MotorAnswer(seen.place, "cw")
        if "motor dead" in self.mistakes and motor == 4:
            seen = MotorAnswer("none", "")
        return seen

    def saw_it_stop(self):
        return "motors do not stop" not in self.mistakes

    def tell(self, checks):
        self.told += checks

    # the vehicle

    def pose_at(self, t):
        """Attitude and position, t seconds into the step."""
        attitude, place = self.heading, np.zeros(3)
        if self.step in MOTION and "nobody moves it" not in self.mistakes:
            axis, angle = MOTION[self.step]
            attitude = self.heading * Rotation.from_euler(axis, angle * smooth(t))
        if self.step is Step.LIFT:
            place = np.array([0.0, 0.0, -1.0]) * smooth(t)
        if self.step is Step.FORWARD:
            place = self.heading.as_matrix()[:, 0] * smooth(t) + np.array([0.0, 0.0, -0.8])
        return attitude, place

    def frames(self):
        t = (self.now - self.began) * 1e-9
        before, (self.attitude, self.place) = self.attitude, self.pose_at(t)
        rates = (before.inv() * self.attitude).as_rotvec() / 0.005 + self.rng.normal(0.0, 0.01, 3)
        force = self.attitude.inv().apply([0.0, 0.0, -GRAVITY]) + BIAS + self.rng.normal(0.0, 0.2, 3)
        pressure = 101_300.0 + 11.8 * self.place[2] + self.rng.normal(0.0, 2.0)
        out = [self.imu(force, rates, pressure)]
        if self.count % 3 == 0:
            out.append(self.flow(rates))
        if self.count % 8 == 0 and -self.place[2] > 0.4:
            out.append(self.distance(-self.place[2]))
        if self.count % 200 == 0:
            out += [self.battery(), self.heartbeat()]
        if "two vehicles" in self.mistakes:
            out.append(bytes(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 3, 3).pack(self.other)))
            out.append(self.imu(force, rates, pressure, self.other))
        if "half rate" in self.mistakes and self.count % 2:
            return []
        if "one way jitter" in self.mistakes and self.count % 10:
            self.held = [*getattr(self, "held", []), *out]
            return []
        held, self.held = getattr(self, "held", []), []
        return held + out

    def imu(self, force, rates, pressure, codec=None):
        bad, time_us = self.mistakes, self.now // 1000
        if "time in milliseconds" in bad:
            time_us //= 1000
        if "time in nanoseconds" in bad:
            time_us *= 1000
        if "acceleration in g" in bad:
            force = force / GRAVITY
        if "acceleration in milli-g" in bad:
            force = force / GRAVITY * 1000.0
        if "gravity instead of specific force" in bad:
            force = -force
        if "x is to the right" in bad:
            force, rates = force[[1, 0, 2]], rates[[1, 0, 2]]
        if "forward left up" in bad:
            force, rates = force * [1, -1, -1], rates * [1, -1, -1]
        if "turned by 45 degrees" in bad:
            turn = Rotation.from_euler("z", 45, degrees=True)
            force, rates = turn.apply(force), turn.apply(rates)
        if "accelerometer x reversed" in bad:
            force = force * [-1, 1, 1]
        if "gyro in degrees" in bad:
            rates = np.degrees(rates)
        if "gyro z reversed" in bad:
            rates = rates * [1, 1, -1]
        if "gyro stuck" in bad:
            rates = rates * [1, 0, 1]
        if "pressure in Pa" not in bad:
            pressure = pressure * 0.01
        fields = (*map(float, force), *map(float, rates), 0.0, 0.0, 0.0, float(pressure), 0.0, 0.0, 20.0)
        updated = 0x3F if "no pressure" in bad else 0x3F | 0x200
        return self.pack(mavlink.MAVLink_hil_sensor_message(time_us, *fields, updated), codec)

    def flow(self, rates):
        turned = rates * 0.015
        if "flow's gyro reversed" in self.mistakes:
            turned = -turned
        x, y, z = map(float, turned)
        return self.pack(
            mavlink.MAVLink_hil_optical_flow_message(self.now // 1000, 0, 15_000, x, y, x, y, z, 2000, 200, 0, -1.0)
        )

    def distance(self, height):
        centimetres = height * 100.0 + self.rng.normal(0.0, 1.5)
        if "range in millimetres" in self.mistakes:
            centimetres *= 10.0
        orientation = 0 if "range looks forward" in self.mistakes else 25
        return self.pack(
            mavlink.MAVLink_distance_sensor_message(
                self.now // 1_000_000, 44, 400, round(centimetres), 1, 0, orientation, 0
            )
        )

    def battery(self):
        millivolts = 3550 if "battery low" in self.mistakes else 4080
        if "battery in centivolts" in self.mistakes:
            millivolts = 408
        return self.pack(
            mavlink.MAVLink_battery_status_message(0, 1, 1, 2500, [millivolts] + [0xFFFF] * 9, -1, -1, -1, 90)
        )

    def heartbeat(self):
        return self.pack(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 3, 3))

    def pack(self, message, codec=None):
        codec = codec or self.codec
        frame = bytes(message.pack(codec))
        codec.seq = (codec.seq + 1) % 256
        return frame

    # the motion capture

    def poses(self):
        if self.count % 2 or "no motion capture" in self.mistakes:
            return []
        bad, attitude, place = self.mistakes, self.attitude, self.place
        x, y, z, w = attitude.as_quat()
        if "position in millimetres" in bad:
            place = place * 1000.0
        if "pose in ENU" in bad:  # as a motion capture with z up gives it: x forward, y left, z up
            place, (x, y, z) = place * [1, -1, -1], (x, -y, -z)
        if "quaternion world to body" in bad:
            x, y, z = -x, -y, -z
        if "position turned by 90 degrees" in bad:
            place = np.array([place[1], -place[0], place[2]])
        quaternion = (w, x, y, z) if "quaternion x y z w" not in bad else (x, y, z, w)
        return [PoseSample(self.now, tuple(map(float, place)), tuple(map(float, quaternion)))]
