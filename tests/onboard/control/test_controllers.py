"""Every controller: that it flies, that it does what its law says, and that others plug in by a config entry."""

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from configs.loader import ConfigError, fill
from experiments.flights.lockstep_flight import build
from experiments.flights.scenario import Choices, resolve
from onboard.control.features import random_channel
from onboard.control.interface import ControllerConfig
from onboard.control.laws.last_layer import AdaptationConfig
from onboard.control.records import Target
from onboard.flight.path_turn import STEP_S, path_turn
from onboard.flight.supervisor import FlightMode
from onboard.flight.trajectory import PathPoint
from onboard.record.tick import OFFSET
from protocol.feature_set import FeatureSet
from protocol.signals import SIGNAL_INDEX
from tests.onboard.control.fixture import (
    AIRFRAME,
    DT,
    FEATURES,
    FORCE,
    RANDOM_START,
    TORQUE,
    Rig,
    column,
    controller_tree,
    shipped_controller,
)

BUILT_IN = ("none", "pid", "bias", "mrac", "dmrac", "l1", "indi", "repetitive", "ilc")
NO_TRAINING = "offboard.trainer.minimum_samples=1000000"
ROOT = Path(__file__).parents[3]
DOCUMENT = ROOT / "docs" / "control.md"
SHIPPED = sorted(path.stem for path in (ROOT / "configs" / "controllers").glob("*.yaml"))


# --- in lockstep -----------------------------------------------------------------------------------------------------


def fly_in_lockstep(controller: str, seconds: float, *assignments: str) -> tuple[str, Any, Any]:
    """Crash reason, ticks [n, fields] and truths [n, fields] of a hover with the whole loop."""
    choices = Choices(controller, 3, None, (NO_TRAINING, *assignments))
    config = resolve("hover", choices)
    lockstep, *_ = build(config)
    ticks, truths = [], []
    for _ in range(round(seconds / DT)):
        result = lockstep.step()
        ticks.append(result.onboard.tick.copy())
        truths.append(np.array(result.truth))
        if lockstep.crash_reason:
            break
    return lockstep.crash_reason, np.array(ticks), np.array(truths)


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_controller_hovers(name: str) -> None:
    crash, ticks, truths = fly_in_lockstep(name, 8.0)
    assert crash == ""
    assert ticks[-1][OFFSET["mode"]] == FlightMode.FLYING
    error = truths[-200:, :3] - ticks[-200:, OFFSET["target_n"] : OFFSET["target_n"] + 3]
    assert np.abs(error).max() < 0.15
    assert truths[-1, 2] < -0.8


def test_none_of_the_built_in_controllers_is_missing() -> None:
    assert set(BUILT_IN) <= set(SHIPPED)


# --- controllers from outside ----------------------------------------------------------------------------------------


def documents_example() -> tuple[str, str]:
    """The Python and the YAML block of docs/control.md between its two marks."""
    part = DOCUMENT.read_text(encoding="utf-8").split("<!-- example begins -->")[1].split("<!-- example ends -->")[0]
    python, entry = (re.search(f"```{kind}\n(.*?)```", part, re.DOTALL) for kind in ("python", "yaml"))
    assert python is not None
    assert entry is not None
    return python.group(1), entry.group(1)


def test_the_documents_controller_plugs_in_by_a_config_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, entry = documents_example()
    tree = yaml.safe_load(entry)
    module, _, _ = tree["class"].partition(":")
    (tmp_path / f"{module}.py").write_text(code, encoding="utf-8")
    file = tmp_path / "toy.yaml"
    file.write_text(entry, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    crash, ticks, truths = fly_in_lockstep(str(file), 7.0)
    assert crash == ""
    assert ticks[-1][OFFSET["mode"]] == FlightMode.FLYING
    error = truths[-100:, :3] - ticks[-100:, OFFSET["target_n"] : OFFSET["target_n"] + 3]
    assert np.abs(error).max() < 0.4
    with pytest.raises(ConfigError, match=r"controller\.settings"):
        resolve("hover", Choices(str(file), assignments=("onboard.controller.settings.no_such_gain=1",)))


@pytest.mark.parametrize(
    ("path", "what"),
    [
        ("no_such_module:Thing", "cannot be loaded"),
        ("onboard.control.cascade:NoSuchClass", "cannot be loaded"),
        ("onboard.control.mixer:Mixer", "has no Settings"),
        ("not a path", "class"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused_with_its_place(path: str, what: str) -> None:
    with pytest.raises(ConfigError, match=what) as fault:
        fill(ControllerConfig, {"class": path, "settings": {}}, "toy.yaml").build(AIRFRAME, FEATURES, 1, "toy.yaml")
    assert "toy.yaml" in str(fault.value)


# --- constant disturbances -------------------------------------------------------------------------------------------


def test_the_mean_reversion_leaves_little_of_a_constant_disturbance() -> None:
    """b lets go of it at s_b while W takes it over; then s_w against the gain of W is left, about 6 %
    with the constant feature alone.
    """
    rows = Rig(shipped_controller("dmrac"), FORCE, TORQUE).fly(14.0)
    np.testing.assert_allclose(rows[-1]["position"], (0.0, 0.0, -1.0), atol=3e-3)
    np.testing.assert_allclose(rows[-1]["position_nu"], FORCE, rtol=0.08)
    np.testing.assert_allclose(rows[-1]["attitude_nu"], TORQUE, rtol=0.06)


@pytest.mark.parametrize("name", ["pid", "bias", "mrac", "indi", "repetitive", "ilc"])
def test_a_constant_disturbance_is_cancelled(name: str) -> None:
    rows = Rig(shipped_controller(name), FORCE, TORQUE).fly(8.0)
    np.testing.assert_allclose(rows[-1]["position"], (0.0, 0.0, -1.0), atol=2e-3)
    np.testing.assert_allclose(rows[-1]["position_nu"], FORCE, atol=0.01)
    np.testing.assert_allclose(rows[-1]["attitude_nu"], TORQUE, atol=0.05)


def test_without_augmentation_it_is_not() -> None:
    rows = Rig(shipped_controller("none"), FORCE, TORQUE).fly(4.0)
    assert np.linalg.norm(rows[-1]["position"] - (0.0, 0.0, -1.0)) > 0.03


@pytest.mark.parametrize("pole", [10.0, 50.0])
def test_l1_converges_to_the_share_its_sampled_law_allows(pole: float) -> None:
    """Published as such: sigma_hat = a T / (e^(a T) - 1) Delta at rest, which the choice of the pole a decides."""
    over = {"position": {"augmentation": {"predictor_pole_rad_s": pole}}}
    rows = Rig(shipped_controller("l1", over), FORCE).fly(4.0)
    share = pole * DT / np.expm1(pole * DT)
    np.testing.assert_allclose(rows[-1]["position_nu"], share * np.array(FORCE), rtol=2e-3)


# --- jumps, look-ahead, level, reset ---------------------------------------------------------------------------------


def jump(told: bool, yaw: float = 0.0) -> Any:
    rig = Rig(shipped_controller("mrac"), FORCE)
    rig.fly(2.0)
    before = rig.output.position.error.copy()
    rig.jump = np.array([0.3, -0.2, 0.1])
    rig.target = rig.target + rig.jump
    if told:
        rig.state.position_reset_count += 1
        rig.state.position_jump[:] = rig.jump
        rig.state.yaw_jump = yaw
    rig.fly(DT)
    return rig.output.position.error - before


def test_a_jump_of_the_estimate_is_no_error() -> None:
    assert np.abs(jump(True)).max() < 1e-3
    assert np.abs(jump(False)[:3]).max() > 0.29


def test_a_turned_frame_starts_the_references_anew() -> None:
    assert np.abs(jump(True, yaw=0.3)).max() < 1e-3


@pytest.mark.parametrize(("channel", "lead"), [(0, "ahead"), (1, "attitude_ahead")])
def test_each_channel_looks_ahead_in_position_velocity_and_body_velocity(channel: int, lead: str) -> None:
    controller = shipped_controller("mrac")
    rig = Rig(controller)
    rig.attitude = rig.attitude * type(rig.attitude).from_euler("Z", np.pi / 2)
    rig.yaw = np.pi / 2
    inputs = rig.inputs()
    ahead = inputs.target.now._replace(position=(0.2, 0.0, -1.0), velocity=(1.0, 0.0, 0.0))
    controller.step(dataclasses.replace(inputs, target=inputs.target._replace(**{lead: ahead})))
    other = controller._channels[1 - channel].signals
    np.testing.assert_array_equal(other[:, 0], other[:, 1])
    now, then = controller._channels[channel].signals.T
    np.testing.assert_array_equal(now, inputs.signals)
    moved = then - now
    expected = {"position_n": 0.2, "velocity_n": 1.0, "body_velocity_y": -1.0}
    for name, index in SIGNAL_INDEX.items():
        assert moved[index] == pytest.approx(expected.get(name, 0.0), abs=1e-12), name


def test_level_only_sinks_slowly_and_leaves_the_position_alone() -> None:
    rig = Rig(shipped_controller("pid"))
    rig.target = np.array([5.0, 5.0, -3.0])
    rig.level_only, rig.adapt = True, False
    rows = rig.fly(3.0)
    assert rows[-1]["velocity"][2] == pytest.approx(0.4, abs=0.02)
    np.testing.assert_allclose(rows[-1]["position"][:2], 0.0, atol=1e-9)


def demand_at(target: Any, feed_forward: Any = (0.0, 0.0, 0.0), yaw: float = 0.0) -> tuple[Any, Any]:
    """Demands u of both channels from rest one metre up."""
    rig = Rig(shipped_controller("none"))
    rig.target, rig.yaw = np.array(target), yaw
    inputs = rig.inputs()
    output = rig.controller.step(dataclasses.replace(inputs, target=inputs.target._replace(feed_forward=feed_forward)))
    return output.position.demand.copy(), output.attitude.demand.copy()


def test_a_far_target_asks_for_no_more_than_a_near_one() -> None:
    np.testing.assert_array_equal(demand_at((50.0, -50.0, -60.0))[0], demand_at((1.5, -1.5, -2.5))[0])
    np.testing.assert_allclose(demand_at((0.5, -1.0, -1.2))[0], (16 * 0.5, -16 * 1.0, -25 * 0.2))


def test_the_feed_forward_is_added_as_it_is() -> None:
    np.testing.assert_allclose(demand_at((0.0, 0.0, -1.0), (0.3, -0.2, 0.1))[0], (0.3, -0.2, 0.1))


SWING_M, SWING_RAD_S = np.array([0.3, 0.4, 0.0]), 2.5


def swing(t: float) -> PathPoint:
    place, speed = SWING_M * np.sin(SWING_RAD_S * t), SWING_M * SWING_RAD_S * np.cos(SWING_RAD_S * t)
    return PathPoint(tuple(place - (0.0, 0.0, 1.0)), tuple(speed), tuple(-(SWING_RAD_S**2) * place))


def swing_target(t: float) -> Target:
    lead_s = 0.01  # the command's way to the motors
    now, about = swing(t), [swing(t + lead_s + step).acceleration for step in (-STEP_S, 0.0, STEP_S)]
    return Target(now, about[1], now, now, 0.0, now, path_turn(*about))


def error_on_a_swing(share: float) -> float:
    """RMS error along a swing, m, of a perfectly known vehicle with this share of the path's turn."""
    rig = Rig(shipped_controller("none", {"path_turn": share}))
    rig.velocity = SWING_M * SWING_RAD_S
    flown = column(rig.fly(8.0, swing_target), "position")
    wanted = np.array([swing(tick * DT).position for tick in range(len(flown))])
    return float(np.sqrt(np.mean(np.square(flown - wanted)[800:])))


def test_the_turn_of_the_path_is_flown_without_an_error_of_the_attitude() -> None:
    """Without it the attitude follows 1 - (1 + T_c K_2) s^2 / K_1 of its command (docs/control.md)."""
    assert error_on_a_swing(1.0) < 0.35 * error_on_a_swing(0.0)


def test_a_great_yaw_error_is_turned_gently() -> None:
    assert demand_at((0.0, 0.0, -1.0), yaw=3.0)[1][2] == pytest.approx(25.0 * 0.5)
    assert demand_at((0.0, 0.0, -1.0), yaw=0.2)[1][2] == pytest.approx(25.0 * 0.2)


def test_an_attitude_error_beyond_the_linear_range_starts_the_reference_anew() -> None:
    def error_after_a_turn(angle: float) -> Any:
        rig = Rig(shipped_controller("none"))
        rig.fly(0.1)
        rig.attitude = rig.attitude * type(rig.attitude).from_euler("Z", angle)
        rig.fly(DT)
        return rig.output.attitude.error

    assert np.abs(error_after_a_turn(0.5)[2]) == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_array_equal(error_after_a_turn(0.7), 0.0)


@pytest.mark.parametrize("name", BUILT_IN)
def test_nothing_adapts_while_it_must_hold_still(name: str) -> None:
    rig = Rig(shipped_controller(name), FORCE, TORQUE)
    rig.adapt = False
    rows = rig.fly(0.5)
    assert np.abs(column(rows, "position_nu")).max() == 0.0
    assert np.abs(column(rows, "position_e")).max() == 0.0


@pytest.mark.parametrize("name", ["pid", "l1", "indi", "repetitive", "ilc"])
def test_reset_forgets_integrals_and_filters(name: str) -> None:
    rig = Rig(shipped_controller(name), FORCE, TORQUE)
    rig.fly(1.0)
    assert np.abs(rig.output.position.adaptive).max() > 0.1
    inputs = rig.inputs()
    rig.controller.reset(inputs)
    output = rig.controller.step(dataclasses.replace(inputs, adapt=False))
    assert np.abs(output.position.adaptive).max() == 0.0


def test_reset_keeps_what_was_learnt() -> None:
    rig = Rig(shipped_controller("mrac"), FORCE)
    rig.fly(2.0)
    inputs = rig.inputs()
    rig.controller.reset(inputs)
    output = rig.controller.step(dataclasses.replace(inputs, adapt=False))
    np.testing.assert_allclose(output.position.adaptive, FORCE, atol=0.05)


@pytest.mark.parametrize("name", BUILT_IN)
def test_every_controller_reports_nu_ad_of_the_present(name: str) -> None:
    """At rest there is nothing to look ahead to: both nu_ad agree, in whatever controller."""
    rig = Rig(shipped_controller(name), FORCE, TORQUE)
    rig.fly(2.0)
    for channel in (rig.output.position, rig.output.attitude):
        np.testing.assert_allclose(channel.adaptive_now, channel.adaptive, atol=1e-4)


# --- taking features -------------------------------------------------------------------------------------------------


def feature_set(gain: tuple[float, float] = (1.0, 1.0)) -> FeatureSet:
    rng = np.random.default_rng(4)
    channels = []
    for scale in gain:
        start = random_channel(("position_n", "velocity_e"), np.zeros(2), np.ones(2), (8, 5), rng)
        weights = tuple(scale * W for W in start.weights)
        channels.append(dataclasses.replace(start, weights=weights, last_layer=0.1 * rng.normal(size=(6, 3))))
    return FeatureSet(1, 0, 10, channels[0], channels[1])


def test_features_are_taken_by_both_channels_or_by_none() -> None:
    rig = Rig(shipped_controller("dmrac"), FORCE, TORQUE)
    rig.fly(2.0)
    augmentations = rig.controller.augmentations
    before = [(a.features, a.last_layer.W.copy()) for a in augmentations]
    assert rig.controller.offer_features(feature_set((1.0, 1000.0))) == "lipschitz"
    for augmentation, (features, W) in zip(augmentations, before, strict=True):
        assert augmentation.features is features
        np.testing.assert_array_equal(augmentation.last_layer.W, W)
    assert rig.controller.offer_features(feature_set()) == ""
    assert all(a.features is not features for a, (features, _) in zip(augmentations, before, strict=True))
    rows = rig.fly(1.0)
    assert np.linalg.norm(column(rows, "position") - (0.0, 0.0, -1.0), axis=1).max() < 0.02


def test_features_that_fly_already_are_not_swapped() -> None:
    """A swap would forget what the law knows: S starts again from the last second."""
    rig = Rig(shipped_controller("dmrac"), FORCE, TORQUE)
    rig.fly(1.0)
    assert rig.controller.offer_features(feature_set()) == ""
    rig.fly(1.0)
    before = [(a.features, a.last_layer.state.S.copy()) for a in rig.controller.augmentations]
    assert rig.controller.offer_features(feature_set()) == ""
    for augmentation, (features, S) in zip(rig.controller.augmentations, before, strict=True):
        assert augmentation.features is features
        np.testing.assert_array_equal(augmentation.last_layer.state.S, S)


@pytest.mark.parametrize("name", ["pid", "mrac", "bias", "l1"])
def test_controllers_without_learnt_features_refuse_them(name: str) -> None:
    assert shipped_controller(name).offer_features(feature_set()) == "not_accepting"


def test_a_swap_in_flight_does_not_kick_the_vehicle() -> None:
    def kick(naive: bool) -> float:
        # Little in the bias, much in the features: what a naive swap would throw away.
        law = {"fast_bias": 0.05, "prior": 2.0}
        swap = {"augmentation": {"swap": {"naive": naive, "jump_max": 1e6}, "law": law}}
        settings = {"position": swap, "attitude": swap}
        rig = Rig(shipped_controller("dmrac", settings, RANDOM_START), FORCE, TORQUE)
        rig.fly(2.0)
        start = random_channel(
            ("position_n", "velocity_e"), np.zeros(2), np.ones(2), (32, 32, 19), np.random.default_rng(9)
        )
        assert rig.controller.offer_features(FeatureSet(1, 0, 10, start, start)) == ""
        return float(np.abs(column(rig.fly(1.0), "position") - (0.0, 0.0, -1.0)).max())

    # theta_n is zero here, the worst memory there is: all it costs is the pull of mu.
    assert kick(False) < 0.4 * kick(True)


def test_equal_seeds_make_equal_controllers() -> None:
    config = fill(ControllerConfig, controller_tree("dmrac"), "t")
    one, other, third = (config.build(AIRFRAME, RANDOM_START, seed) for seed in (5, 5, 6))
    signals = np.random.default_rng(0).normal(size=(21, 2))
    features = [c.augmentations[0].features for c in (one, other, third)]
    Phi = [f.evaluate(f.select(signals)) for f in features]
    np.testing.assert_array_equal(Phi[0], Phi[1])
    assert np.abs(Phi[0] - Phi[2]).max() > 0.01


def test_settings_out_of_range_name_their_path() -> None:
    tree = controller_tree("mrac", {"position": {"augmentation": {"law": {"composite_gain": -1.0}}}})
    with pytest.raises(ConfigError, match=r"controller\.settings\.position\.augmentation\..*composite_gain"):
        fill(ControllerConfig, tree, "mrac.yaml").build(AIRFRAME, FEATURES, 1)
    with pytest.raises(ValueError, match="weight_norm_max"):
        AdaptationConfig(tracking_gain=1.0, composite_gain=1.0, bias_weight=1.0, leak=0.0, weight_norm_max=0.0)
