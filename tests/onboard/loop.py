"""A simulated vehicle, an onboard core and a scripted offboard peer in one loop, for tests in virtual time."""

import copy
import copyreg
import functools
import struct

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from experiments.flights.scenario import Choices, resolve
from onboard.core import OnboardCore
from onboard.flight.supervisor import FlightMode
from onboard.preflight.certificate import CLEAR
from onboard.record.tick import OFFSET
from protocol.config import TransferConfig
from protocol.endpoint import Endpoint
from protocol.feature_config import feature_digest
from protocol.messages import Pose, SampleBatch, Status, TimeSyncReply, TimeSyncRequest
from protocol.transfer import FeatureSender
from sim_vehicle.vehicle import SimVehicle

PERIOD_NS = 5_000_000
CLOCK_NS = 7_000_000_000
"""How much the peer's clock is ahead of ours."""
ON_THE_FLOOR = (FlightMode.LANDED, FlightMode.BOOT, FlightMode.READY)


class Peer:
    """The offboard side, played by the test: answers time sync, relays poses, sends features."""

    def __init__(self, session=2):
        self.endpoint = Endpoint("offboard", session, None)
        self.sender = FeatureSender(TransferConfig())
        self.relays = True
        self.statuses, self.batches = [], []

    def take_in(self, datagram, now_ns):
        message = self.endpoint.decode(datagram, now_ns + CLOCK_NS)
        if isinstance(message, TimeSyncRequest):
            return [TimeSyncReply(message.origin_ns, now_ns + CLOCK_NS, now_ns + CLOCK_NS)]
        if isinstance(message, Status):
            self.statuses.append(message)
            self.sender.receive_status(message, now_ns)
        elif isinstance(message, SampleBatch):
            self.batches.append(message)
        return []

    def say(self, truth, tick, now_ns):
        messages = list(self.sender.poll(now_ns))
        if self.relays and tick % 2 == 0:
            place = np.array(truth[:3], dtype=np.float32)
            attitude = np.array(truth[6:10], dtype=np.float32)
            messages.append(Pose(now_ns + CLOCK_NS, place, attitude / np.linalg.norm(attitude)))
        return messages


class Loop:
    """Simulated vehicle and onboard core, one tick of delay, and a peer when there is one."""

    def __init__(self, controller="pid", scenario="hover", peer=None, assignments=(), real=False, clearance=CLEAR):
        if peer is None and not real:  # no pose will come
            assignments = ("onboard.pose_wait_s=4.0", *assignments)
        self.config = resolve(scenario, Choices(controller, 3, None, assignments, real))
        self.vehicle = SimVehicle(self.config.vehicle, self.config.seed)
        self.core = OnboardCore(self.config.onboard, 1, None, clearance=clearance)
        self.peer = None
        if peer is not None:
            self.join(peer)
        self.now_ns, self.tick = 0, 0
        self.waiting, self.motors, self.extra, self.from_ground, self.land = [], [], [], [], False
        self.passes, self.fault = None, lambda t, frames: frames
        self.rows, self.truths, self.events, self.offsets = [], [], [], []

    def join(self, peer):
        """Attach a peer that has the flight's configuration."""
        self.peer = peer
        peer.endpoint.layout = feature_digest(self.config.features)

    def fly(self, seconds):
        for _ in range(round(seconds * 1e9 / PERIOD_NS)):
            if self.vehicle.crash_reason:
                break
            self.step()
        return self

    def step(self):
        now = self.now_ns
        flown = self.vehicle.step(now)
        from_vehicle = self.fault(now * 1e-9, list(filter(self.passes, flown.to_onboard)))
        messages = [self.peer.endpoint.encode(message, now + CLOCK_NS) for message in self.waiting]
        out = self.core.tick(now, from_vehicle, [*self.extra, *messages], self.from_ground, self.land)
        self.extra, self.from_ground, self.land = [], [], False
        for datagram in self.motors:
            self.vehicle.receive(datagram, now)
        self.motors, self.waiting = out.to_vehicle, []
        if self.peer is not None:
            for datagram in out.to_offboard:
                self.waiting += self.peer.take_in(datagram, now)
            self.waiting += self.peer.say(flown.truth, self.tick, now)
        self.rows.append(out.tick.copy())
        self.truths.append(np.array(flown.truth))
        self.events += [text for _, text in out.events]
        self.to_ground = out.to_ground
        self.offsets += [] if out.clock_offset is None else [(now, *out.clock_offset)]
        self.now_ns += PERIOD_NS
        self.tick += 1

    def column(self, name):
        return np.array([row[OFFSET[name]] for row in self.rows])

    def vector(self, name):
        return np.stack([self.column(f"{name}_{axis}") for axis in "ned"], axis=1)

    @property
    def mode(self):
        return FlightMode(int(self.rows[-1][OFFSET["mode"]]))

    def said(self, words):
        return [event for event in self.events if words in event]


copyreg.pickle(struct.Struct, lambda made: (struct.Struct, (made.format,)))  # so that a core can be copied


@functools.cache
def _flown(controller):
    loop = Loop(controller, peer=Peer()).fly(5.0)
    assert loop.mode is FlightMode.FLYING
    return loop


def in_flight(controller):
    """A loop with a peer, five seconds into its flight; each caller gets its own."""
    flown = _flown(controller)
    endpoints = (flown.core._offboard_link.endpoint, flown.peer.endpoint)
    keys = {id(key): key for endpoint in endpoints for key in (endpoint._send, endpoint._receive)}
    return copy.deepcopy(flown, keys)  # key states cannot be copied, and never change


def armed(datagram):
    """Whether a motor frame arms, and its four controls, as pymavlink reads it."""
    message = mavlink.MAVLink(None).parse_buffer(datagram)[0]
    return bool(message.mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED), message.controls[:4]
