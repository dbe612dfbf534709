"""The simulated vehicle as a whole: from commands to datagrams and truth."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest

from protocol.conventions import GRAVITY
from sim_vehicle.config import load_vehicle
from sim_vehicle.records import TRUTH
from sim_vehicle.vehicle import SimVehicle

COLUMN = {name: index for index, name in enumerate(TRUTH.names)}
TICK = 5_000_000
HIGH = {"initial": {"position_ned_m": [0.0, 0.0, -4.0], "hovering": True}}
STORM = HIGH | {
    "disturbances": [
        {"kind": "gusts", "sigma_m_s": 0.5, "length_scale_m": 0.5},
        {"kind": "wind", "velocity_ned_m_s": [1.5, 0.0, 0.0], "onset_s": 0.05},
        {"kind": "cloth"},
        {"kind": "rotor_chip", "thrust_factor": 0.9, "onset_s": 0.1025},
        {"kind": "motor_gain", "common": 0.95, "spread": 0.03},
    ]
}


def fly(flying, motors, seconds, fractions=(0.5,) * 4, step_ns=TICK, armed=True):
    """Fly open loop. Returns the digest of the outputs, and the last truth."""
    digest, onboard, capture = hashlib.sha256(), [], []
    for k in range(round(seconds * 1e9 / TICK)):
        flying.receive(motors(fractions, armed), k * TICK)
        for now in range(k * TICK + step_ns, (k + 1) * TICK + 1, step_ns):
            output = flying.step(now)
            onboard += output.to_onboard
            capture += output.to_motion_capture
    digest.update(b"".join(onboard + capture) + output.truth[:13].tobytes())
    return digest.hexdigest(), output.truth


def named(truth, name, axes):
    return np.array([truth[COLUMN[f"{name}_{axis}"]] for axis in axes])


def test_the_same_seed_gives_the_same_flight(vehicle, motors):
    flights = [fly(vehicle(STORM, seed), motors, 0.4)[0] for seed in (5, 5, 6)]
    assert flights[0] == flights[1]
    assert flights[0] != flights[2]


def test_a_flight_does_not_depend_on_how_often_it_is_stepped(vehicle, motors):
    assert fly(vehicle(STORM), motors, 0.3)[0] == fly(vehicle(STORM), motors, 0.3, step_ns=1_000_000)[0]


def test_after_a_stall_one_step_covers_the_missed_time(vehicle, frames):
    flying = vehicle(HIGH)
    assert len(frames(flying.step(47_300_000).to_onboard, "HIL_SENSOR")) == 9
    assert len(frames(flying.step(50_000_000).to_onboard, "HIL_SENSOR")) == 1
    assert flying.step(50_000_000).to_onboard == []


def test_a_command_acts_from_its_arrival(vehicle, motors):
    flying = vehicle()
    flying.step(TICK)
    flying.receive(motors([1.0] * 4), TICK)
    flying.receive(motors([0.5] * 4), TICK + 2_000_000)
    thrust = flying.step(2 * TICK).truth[COLUMN["motor_thrust_1"]]
    full = 0.327 * (4.11 / 3.7) ** 2
    rise = full * (1 - np.exp(-2 / 30))
    assert thrust == pytest.approx(0.5 * full + (rise - 0.5 * full) * np.exp(-3 / 30), rel=0.01)


def test_command_delay(vehicle, motors):
    flying = vehicle({"motors": {"command_delay_s": 0.0075}})
    flying.receive(motors([0.5] * 4), 0)
    assert flying.step(7_000_000).truth[COLUMN["motor_thrust_1"]] == 0.0
    assert flying.step(8_000_000).truth[COLUMN["motor_thrust_1"]] == 0.0
    assert flying.step(9_000_000).truth[COLUMN["motor_thrust_1"]] > 0.0


def test_motors_stop_without_commands(vehicle, motors):
    flying = vehicle(HIGH)
    fly(flying, motors, 0.2)
    held = flying.step(290_000_000).truth[COLUMN["motor_thrust_1"]]
    assert held > 0.15
    last = 195_000_000 + 100_000_000
    at_time_out = flying.step(last).truth[COLUMN["motor_thrust_1"]]
    later = flying.step(last + 50_000_000).truth[COLUMN["motor_thrust_1"]]
    assert later == pytest.approx(at_time_out * np.exp(-1), rel=1e-6)


def test_no_thrust_unless_armed(vehicle, motors):
    _, truth = fly(vehicle(), motors, 0.2, (0.9,) * 4, armed=False)
    assert named(truth, "motor_thrust", "1234").max() == 0.0
    assert truth[COLUMN["airborne"]] == 0.0


def test_an_armed_motor_idles(vehicle, motors):
    _, truth = fly(vehicle(), motors, 0.3, (0.0,) * 4)
    assert named(truth, "motor_thrust", "1234") == pytest.approx(0.02 * 0.327 * (4.1 / 3.7) ** 2, rel=0.02)


def test_bad_commands_change_nothing(vehicle, motors):
    flying = vehicle(HIGH)
    fly(flying, motors, 0.05)
    for datagram in (b"x", motors([float("nan")] * 4), motors([2.0] * 4), motors([0.5] * 4)[:-4]):
        flying.receive(datagram, 50_000_000)
    assert sum(flying.rejected.values()) == 4
    before = vehicle(HIGH)
    fly(before, motors, 0.05)
    np.testing.assert_array_equal(flying.step(60_000_000).truth, before.step(60_000_000).truth)


def test_take_off_and_landing_are_no_crash(vehicle, motors):
    """A simple height control takes off, holds 0.3 m and lands softly."""
    flying = vehicle()
    truth = flying.step(0).truth
    heights = []
    for k in range(1200):
        goal = 0.3 if k < 800 else -0.5
        height, sinking = -truth[2], truth[5]
        climb = np.clip(1.5 * (goal - height), -0.5, 0.5)
        thrust = 0.063 * (GRAVITY + 6.0 * (climb + sinking)) / 4
        fraction = thrust / 0.327 * (3.7 / truth[COLUMN["battery_voltage"]]) ** 2
        flying.receive(motors([min(1.0, fraction)] * 4, armed=k < 1100), k * TICK)
        truth = flying.step((k + 1) * TICK).truth
        heights.append(height)
    assert flying.crash_reason == ""
    assert max(heights) == pytest.approx(0.3, abs=0.08)
    assert heights[-1] < 0.03
    assert truth[COLUMN["airborne"]] == 0.0


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ({"position_ned_m": [0, 0, -0.5]}, "hit the floor at 2.9 m/s"),
        ({"position_ned_m": [0, 0, -12]}, "left the room, 12.0 m"),
        ({"position_ned_m": [9.9, 0, -1], "velocity_ned_m_s": [3.0, 0, 0]}, "left the room"),
    ],
)
def test_crash_reasons(vehicle, start, reason):
    flying = vehicle({"initial": start})
    for k in range(100):
        flying.step((k + 1) * TICK)
    assert reason in flying.crash_reason


def test_tilting_over_is_a_crash_and_stops_the_motors(vehicle, motors):
    flying = vehicle(HIGH)
    _, truth = fly(flying, motors, 0.6, (0.3, 0.7, 0.7, 0.3))
    assert "tilted by 8" in flying.crash_reason
    assert named(truth, "motor_thrust", "1234").max() < 0.05


def test_a_tilted_touch_down_is_a_crash(vehicle):
    flying = vehicle({"initial": {"position_ned_m": [0, 0, -0.08]}})
    flying._state[6:10] = np.cos(0.35), np.sin(0.35), 0.0, 0.0
    flying.step(150_000_000)
    assert "touched the floor tilted by 40 deg" in flying.crash_reason


def test_the_disturbance_is_zero_for_the_nominal_vehicle(vehicle, motors):
    ideal = HIGH | {
        "battery": {"full_v": 3.7, "empty_v": 3.7, "resistance_ohm": 0.0, "polarisation_ohm": 0.0},
        "drag": {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0},
        "floor": {"ground_effect": 0.0},
        "motors": {"torque_ratio_m": 0.002414},
        "initial": {"position_ned_m": [0.0, 0.0, -4.0]},
    }
    _, truth = fly(vehicle(ideal), motors, 0.3, (0.5, 0.51, 0.49, 0.505))
    np.testing.assert_allclose(named(truth, "disturbance_force", "ned"), 0.0, atol=1e-3)
    np.testing.assert_allclose(named(truth, "disturbance_torque", "xyz"), 0.0, atol=2e-6)
    assert np.linalg.norm(named(truth, "rate", "pqr")) > 0.3


def test_disturbance_of_a_payload_drag_chip_and_wrench(vehicle, motors):
    """Weight of the payload, drag at the air speed, thrust and torque lost by the chip, a wrench as it is set."""
    base = {
        "battery": {"full_v": 3.7, "empty_v": 3.7, "resistance_ohm": 0.0, "polarisation_ohm": 0.0},
        "floor": {"ground_effect": 0.0},
        "motors": {"torque_ratio_m": 0.002414},
        "body": {"inertia_kg_m2": [0.01, 0.01, 0.01]},
        "nominal": {"body": {"inertia_kg_m2": [0.01, 0.01, 0.01]}},
        "initial": {"position_ned_m": [0.0, 0.0, -4.0]},
    }
    still = {"drag": {"linear_n_s_m": 0.0, "quadratic_n_s2_m2": 0.0}}

    def flown(block, over):
        truth = fly(vehicle(base | over | {"disturbances": [block]}), motors, 0.4, (0.47,) * 4)[1]
        return named(truth, "disturbance_force", "ned"), named(truth, "disturbance_torque", "xyz"), truth

    force, _, truth = flown({"kind": "payload", "mass_kg": 0.01, "offset_m": [0, 0, 0]}, still)
    specific_force = truth[COLUMN["acceleration_d"]] - GRAVITY
    np.testing.assert_allclose(force, [0, 0, -0.01 * specific_force], atol=1e-4)
    force, torque, truth = flown({"kind": "wind", "velocity_ned_m_s": [3.0, 0, 0]}, {})
    u = 3.0 - truth[COLUMN["velocity_n"]]
    assert force[0] == pytest.approx((0.016 + 4.7e-3 * u) * u, rel=0.01)
    assert torque[1] == pytest.approx(-force[0] * 0.0159, rel=0.01)
    force, torque, truth = flown({"kind": "rotor_chip", "rotor": 1, "thrust_factor": 0.8, "torque_factor": 0.7}, still)
    T = truth[COLUMN["motor_thrust_2"]]
    assert force[2] == pytest.approx(0.2 * T, rel=0.02)
    np.testing.assert_allclose(torque, [0.2 * T * 0.0441, -0.2 * T * 0.0441, -0.3 * T * 0.002414], rtol=0.01)
    wrench = {"force_ned_n": [0.01, -0.02, 0.03], "torque_frd_nm": [1e-4, -2e-4, 3e-5]}
    force, torque, _ = flown({"kind": "wrench", **wrench}, still)
    np.testing.assert_allclose(force, wrench["force_ned_n"], atol=1e-7)
    np.testing.assert_allclose(torque, wrench["torque_frd_nm"], atol=1e-9)


def test_acceleration_is_the_velocity_gained(vehicle, motors):
    flying = vehicle(STORM)
    last = flying.step(0).truth
    for k in range(60):
        flying.receive(motors([0.5, 0.51, 0.5, 0.5]), k * TICK)
        truth = flying.step((k + 1) * TICK).truth
        gained = truth[3:6] - last[3:6], truth[10:13] - last[10:13]
        np.testing.assert_allclose(named(truth, "acceleration", "ned") * 0.005, gained[0], atol=1e-12)
        np.testing.assert_allclose(named(truth, "angular_acceleration", "xyz") * 0.005, gained[1], atol=1e-12)
        last = truth


def test_battery_falls_as_in_the_flight_logs():
    """From 4.135 V to 3.59 V after 18 s under load; thrust falls 5-12 % between take-off and the end of a flight."""
    from sim_vehicle.physics.batch import VehicleBatch

    batch = VehicleBatch(load_vehicle("mambo", {"initial": {"position_ned_m": [0, 0, -3]}, "box_m": 1e6}), [1])
    volts = [batch.states[0, 27]]
    for _ in range(3600):
        fraction = 0.063 * GRAVITY / 4 / 0.327 * (3.7 / batch.states[0, 27]) ** 2
        batch.step(np.full((1, 4), fraction))
        volts.append(batch.states[0, 27])
    assert volts[0] == 4.135
    assert volts[-1] == pytest.approx(3.59, abs=0.03)
    assert 0.05 < 1 - (volts[-1] / volts[60]) ** 2 < 0.12


def test_the_real_vehicle_is_weaker():
    ideal, real = load_vehicle("mambo"), load_vehicle("mambo_real")
    assert 1.4 < sum(real.motors.gain) * real.motors.max_thrust_n / (real.body.mass_kg * GRAVITY) < 1.8
    assert 2.1 < 4 * ideal.motors.max_thrust_n / (ideal.body.mass_kg * GRAVITY) < 2.13
    assert ideal.motors.thrust_slope_n_s2 * 13840.8 * 500 == pytest.approx(ideal.motors.max_thrust_n, rel=2e-3)
    assert ideal.motors.torque_ratio_m == pytest.approx(1.5 * ideal.nominal.motors.torque_ratio_m)
    assert real.nominal == ideal.nominal


@pytest.mark.parametrize("seed", range(12))
def test_the_state_stays_valid_under_random_inputs(vehicle, motors, seed):
    """Random commands and disturbances, on the floor and in the air: finite, unit quaternion, above the floor."""
    rng = np.random.default_rng(seed)
    disturbances = [
        {
            "kind": "payload",
            "mass_kg": 0.05 * rng.random() + 1e-3,
            "offset_m": (0.05 * rng.standard_normal(3)).tolist(),
        },
        {"kind": "rotor_chip", "thrust_factor": 0.1 + 0.9 * rng.random(), "onset_s": 0.2, "end_s": 0.6},
        {"kind": "wind", "velocity_ned_m_s": (6.0 * rng.standard_normal(3)).tolist()},
        {"kind": "gusts", "sigma_m_s": 3.0, "length_scale_m": 0.3},
        {"kind": "cloth", "onset_s": 0.3},
        {"kind": "battery_sag", "drop_v": 1.5, "time_constant_s": 0.3},
        {"kind": "motor_gain", "common": 0.8, "spread": 0.3},
    ]
    flying = vehicle(
        {"disturbances": disturbances, "initial": {"position_ned_m": [0, 0, -2 * rng.random() - 0.1]}}, seed
    )
    for k in range(300):
        if k % 10 == 0:
            command = motors(rng.random(4), armed=rng.random() < 0.95)
        flying.receive(command, k * TICK)
        truth = flying.step((k + 1) * TICK).truth
        assert np.all(np.isfinite(truth))
        assert np.linalg.norm(truth[6:10]) == pytest.approx(1.0, abs=1e-9)
        assert truth[2] < 0.12
        assert 1.0 < truth[COLUMN["battery_voltage"]] < 4.2


WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None
sys.path[:0] = {path!r}
from sim_vehicle.physics.compiled import COMPILED
from sim_vehicle.config import load_vehicle
from sim_vehicle.vehicle import SimVehicle
assert not COMPILED
flying = SimVehicle(load_vehicle("mambo", {over!r}), 3)
for k in range(1, 41):
    truth = flying.step(k * 5_000_000).truth
print(*(float(x).hex() for x in truth))
"""


def test_without_numba_it_flies_the_same(tether, tmp_path):
    """The base install has no numba: CPython runs the same source, with the same result up to rounding."""
    over = STORM | {"disturbances": [*STORM["disturbances"], tether | {"onset_s": 0.05}]}
    code = WITHOUT_NUMBA.format(path=[os.getcwd(), str(tmp_path)], over=over)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    flying = SimVehicle(load_vehicle("mambo", over), 3)
    for k in range(1, 41):
        truth = flying.step(k * TICK).truth
    np.testing.assert_allclose([float.fromhex(x) for x in result.stdout.split()], truth, rtol=1e-9, atol=1e-9)
