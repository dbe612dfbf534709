"""Stories of the onboard core in virtual time: alone; with a peer that misbehaves, restarts, comes late, teaches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink

from onboard.flight.adaptation_gate import ADAPT_CLIMB_M
from onboard.flight.supervisor import FlightMode
from protocol.arrival import Arrival
from protocol.messages import Pose
from sim_vehicle.records import TRUTH
from tests.onboard.loop import CLOCK_NS, ON_THE_FLOOR, PERIOD_NS, Loop, Peer, armed, in_flight

# --- alone -----------------------------------------------------------------------------------------------------------


def test_without_offboard_it_flies_on_flow_and_range():
    loop = Loop("mrac", assignments=("onboard.pose_wait_s=0.5",)).fly(6.0)
    assert loop.vehicle.crash_reason == ""
    assert loop.mode is FlightMode.FLYING
    assert loop.column("offboard_age")[-1] == -1.0
    assert loop.column("feature_version")[-1] == 0
    assert -1.3 < loop.truths[-1][2] < -0.7


def test_a_whole_flight_ends_on_the_floor_with_motors_off():
    loop = Loop(peer=Peer(), assignments=("onboard.guidance.land_after_s=3.0",)).fly(9.5)
    assert loop.mode in ON_THE_FLOOR
    assert loop.vehicle.crash_reason == ""
    assert not armed(loop.motors[-1])[0]
    modes = [FlightMode(int(mode)) for mode in dict.fromkeys(loop.column("mode").tolist())]
    assert [mode for mode in modes if mode in (FlightMode.TAKE_OFF, FlightMode.FLYING, FlightMode.LANDING)] == [
        FlightMode.TAKE_OFF,
        FlightMode.FLYING,
        FlightMode.LANDING,
    ]


def test_a_request_to_land_is_obeyed():
    loop = in_flight("pid")
    loop.land = True
    loop.fly(0.5)
    assert loop.mode is FlightMode.LANDING
    loop.fly(4.5)
    assert loop.mode in ON_THE_FLOOR
    assert loop.core.airborne is False
    assert loop.vector("target")[-1][2] == pytest.approx(loop.truths[-1][2], abs=0.03)  # it does not sink further


def is_no_flow(datagram):
    return all(
        message.get_type() != "HIL_OPTICAL_FLOW" for message in mavlink.MAVLink(None).parse_buffer(datagram) or []
    )


def test_a_landing_after_flying_level_begins_where_the_vehicle_is():
    """Blind for seconds it drifts and sinks: climbing back to the old target first would be no landing."""
    loop = in_flight("pid")
    loop.peer.relays, loop.passes = False, is_no_flow
    while loop.mode is not FlightMode.HOLD_LEVEL and loop.tick < 2000:
        loop.step()
    loop.fly(0.5)
    assert loop.mode is FlightMode.HOLD_LEVEL
    np.testing.assert_allclose(loop.vector("target")[-1], loop.vector("position")[-1], atol=0.01)
    loop.passes = None
    while loop.mode is FlightMode.HOLD_LEVEL and loop.tick < 3000:
        loop.step()
    assert loop.mode is FlightMode.LANDING
    np.testing.assert_allclose(loop.vector("target")[-1], loop.vector("position")[-1], atol=0.05)


def test_the_controller_is_told_when_the_motors_cannot_do_it():
    loop = in_flight("pid")
    step, told = loop.core.controller.step, []

    def greedy(inputs):
        told.append(inputs.saturated)
        output = step(inputs)
        output.thrust_n = 10.0 if len(told) == 3 else output.thrust_n
        return output

    loop.core.controller.step = greedy
    loop.fly(0.03)
    assert told == [False, False, False, True, False, False]
    assert loop.column("saturated")[-6:].tolist() == [0, 0, 1, 0, 0, 0]


# --- our own mistakes ------------------------------------------------------------------------------------------------


def test_what_goes_wrong_in_a_step_is_raised_and_the_safe_output_still_works():
    loop = in_flight("pid")
    flying, controls = armed(loop.motors[-1])
    assert flying
    assert min(controls) > 0.2

    def broken(inputs):
        raise RuntimeError("a controller's own mistake")

    loop.core.controller.step = broken
    with pytest.raises(RuntimeError, match="own mistake"):
        loop.core.tick(loop.now_ns)
    output = loop.core.safe_output(loop.now_ns)
    assert output.to_offboard == []
    assert [armed(datagram) for datagram in output.to_vehicle] == [(False, [0.0] * 4)]


def test_a_failed_step_does_not_spoil_the_next():
    loop = in_flight("pid")
    step, loop.core.controller.step = loop.core.controller.step, None
    with pytest.raises(TypeError):
        loop.core.tick(loop.now_ns)
    loop.core.controller.step = step
    loop.fly(1.0)
    assert loop.mode is FlightMode.FLYING
    assert loop.vehicle.crash_reason == ""


def test_a_tick_after_a_stall_uses_the_arrival_times_of_its_datagrams():
    loop = in_flight("pid")
    received, clock = [], loop.core._vehicle_link.receive
    loop.core._vehicle_link.receive = lambda datagram, now_ns: received.append(now_ns) or clock(datagram, now_ns)
    arrivals, began_ns = [], loop.now_ns
    for _ in range(8):  # onboard stands still for 40 ms
        now = loop.now_ns
        arrivals += [(now, datagram) for datagram in loop.vehicle.step(now).to_onboard]
        loop.now_ns += PERIOD_NS
    now = loop.now_ns - PERIOD_NS
    loop.core.tick(now, [Arrival(datagram, now - came_ns) for came_ns, datagram in arrivals])
    assert received == [came_ns for came_ns, _ in arrivals]
    assert received[0] == began_ns
    assert loop.core._clock.jumps == 0
    assert loop.core._estimator.state.last_imu_ns == now
    loop.core._vehicle_link.receive = clock
    loop.fly(2.0)
    assert loop.mode is FlightMode.FLYING
    assert loop.vehicle.crash_reason == ""


# --- a peer's rubbish ------------------------------------------------------------------------------------------------

rubbish = st.one_of(
    st.binary(max_size=300),
    st.binary(min_size=20, max_size=60).map(lambda tail: b"\x01\x03\x01\x00" + tail),
    st.binary(min_size=20, max_size=60).map(lambda tail: b"\xfd" + tail),
)


def test_no_datagram_raises_or_stops_the_flight():
    loop = in_flight("pid")
    genuine = loop.core.tick(loop.now_ns).to_vehicle

    @settings(max_examples=150, deadline=None, derandomize=True, database=None)
    @given(rubbish)
    def feed(datagram):
        loop.core.tick(loop.now_ns, [datagram], [datagram], [datagram])

    feed()
    loop.extra = [genuine[0]]
    loop.fly(1.0)
    assert loop.mode is FlightMode.FLYING
    summary = loop.core.summary()
    assert sum(summary["rejected"].values()) >= 150
    assert sum(summary["vehicle_rejected"].values()) >= 100
    assert loop.peer.statuses[-1].rejected >= 150


def test_bits_turned_in_genuine_datagrams_are_noticed():
    loop = Loop(peer=Peer()).fly(1.0)
    rng = np.random.default_rng(5)
    message = Pose(loop.now_ns + CLOCK_NS, np.zeros(3, np.float32), np.array([1, 0, 0, 0], np.float32))
    for _ in range(50):
        datagram = bytearray(loop.peer.endpoint.encode(message, loop.now_ns))
        datagram[rng.integers(len(datagram))] ^= 1 << int(rng.integers(8))
        loop.core.tick(loop.now_ns, from_offboard=[bytes(datagram)])
    assert sum(loop.core.summary()["rejected"].values()) == 50


# --- poses -----------------------------------------------------------------------------------------------------------


def test_a_first_pose_that_comes_in_flight_moves_the_path_and_not_the_vehicle():
    away = "vehicle.initial.position_ned_m=[0.8, -0.6, -0.022]"
    loop = Loop("mrac", peer=Peer(), assignments=(away, "onboard.pose_wait_s=1.0"))
    loop.peer.relays = False
    loop.fly(6.0)
    assert loop.mode is FlightMode.FLYING
    before = loop.truths[-1][:3].copy()
    loop.peer.relays = True
    loop.fly(2.0)
    assert loop.said("jumped")
    np.testing.assert_allclose(loop.vector("position")[-1], loop.truths[-1][:3], atol=0.1)
    moved = np.array([truth[:3] for truth in loop.truths[-400:]]) - before
    assert np.abs(moved).max() < 0.25
    np.testing.assert_allclose(loop.vector("target")[-1][:2], (0.8, -0.6), atol=0.3)
    # The jump was told to the controller, too: its error did not see it.
    assert np.abs(loop.vector("position_error")[-400:]).max() < 0.1


class JumpingPeer(Peer):
    """Its poses jump for good when the test says so."""

    jump = 0.0

    def say(self, truth, tick, now_ns):
        truth = np.array(truth)
        truth[0] += self.jump
        return super().say(truth, tick, now_ns)


@pytest.mark.parametrize("jump_m", [2.0, 4.45])
def test_after_a_jump_of_the_pose_the_vehicle_flies_back_slowly_and_reports_it(jump_m):
    limits = ("onboard.estimator.pose_jump_m=10.0", "onboard.estimator.pose_drift_m=20.0")
    loop = Loop("mrac", peer=JumpingPeer(), assignments=limits).fly(5.0)
    loop.peer.jump = jump_m
    start = loop.tick
    loop.fly(0.3)
    assert loop.said("position estimate jumped")
    assert loop.core.status(loop.now_ns)["tracking_error_m"] == pytest.approx(jump_m, abs=0.05)
    loop.fly(1.7 + jump_m / 0.5)
    assert loop.core.status(loop.now_ns)["tracking_error_m"] < 0.05
    north, speed = np.array(loop.truths)[start:, 0], np.array(loop.truths)[start:, 3]
    assert north[-1] == pytest.approx(-jump_m, abs=0.05)
    assert north.min() > -jump_m - 0.1
    assert -0.9 < speed.min() < -0.4  # without the limit: -4.5


def test_a_jump_of_the_pose_that_the_vehicle_cannot_have_made_does_not_move_it():
    loop = Loop("mrac", peer=JumpingPeer()).fly(5.0)
    loop.peer.jump = 2.0
    start = loop.tick
    loop.fly(2.0)
    assert not loop.said("position estimate jumped 2")
    assert loop.core.summary()["estimator"]["pose_implausible"] > 150
    assert np.abs(np.array(loop.truths)[start:, :2]).max() < 0.2


def test_arming_waits_for_the_first_pose_and_reports_it():
    early = Loop(peer=Peer()).fly(3.0)
    assert early.mode not in (FlightMode.BOOT, FlightMode.READY)
    assert early.core.status(early.now_ns)["not_ready"] == ""
    late = Loop(peer=Peer())
    late.peer.relays = False
    late.fly(30.0)
    assert late.mode is FlightMode.BOOT
    assert late.said("not ready to arm: waiting for the first pose")
    assert late.core.status(late.now_ns)["not_ready"] == "waiting for the first pose"
    late.peer.relays = True
    late.fly(2.0)
    assert late.mode in (FlightMode.TAKE_OFF, FlightMode.FLYING)


def test_without_motion_capture_arming_does_not_wait_for_a_pose():
    loop = Loop(assignments=("onboard.pose_wait_s=2.0",)).fly(1.9)
    assert loop.mode is FlightMode.BOOT
    loop.fly(1.0)
    assert loop.mode in (FlightMode.TAKE_OFF, FlightMode.FLYING)


def test_a_lost_pose_stream_does_not_end_the_flight_in_simulation():
    loop = in_flight("mrac")
    loop.peer.relays = False
    loop.fly(2.5)
    assert loop.mode is FlightMode.FLYING
    assert loop.peer.statuses[-1].pose_age_ms > 2000
    assert loop.vehicle.crash_reason == ""


@pytest.mark.parametrize("seed", [3, 10])
def test_without_the_pose_for_12_s_it_drifts_little_on_flow_and_range(seed):
    loop = Loop("mrac", peer=Peer(), assignments=(f"seed={seed}", "onboard.guidance.land_after_s=30")).fly(5.0)
    loop.peer.relays, start = False, loop.tick
    loop.fly(12.0)
    assert loop.mode is FlightMode.FLYING
    away = (loop.vector("position") - np.array(loop.truths)[:, :3])[start:, :2]
    assert np.linalg.norm(away, axis=1).max() < 0.5  # 2 m are allowed


# --- reports ---------------------------------------------------------------------------------------------------------


def test_status_and_samples_flow_at_their_rates():
    loop = in_flight("mrac")
    assert 47 <= len(loop.peer.statuses) <= 51
    last = loop.peer.statuses[-1]
    assert last.mode == FlightMode.FLYING
    assert last.ticks > 950
    assert last.lost == 0
    assert 0 <= last.pose_age_ms <= 20
    adapting = loop.column("adapting").sum() * PERIOD_NS * 1e-9
    samples = sum(batch.signals.shape[0] for batch in loop.peer.batches)
    assert samples == pytest.approx(50.0 * adapting, abs=10)


def test_the_peers_clock_is_logged_once_a_second():
    loop = in_flight("mrac")
    times_ns, offsets, round_trips = np.array(loop.offsets).T
    assert 4 <= len(times_ns) <= 5
    assert np.diff(times_ns).tolist() == [1e9] * (len(times_ns) - 1)
    assert (np.abs(offsets - CLOCK_NS) <= round_trips / 2).all()
    assert (round_trips <= 2 * PERIOD_NS).all()
    assert Loop().fly(1.5).offsets == []  # without a peer there is nothing to log


def test_nothing_is_learnt_on_the_ground():
    loop = in_flight("mrac")
    adapting, down = loop.column("adapting"), loop.column("position_d")
    climbed = down[loop.column("mode") == FlightMode.TAKE_OFF][0] - down
    assert not adapting[climbed < ADAPT_CLIMB_M - 0.01].any()
    assert adapting[climbed > ADAPT_CLIMB_M + 0.01].all()
    on_ground = adapting == 0
    assert loop.column("position_weight_norm")[on_ground].max() == 0.0


def test_the_actuator_model_keeps_step_with_the_vehicle():
    """Same command, same tick: the two thrusts agree but for the battery's share."""
    loop = in_flight("mrac")
    believed = np.stack([loop.column(f"motor_thrust_{i}") for i in "1234"], axis=1)[600:]
    first = TRUTH.names.index("motor_thrust_1")
    true = np.array([truth[first : first + 4] for truth in loop.truths])[600:]
    believed, true = believed - believed.mean(axis=0), true - true.mean(axis=0)
    lags = {
        shift: np.corrcoef(np.roll(believed, shift, axis=0)[5:-5].ravel(), true[5:-5].ravel())[0, 1]
        for shift in (-1, 0, 1)
    }
    assert max(lags, key=lags.get) == 0
    assert lags[0] > 0.95
