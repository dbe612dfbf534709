"""The vehicle's end of the link, encoded by pymavlink, and a link with its own clock."""

import math

from pymavlink.dialects.v20 import common as mavlink

from onboard.links.vehicle import VehicleLink, VehicleLinkConfig

STEP_NS = 5_000_000
KEY = bytes(range(32))
OTHER_KEY = bytes(32)
LATENCY_NS = 300_000


class Vehicle:
    """The vehicle's end, encoded by pymavlink, as an independent check of our bytes."""

    def __init__(self, system=1, key=None, clock_ns=0, link_id=0):
        self.mav = mavlink.MAVLink(None, system, 1)
        self.clock_ns = clock_ns
        self.count = 0
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.link_id = link_id

    def pack(self, message):
        frame = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return frame

    def imu(
        self,
        time_ns=None,
        acc=(0.1, -0.2, -9.8),
        gyro=(0.01, 0.02, 0.03),
        pressure_hpa=1013.25,
        fields=0x1FFF,
        sensor=0,
    ):
        self.count += 1
        stamp_us = (self.clock_ns if time_ns is None else time_ns) // 1000
        ax = acc[0] + 1e-4 * self.count if math.isfinite(acc[0]) else acc[0]
        values = (ax, acc[1], acc[2], *gyro, 0.2, 0.0, 0.4, pressure_hpa, 0.0, 10.0, 20.0)
        return self.pack(mavlink.MAVLink_hil_sensor_message(stamp_us, *values, fields, sensor))

    def tick(self, link, ticks=1, **what):
        """Advance the vehicle's clock and send one IMU sample a tick; returns all readings."""
        readings = []
        for _ in range(ticks):
            self.clock_ns += STEP_NS
            link.now_ns += STEP_NS
            readings += link.receive(self.imu(**what), link.now_ns)
        return readings


class Link(VehicleLink):
    """A link with its own clock."""

    def __init__(self, key=None, now_ns=10**12, signing_clock=None, **config):
        super().__init__(VehicleLinkConfig(**config), key, signing_clock)
        self.now_ns = now_ns

    def texts(self):
        return " | ".join(text for _, text in self.take_events())
