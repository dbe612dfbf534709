"""The whole core: flights with the C core beside numpy's on the same datagrams, and flights of the C core alone."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from configs.loader import ConfigError
from experiments.flights.lockstep_flight import build, fly_lockstep
from experiments.flights.metrics import flight_metrics
from experiments.flights.scenario import Choices, resolve
from onboard.c import compiled_core
from onboard.c.compile import BuildError, Variant
from onboard.c.compiled_core import CompiledCore
from onboard.core import OnboardCore
from onboard.flight.modes import FlightMode
from onboard.record.tick import OFFSET
from protocol.keys import LinkKeys, write_key
from protocol.transfer import split
from tests.onboard.c.parity import SANITIZED
from tests.onboard.c.shadow_core import ShadowCore
from tests.onboard.loop import Loop, Peer
from tests.onboard.test_core import JumpingPeer, is_no_flow
from tests.onboard.test_core_features import features
from tests.onboard.test_faults_in_flight import is_imu, rewrite
from tests.onboard.test_missed_ticks import StallingCore

CONTROLLERS = ("none", "pid", "l1", "indi", "repetitive", "ilc", "bias", "mrac", "paper_dmrac", "dmrac")
BRIEF = ("pid", "dmrac")
LEARNING = (
    "offboard.trainer.minimum_samples=100",
    "onboard.guidance.trajectory.settle_s=0.0",
)
"""So that a short flight gets trained features."""
TARGET = slice(OFFSET["target_n"], OFFSET["target_n"] + 3)
MOTORS_MAX = 1e-9
"""Of full scale; 1e-13 were measured."""


def brief(name: str) -> Any:
    """A parameter of a test that is always run if it is one of BRIEF, else by scripts/test --full only."""
    return pytest.param(name, marks=() if name in BRIEF else pytest.mark.full)


@pytest.mark.parametrize("controller", [brief(name) for name in CONTROLLERS])
def test_a_whole_flight_beside_numpys(controller: str, variant: Variant) -> None:
    learns = controller in ("dmrac", "paper_dmrac")
    config = resolve("figure8_wind", Choices(controller, 3, 9.0 if SANITIZED else 12.0, LEARNING if learns else ()))
    lockstep, *_ = build(config)
    shadow = lockstep._onboard = ShadowCore(config.onboard, variant)
    for _ in range(round(config.duration_s * 200)):
        lockstep.step()
    assert not lockstep.crash_reason
    assert SANITIZED or shadow.summary()["mode"] == "BOOT"  # it has landed
    assert shadow.summary()["samples"]["taken"] > (100 if SANITIZED else 400)
    assert bool(shadow.summary()["features"]["swaps"]) == learns
    assert shadow.motor_difference < MOTORS_MAX
    shadow.compare_summaries()


def test_weak_motors_at_their_limit_beside_numpys(variant: Variant) -> None:
    """The limits of the mixer follow the estimated thrust."""
    weak = ("vehicle.motors.gain=[0.62, 0.62, 0.62, 0.62]", "vehicle.disturbances.0.speed_m_s=8.0")
    config = resolve("figure8_wind", Choices("pid", 3, 9.0, weak))
    lockstep, *_ = build(config)
    lockstep._onboard = ShadowCore(config.onboard, variant)
    for _ in range(round(config.duration_s * 200)):
        lockstep.step()


def test_a_flight_with_keys_beside_numpys(variant: Variant, tmp_path: Path) -> None:
    keys = [bytes([number] * 32) for number in (1, 2, 3)]
    names = ("key_file", "vehicle_key_file", "ground_key_file")
    for name, key in zip(names, keys, strict=True):
        write_key(tmp_path / name, key)
    assignments = [f"network.{name}={tmp_path / name}" for name in names]
    config = resolve("figure8_wind", Choices("l1", 3, 6.0, assignments))
    lockstep, *_ = build(config)
    shadow = lockstep._onboard = ShadowCore(config.onboard, variant, LinkKeys(*keys))
    for _ in range(round(config.duration_s * 200)):
        lockstep.step()
    assert shadow.summary()["samples"]["taken"] > 100
    assert shadow.summary()["estimator"]["pose_used"] > 100
    shadow.compare_summaries()


# --- what happens in flights ---


class ShadowLoop(Loop):
    """A loop whose core is the pair."""

    def __init__(self, variant: Variant, controller: str = "pid", **given: Any) -> None:
        super().__init__(controller, **given)
        self.core = ShadowCore(self.config.onboard, variant)

    @property
    def modes(self) -> set[FlightMode]:
        return {FlightMode(int(mode)) for mode in self.column("mode")}


Flight = Callable[[Variant], ShadowLoop]


def to_the_floor_and_up_again(variant: Variant) -> ShadowLoop:
    brief = ("onboard.guidance.land_after_s=2.0", "onboard.supervisor.landed_s=0.5")
    loop = ShadowLoop(variant, peer=Peer(), assignments=brief).fly(10.0)
    assert {FlightMode.LANDING, FlightMode.LANDED, FlightMode.BOOT} <= loop.modes
    return loop


def land_by_request(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, peer=Peer()).fly(4.0)
    loop.land = True
    loop.fly(0.5)
    assert FlightMode.LANDING in loop.modes
    return loop


def blind(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, peer=Peer()).fly(5.0)
    loop.peer.relays, loop.passes = False, is_no_flow
    loop.fly(3.0)
    assert FlightMode.HOLD_LEVEL in loop.modes
    loop.passes = None
    loop.fly(1.5)
    assert FlightMode.LANDING in loop.modes
    return loop


def a_jump_of_the_pose(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, "mrac", peer=JumpingPeer()).fly(5.0)
    loop.peer.jump = 1.0
    loop.fly(2.0)
    assert loop.said("position estimate jumped")
    return loop


def a_late_first_pose(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, "l1", peer=Peer())
    loop.peer.relays = False
    loop.fly(4.0)
    assert loop.said("not ready to arm: waiting for the first pose")
    loop.peer.relays = True
    loop.fly(2.0)
    assert FlightMode.TAKE_OFF in loop.modes
    return loop


def nan_from_the_imu(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, assignments=("onboard.pose_wait_s=0.5",)).fly(4.0)
    loop.fault = lambda t, frames: [rewrite(one, ygyro=float("nan")) for one in frames]
    loop.fly(0.5)
    assert FlightMode.EMERGENCY in loop.modes
    return loop


def a_stuck_gyroscope(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, peer=Peer()).fly(4.0)
    loop.fault = lambda t, frames: [rewrite(one, xgyro=0.01) if is_imu(one) else one for one in frames]
    loop.fly(1.0)
    assert loop.said("gyroscope x stuck")
    return loop


def missed_ticks(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, "mrac", scenario="figure8_calm", peer=Peer())
    shadow, loop.core = loop.core, StallingCore(loop.core, 10, tells=True)
    loop.fly(5.0)
    assert loop.core._missed > 50
    loop.core = shadow
    return loop


def versions_for_a_controller_without_networks(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, peer=Peer()).fly(1.0)
    loop.peer.sender.offer(features(), loop.now_ns)
    loop.fly(0.5)
    assert loop.said("features 1 refused: not_accepting")
    loop.join(Peer(session=3))
    loop.fly(0.5)
    assert loop.said("offboard restarted")
    assert loop.peer.statuses[-1].refused_version == 0
    return loop


BY_HAND = ("onboard.supervisor.auto_arm=false", "onboard.supervisor.ground_silent_s=3.0")
ARM, TAKE_OFF, LAND = (
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
    mavlink.MAV_CMD_NAV_TAKEOFF,
    mavlink.MAV_CMD_NAV_LAND,
)


def send(loop: ShadowLoop, number: int, *parameters: float, confirmation: int = 0) -> None:
    """A command of a ground station, and a datagram that is none."""
    values = (*parameters, *([0.0] * (7 - len(parameters))))
    message = mavlink.MAVLink_command_long_message(1, 1, number, confirmation, *values)
    loop.from_ground += [bytes(message.pack(mavlink.MAVLink(None, 255, 190))), b"no command"]


def a_pilot(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, peer=Peer(), assignments=BY_HAND)
    send(loop, ARM, 1.0)
    loop.fly(3.0)
    send(loop, TAKE_OFF)
    loop.fly(0.1)
    send(loop, ARM, 1.0)
    send(loop, ARM, 1.0, confirmation=1)
    loop.fly(0.5)
    send(loop, TAKE_OFF)
    send(loop, LAND, confirmation=1)
    loop.fly(2.0)
    send(loop, ARM, 0.0, 21196.0)
    loop.fly(0.3)
    assert loop.said("refused to arm")
    assert loop.said("refused to take off: not in mode READY")
    assert {FlightMode.ARMED, FlightMode.TAKE_OFF, FlightMode.TERMINATED} <= loop.modes
    return loop


def an_impatient_pilot(variant: Variant) -> ShadowLoop:
    """Arms in every tick: also in the one whose IMU sample ends the calibration."""
    loop = ShadowLoop(variant, peer=Peer(), assignments=BY_HAND)
    while not loop.rows or FlightMode.ARMED not in loop.modes:
        send(loop, ARM, 1.0)
        loop.step()
        assert loop.tick < 600
    assert loop.said("refused to arm: calibrating the IMU")
    assert loop.said("IMU calibrated")
    return loop


def fail(loop: ShadowLoop) -> None:
    """What a law that has been worse for too long looks like, in both cores."""
    loop.core.controller.guard._watches[0]._worse_s = 1.0
    loop.core.ours._core.controller.guard.watches[0].worse_s = 1.0


def versions_good_bad_and_taken_back(variant: Variant) -> ShadowLoop:
    loop = ShadowLoop(variant, "dmrac", peer=Peer()).fly(4.0)
    texts = ["features 1 in use", "features 2 refused: lipschitz", "features 3 refused: weight_norm"]
    for version in (features(1), features(2, gain=100.0), features(3, last_layer=100.0)):
        loop.peer.sender.offer(version, loop.now_ns)
        loop.fly(1.2)
    fail(loop)
    loop.fly(0.3)
    loop.waiting += split(b"no feature set" * 30, 4, 1000)
    loop.peer.sender.offer(features(5, last_layer=0.05), loop.now_ns)
    loop.fly(1.2)
    for _ in range(3):  # back to the start features, to the bias alone, to none
        fail(loop)
        loop.fly(0.3)
    texts += ["version 1 taken back, version 0 flies", "the bias alone flies", "no adaptation flies"]
    again = dataclasses.replace(features(1), version=6)
    loop.peer.sender.offer(again, loop.now_ns)
    loop.fly(0.3)
    assert all(loop.said(text) for text in (*texts, "features 6 refused: taken_back"))
    assert set(loop.column("law")) == {0.0, 1.0, 2.0}
    loop.join(Peer(session=3))
    loop.fly(0.3)
    return loop


ALWAYS: tuple[Flight, ...] = (
    land_by_request,
    missed_ticks,
    a_pilot,
    an_impatient_pilot,
    versions_good_bad_and_taken_back,
    nan_from_the_imu,
)
FULL: tuple[Flight, ...] = (
    *(to_the_floor_and_up_again, blind, a_jump_of_the_pose, a_late_first_pose, a_stuck_gyroscope),
    versions_for_a_controller_without_networks,
)


@pytest.mark.parametrize(
    "flight",
    [*ALWAYS, *(pytest.param(flight, marks=pytest.mark.full) for flight in FULL)],
    ids=lambda flight: flight.__name__,
)
def test_both_cores_do_the_same(flight: Flight, variant: Variant) -> None:
    flown = flight(variant)
    assert flown.core.motor_difference < MOTORS_MAX
    flown.core.compare_summaries()


# --- the C core alone ---


@pytest.mark.parametrize("controller", ["pid", "l1", "mrac", "dmrac"])
def test_a_flight_of_the_c_core_is_as_good(controller: str) -> None:
    config = resolve("figure8_wind", Choices(controller, 3, 12.0, LEARNING if controller == "dmrac" else ()))
    errors = []
    for core in ("numpy", "c"):
        outcome = fly_lockstep(config, core=core)
        assert not outcome.crash_reason
        metrics = flight_metrics(outcome.trace, config.onboard.guidance.trajectory)
        errors.append((metrics.position_rmse_m, metrics.attitude_rmse_rad))
    np.testing.assert_allclose(errors[1], errors[0], rtol=0.01)


@pytest.mark.parametrize(("controller", "rtol"), [("pid", 0.01), pytest.param("dmrac", 0.1, marks=pytest.mark.full)])
def test_the_core_in_float_flies_as_well(controller: str, rtol: float) -> None:
    """Learning on slightly other samples is another flight, so dmrac's errors are only alike."""
    config = resolve("figure8_wind", Choices(controller, 3, 14.0, LEARNING if controller == "dmrac" else ()))
    errors = []
    for real in ("double", "float"):
        lockstep, *_ = build(config)
        lockstep._onboard = CompiledCore(config.onboard, 1, None, variant=Variant(real))
        squares = []
        for _ in range(round(config.duration_s * 200)):
            step = lockstep.step()
            if step.onboard.tick[OFFSET["mode"]] == FlightMode.FLYING:
                off = step.truth[:3] - step.onboard.tick[TARGET]
                squares.append(float(off @ off))
        assert not lockstep.crash_reason
        assert bool(lockstep._onboard.summary()["features"]["swaps"]) == (controller == "dmrac")
        errors.append(np.sqrt(np.mean(squares)))
    assert errors[1] != errors[0]
    np.testing.assert_allclose(errors[1], errors[0], rtol=rtol)


def test_a_flight_of_the_c_core_repeats_to_the_bit() -> None:
    config = resolve("figure8_wind", Choices("mrac", 3, 6.0))
    one, other = (fly_lockstep(config, core="c").trace_sha256 for _ in range(2))
    assert one == other


def test_a_controller_starts_from_last_layers_and_gives_them_back(variant: Variant) -> None:
    config = resolve("figure8_wind", Choices("mrac"))
    controller = CompiledCore(config.onboard, 1, None, variant=variant).controller
    assert not controller.accepts_features
    assert controller.offer_features(features()) == "not_accepting"
    wanted = tuple(np.random.default_rng(i).normal(size=(21, 3)) for i in (0, 1))
    controller.start_from(wanted)
    np.testing.assert_allclose(controller.last_layers(), wanted)
    with pytest.raises(ValueError, match=r"last layer of shape \(20, 3\), this controller's is \(21, 3\)"):
        controller.start_from((wanted[0][1:], None))
    learning = CompiledCore(resolve("hover", Choices("dmrac")).onboard, 1, None, variant=variant).controller
    assert learning.accepts_features
    assert learning.offer_features(features(gain=100.0)) == "lipschitz"
    assert learning.offer_features(features()) == ""
    without = CompiledCore(resolve("hover", Choices("pid")).onboard, 1, None, variant=variant).controller
    without.start_from(wanted)
    assert without.last_layers() == (None, None)


# --- what it cannot do ---


def test_a_controller_of_ones_own_is_refused() -> None:
    config = resolve("hover", Choices("pid")).onboard
    own = config.controller.model_copy(update={"class_path": "my_package.my_module:MyController"})
    with pytest.raises(
        ConfigError, match=r"--core c: controller\.class: 'my_package.* is not in the C core, allowed is "
    ):
        CompiledCore(config.model_copy(update={"controller": own}), 1, None)


def test_a_bad_key_is_refused_as_by_numpys_core() -> None:
    config = resolve("hover", Choices("pid")).onboard
    for core in (OnboardCore, CompiledCore):
        with pytest.raises(ValueError, match="key of 3 bytes, allowed 16 to 64"):
            core(config, 1, b"key")


def test_without_a_compiler_the_error_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(variant: Variant) -> Any:
        raise BuildError("no C compiler (tried cc)")

    monkeypatch.setattr(compiled_core, "load", nothing)
    with pytest.raises(ConfigError, match=r"--core c: no C compiler \(tried cc\)"):
        CompiledCore(resolve("hover", Choices("pid")).onboard, 1, None)
