"""Each disturbance against its specification."""

from itertools import pairwise
from math import exp, log, pi, sqrt

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.signal import welch

import sim_vehicle.physics.layout as at
from configs.loader import ConfigError
from protocol.conventions import GRAVITY
from sim_vehicle.config import load_vehicle
from sim_vehicle.disturbances.cloth import Cloth
from sim_vehicle.disturbances.fan_jet import FanJet
from sim_vehicle.disturbances.gusts import Gusts
from sim_vehicle.disturbances.rotor_chip import chipped_rotors
from sim_vehicle.physics.compiled import compiled
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.records import TRUTH
from sim_vehicle.world.catalogue import AnyDisturbance
from sim_vehicle.world.world import NEVER_NS, World

COLUMN = {name: index for index, name in enumerate(TRUTH.names)}
DT = 0.001


P = pack_parameters(load_vehicle("mambo"))
blow, jet, flap = compiled(Gusts.act), compiled(FanJet.act), compiled(Cloth.act)


def world(*disturbances, seed=1):
    return World(load_vehicle("mambo", {"disturbances": list(disturbances)}), seed)


def gust_series(sigma, length, speed, count, seed=5):
    noise = np.random.default_rng(seed).standard_normal((count, 3))
    gust, values = sigma * np.random.default_rng(seed + 1).standard_normal(3), np.array([sigma, length, -1.0])
    series, state = np.zeros((count, at.EFFECT_SIZE)), np.zeros(at.STATE_SIZE)
    series[:, at.AIR_SPEED] = speed
    for k in range(count):
        blow(values, gust, 0.0, state, P, noise[k], series[k])
    return series[:, at.AIR : at.AIR + 3]


def test_gusts_have_their_sigma():
    series = gust_series(0.6, 0.5, 3.0, 150_000)  # 150 s: 900 correlation times per axis
    np.testing.assert_allclose(series.std(axis=0), 0.6, rtol=0.08)
    np.testing.assert_allclose(series.mean(axis=0), 0.0, atol=0.1)
    assert abs(np.corrcoef(series.T)[0, 1]) < 0.12


def test_gusts_have_a_first_order_spectrum():
    """One-sided density 4 sigma^2 tau / (1 + (2 pi f tau)^2), tau = L/V: within 10 % over a decade and a half."""
    sigma, length, speed = 0.6, 0.5, 3.0
    series = gust_series(sigma, length, speed, 200_000)
    frequency, density = welch(series, fs=1 / DT, nperseg=8192, axis=0)
    tau = length / speed
    expected = 4 * sigma**2 * tau / (1 + (2 * pi * frequency * tau) ** 2)
    for low, high in ((0.2, 0.6), (0.6, 2.0), (2.0, 6.0), (6.0, 20.0)):
        band = (frequency >= low) & (frequency < high)
        assert density[band].mean() == pytest.approx(expected[band].mean(), rel=0.12)


def test_gusts_do_not_depend_on_the_step():
    """The correlation over one step is exp(-V dt/L) at any speed, and gusts decorrelate in still air too."""
    series = gust_series(1.0, 0.05, 10.0, 100_000)
    assert np.mean(series[1:] * series[:-1]) == pytest.approx(exp(-10.0 * DT / 0.05), abs=0.03)
    still = gust_series(1.0, 0.01, 0.0, 50_000)
    assert np.mean(still[1:] * still[:-1]) == pytest.approx(exp(-0.2 * DT / 0.01), abs=0.05)


def test_jet_profile():
    row = world(
        {
            "kind": "fan_jet",
            "origin_ned_m": [1.0, 2.0, -1.0],
            "direction_ned": [0.0, 3.0, 0.0],
            "diameter_m": 0.4,
            "speed_m_s": 6.0,
        }
    ).rows[0, at.ROW_VALUES :]

    def speed(x, r):
        state, effect = np.array([1.0 + r, 2.0 + x, -1.0]), np.zeros(at.EFFECT_SIZE)
        jet(row, row, 0.0, state, P, row, effect)
        return effect[at.AIR + 1]

    assert speed(-0.01, 0.0) == 0.0
    assert speed(0.5, 0.0) == 6.0  # potential core
    assert speed(0.5, 0.2) == pytest.approx(3.0)  # half of it at the rim of the nozzle
    for x in (3.0, 5.0, 9.0):
        assert speed(x, 0.0) == pytest.approx(6.0 * 6.2 * 0.4 / x)
        assert speed(x, 0.11 * x) == pytest.approx(0.5 * speed(x, 0.0))
    r = np.linspace(0.0, 3.0, 3000)
    flux = [np.trapezoid(2 * pi * r * np.array([speed(x, ri) ** 2 for ri in r]), r) for x in (4.0, 8.0)]
    assert flux[0] == pytest.approx(flux[1], rel=1e-3)  # the momentum of a free jet is constant
    assert flux[0] == pytest.approx(36.0 * pi * 0.04, rel=0.4)  # about that at the nozzle


class HangingCloth:
    """A cloth on a frame that does not move."""

    def __init__(self, **values):
        self.row = world({"kind": "cloth", **values}).rows[0, at.ROW_VALUES :].copy()
        self.state, self.memory = np.zeros(at.STATE_SIZE), np.zeros(5)
        self.state[at.QUATERNION] = 1.0

    def step(self, noise=0.0):
        effect = np.zeros(at.EFFECT_SIZE)
        flap(self.row, self.memory, 0.0, self.state, P, np.array([noise]), effect)
        np.testing.assert_allclose(effect[at.TORQUE : at.TORQUE + 3], np.cross([0, 0, self.row[7]], effect[3:6]))
        return effect[at.FORCE : at.FORCE + 3]


def test_cloth_swings_at_its_pendulum_frequency():
    cloth = HangingCloth(length_m=0.075, damping_ratio=0.02)
    cloth.memory[0] = 0.01
    swing = np.empty(20_000)
    for k in range(len(swing)):
        cloth.step()
        swing[k] = cloth.memory[0]
    crossings = np.flatnonzero((swing[1:] > 0) & (swing[:-1] <= 0))
    frequency = (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * DT)
    assert frequency == pytest.approx(sqrt(GRAVITY / 0.075) / (2 * pi), rel=0.01)
    peaks = swing[:: round(1 / frequency / DT)]
    assert log(peaks[0] / peaks[5]) / 5 == pytest.approx(2 * pi * 0.02, rel=0.15)


@pytest.mark.parametrize(("wind", "frequency"), [(1.0, 4.0), (3.0, 6.0), (5.0, 10.0), (8.0, 12.0)])
def test_cloth_drag_and_flapping(wind, frequency):
    cloth = HangingCloth()
    cloth.state[at.WIND + 1] = wind
    force = np.array([cloth.step(n) for n in np.random.default_rng(2).standard_normal(40_000)])
    drag = 0.034 * (wind / 3) ** 2
    assert force[:, 1].mean() == pytest.approx(drag, rel=0.05)  # along the wind
    assert force[:, 1].std() == pytest.approx(0.8 * drag / sqrt(2), rel=0.05)
    assert force[:, 0].mean() == pytest.approx(0.0, abs=0.05 * drag)  # across it
    assert force[:, 0].std() == pytest.approx(0.4 * drag / sqrt(2), rel=0.05)
    f, density = welch(force[:, 1] - force[:, 1].mean(), fs=1 / DT, nperseg=8192)
    assert f[np.argmax(density)] == pytest.approx(frequency, abs=0.4)
    near = np.abs(f - frequency) < 1.5
    assert density[near].sum() > 0.75 * density.sum()  # narrow-band
    np.testing.assert_allclose(force[:, 2], 0.0013 * GRAVITY)


def test_cloth_pulls_back_on_a_vehicle_that_accelerates():
    cloth = HangingCloth(damping_ratio=1.0)
    cloth.state[at.ACCELERATION] = 2.0
    for _ in range(3000):
        force = cloth.step()
    assert force[0] == pytest.approx(-0.0013 * 2.0, rel=1e-3)
    assert cloth.memory[0] == pytest.approx(-2.0 / (GRAVITY / 0.075), rel=1e-3)


def test_rotor_chip_begins_and_ends(vehicle, motors):
    chip = {"kind": "rotor_chip", "rotor": 3, "thrust_factor": 0.7, "onset_s": 0.25, "end_s": 0.5}
    heavy = {"initial": {"position_ned_m": [0, 0, -5]}, "body": {"inertia_kg_m2": [0.1, 0.1, 0.1]}}
    chipped, intact = vehicle(heavy | {"disturbances": [chip]}), vehicle(heavy)
    ratio = []
    for k in range(150):
        for each in (chipped, intact):
            each.receive(motors([0.5] * 4), k * 5_000_000)
        truth = [each.step((k + 1) * 5_000_000).truth for each in (chipped, intact)]
        ratio.append(truth[0][COLUMN["motor_thrust_3"]] / truth[1][COLUMN["motor_thrust_3"]])
        assert truth[0][COLUMN["motor_thrust_1"]] == pytest.approx(truth[1][COLUMN["motor_thrust_1"]], rel=0.02)
    np.testing.assert_allclose(ratio[:49], 1.0, rtol=1e-12)
    np.testing.assert_allclose(ratio[50:99], 0.7, rtol=0.02)  # the voltage differs a little
    np.testing.assert_allclose(ratio[100:], 1.0, rtol=0.02)


def test_chip_torque_and_shaking_grow_with_severity():
    factors = (0.95, 0.865, 0.76, 0.67)
    worlds = [world({"kind": "rotor_chip", "rotor": 2, "thrust_factor": f, "mount_transmission": 0.1}) for f in factors]
    shaking = [made.condition.shaking[1] for made in worlds]
    assert all(np.all(more > less) for less, more in pairwise(shaking))
    np.testing.assert_allclose([s[0] for s in shaking[1:]], [3.1, 5.8, 8.2])
    assert shaking[2][1] == pytest.approx(0.15, rel=0.01)
    for factor, made in zip(factors, worlds, strict=True):
        assert 0.9 * factor < made.condition.parameters[at.TORQUE_FACTOR + 1] < factor
        assert made.condition.parameters[at.THRUST_FACTOR + 1] == factor
        assert made.condition.parameters[at.THRUST_FACTOR] == 1.0


def test_random_rotor_is_drawn_from_the_seed():
    config = load_vehicle("mambo", {"disturbances": [{"kind": "rotor_chip", "thrust_factor": 0.8}]})
    drawn = [chipped_rotors(World(config, seed).disturbances)[0] for seed in range(200)]
    assert drawn == [chipped_rotors(World(config, seed).disturbances)[0] for seed in range(200)]
    assert all(30 < drawn.count(rotor) < 75 for rotor in (1, 2, 3, 4))


def test_motor_gain():
    config = load_vehicle("mambo", {"disturbances": [{"kind": "motor_gain", "common": 0.75, "spread": 0.1}]})
    worlds = [World(config, seed) for seed in range(300)]
    gains = np.array([made.condition.parameters[at.GAIN : at.GAIN + 4] for made in worlds])
    assert gains.min() > 0.75 * 0.9
    assert gains.max() < 0.75 * 1.1
    np.testing.assert_allclose(gains.mean(axis=0), 0.75, atol=0.01)
    assert gains.std() == pytest.approx(0.75 * 0.1 / sqrt(3), rel=0.1)


def test_payload_begins_and_ends():
    made = world({"kind": "payload", "mass_kg": 0.01, "offset_m": [0.02, 0, 0], "onset_s": 0.1, "end_s": 0.2})
    bare = made.condition.parameters.copy()
    assert made.next_event_ns == 100_000_000
    made.apply(100_000_000)
    assert made.condition.parameters[at.MASS] == pytest.approx(0.073)
    assert made.condition.parameters[at.CENTRE] == pytest.approx(0.01 * 0.02 / 0.073)
    made.apply(200_000_000)
    np.testing.assert_array_equal(made.condition.parameters, bare)
    assert made.next_event_ns == NEVER_NS


def test_disturbances_add_up(vehicle):
    flying = vehicle(
        {
            "disturbances": [
                {"kind": "wind", "velocity_ned_m_s": [1.0, 0.0, 0.0]},
                {"kind": "wind", "velocity_ned_m_s": [0.5, 2.0, 0.0], "onset_s": 0.02, "end_s": 0.03},
                {
                    "kind": "fan_jet",
                    "origin_ned_m": [0, 1, -5],
                    "direction_ned": [0, -1, 0],
                    "diameter_m": 1,
                    "speed_m_s": 3,
                },
            ],
            "initial": {"position_ned_m": [0, 0, -5]},
        }
    )
    winds = [flying.step(k * 5_000_000).truth[COLUMN["wind_n"] : COLUMN["wind_d"] + 1] for k in range(1, 9)]
    np.testing.assert_allclose(winds[3], [1.0, -3.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(winds[4], [1.5, -1.0, 0.0], atol=1e-3)
    np.testing.assert_allclose(winds[6], [1.0, -3.0, 0.0], atol=1e-3)


def test_battery_sag_reduces_thrust(vehicle, motors):
    sag = {"kind": "battery_sag", "drop_v": 0.4, "time_constant_s": 0.2, "onset_s": 0.1}
    start = {"position_ned_m": [0, 0, -5]}
    weak, good = vehicle({"disturbances": [sag], "initial": start}), vehicle({"initial": start})
    for k in range(300):
        for each in (weak, good):
            each.receive(motors([0.4] * 4), k * 5_000_000)
        truth = [each.step((k + 1) * 5_000_000).truth for each in (weak, good)]
        if k == 19:
            assert truth[0][COLUMN["battery_voltage"]] == truth[1][COLUMN["battery_voltage"]]
    v0, v1 = (each[COLUMN["battery_voltage"]] for each in truth)
    assert 0.3 < v1 - v0 < 0.4  # less current flows, so the drop over the resistance of the cell is smaller
    assert truth[0][COLUMN["motor_thrust_1"]] / truth[1][COLUMN["motor_thrust_1"]] == pytest.approx(
        (v0 / v1) ** 2, rel=1e-3
    )


def test_a_disturbance_does_not_change_the_draws_of_another():
    chip, gain = {"kind": "rotor_chip", "thrust_factor": 0.8}, {"kind": "motor_gain"}
    alone = world(chip, seed=7)
    both = world(chip, gain, seed=7)
    assert chipped_rotors(alone.disturbances) == chipped_rotors(both.disturbances)


@pytest.mark.parametrize(
    ("block", "fault"),
    [
        ({"kind": "storm"}, "storm"),
        ({"kind": "wind", "velocity_ned_m_s": [1, 0, 0], "speed": 3}, "speed"),
        ({"kind": "rotor_chip", "thrust_factor": 1.2}, "thrust_factor"),
        ({"kind": "rotor_chip", "thrust_factor": 0.5, "rotor": 5}, "rotor"),
        ({"kind": "cloth", "onset_s": 3.0, "end_s": 2.0}, "not after onset_s"),
        (
            {"kind": "fan_jet", "origin_ned_m": [0, 0, 0], "direction_ned": [0, 0, 0], "diameter_m": 1, "speed_m_s": 1},
            "no length",
        ),
        ({"kind": "gusts", "sigma_m_s": 0.1, "length_scale_m": 0.0}, "length_scale_m"),
    ],
)
def test_bad_settings_are_named(block, fault):
    with pytest.raises(ConfigError, match=fault):
        load_vehicle("mambo", {"disturbances": [block]})


@pytest.mark.parametrize("kind", ["cloth", "motor_gain", "battery_sag"])
def test_kinds_with_defaults_only(kind):
    assert TypeAdapter(AnyDisturbance).validate_python({"kind": kind}).kind == kind


@pytest.mark.parametrize("kind", ["rotor_chip", "wind", "fan_jet", "gusts", "payload"])
def test_missing_settings_are_named(kind):
    with pytest.raises(ValidationError) as caught:
        TypeAdapter(AnyDisturbance).validate_python({"kind": kind})
    assert {fault["type"] for fault in caught.value.errors()} == {"missing"}
