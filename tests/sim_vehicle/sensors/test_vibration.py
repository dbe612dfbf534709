"""The IMU's noise with the spectrum of real flights."""

from math import pi, sqrt

import numpy as np
import pytest

import sim_vehicle.physics.layout as at
from configs.loader import ConfigError
from experiments.flights.sensor_noise import LOGGED, band_variance
from protocol.conventions import GRAVITY
from sim_vehicle.config import load_vehicle
from sim_vehicle.physics.advance import account_tones
from sim_vehicle.physics.compiled import python_twin
from sim_vehicle.physics.draws import NormalRows
from sim_vehicle.physics.packing import pack_parameters
from sim_vehicle.sensors.vibration import SAMPLES, Vibration, butterworth_high_pass, draw_tones, vibrate
from sim_vehicle.vehicle import initial_state

MEASURED = load_vehicle("mambo")
NOISE = MEASURED.sensors.imu.measured
HOVER = MEASURED.body.mass_kg * GRAVITY / 4
STILL = np.zeros((4, 2))


def vibration(count, seed=1, config=NOISE, shaking=STILL, thrust=HOVER):
    """[count, 6] at 200 Hz, with constant thrusts, on a stand that does not move."""
    source = Vibration(config, HOVER, seed, 1)
    state, P, sums = initial_state(MEASURED), pack_parameters(MEASURED), np.zeros(at.SUMS_SIZE)
    state[at.THRUST : at.THRUST + 4] = thrust
    speed = np.sqrt(thrust / P[at.THRUST_SLOPE]) * P[at.ROTOR_SPEED : at.ROTOR_SPEED + 4]
    rows = np.empty((count, 6))
    for k in range(count):
        for step in range(SAMPLES):
            state[at.ROTOR_PHASE : at.ROTOR_PHASE + 4] = speed * 0.001 * (SAMPLES * k + step)
            account_tones(state, P, sums)
        *given, out = source.arguments()
        vibrate(state, sums, shaking, *given, out)
        rows[k] = out
    return rows


def only(**kept):
    """The noise with all parts at 0 but those given."""
    none = {name: (0.0, 0.0, 0.0) for name in type(NOISE).model_fields if name.endswith(("m_s2", "rad_s"))}
    return NOISE.model_copy(update=none | {"blade_share": 0.0} | kept)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_accelerometer_has_the_logged_spectrum(seed):
    rows = vibration(8000, seed)[:, :3]
    logged = np.array([one[0] for one in LOGGED.values() if one is not None])
    np.testing.assert_allclose(rows.std(axis=0), logged[:3], rtol=0.25)
    assert np.all(np.sqrt(band_variance(rows, 3.0, 15.0)) < 1.25 * logged[3:6])
    share = band_variance(rows, 50.0, np.inf) / rows.var(axis=0)
    assert np.all((share > 0.9) & (share < 0.98))


def test_a_tone_is_averaged_and_folded():
    """Once per revolution, 288 Hz in hover: the mean of five samples weakens it 4 times, sampling folds it to 88 Hz."""
    rows = vibration(4000, config=only(accelerometer_tone_m_s2=(4.0, 0.0, 0.0), rotor_spread=0.0))[:, 0]
    assert rows.std() == pytest.approx(1.0, rel=0.05)
    spectrum, frequency = np.abs(np.fft.rfft(rows)), np.fft.rfftfreq(4000, 0.005)
    turns = np.sqrt(HOVER / 4.72e-8) / (2.0 * pi) * np.array(NOISE.rotor_speed)
    strongest = np.sort(frequency[np.argsort(spectrum)[-4:]])
    np.testing.assert_allclose(strongest, np.sort(turns - 200.0), atol=0.06)


def test_blades_give_a_tone_twice_per_revolution():
    config = only(accelerometer_tone_m_s2=(1e-9, 0.0, 0.0), blade_share=4e9, rotor_spread=0.0)
    rows = vibration(4000, config=config)[:, 0]
    turns = np.sqrt(HOVER / 4.72e-8) / (2.0 * pi) * np.array(NOISE.rotor_speed)
    spectrum, frequency = np.abs(np.fft.rfft(rows)), np.fft.rfftfreq(4000, 0.005)
    folded = np.abs(2.0 * turns - 600.0)
    np.testing.assert_allclose(np.sort(frequency[np.argsort(spectrum)[-4:]]), np.sort(folded), atol=0.06)


def test_vibration_grows_with_the_squared_speed():
    config = only(accelerometer_broad_m_s2=(1.0, 1.0, 1.0))
    np.testing.assert_allclose(vibration(200, config=config, thrust=2 * HOVER), 2.0 * vibration(200, config=config))
    assert np.all(vibration(50, config=config, thrust=0.0) == 0.0)
    white = only(accelerometer_white_m_s2=(0.1, 0.1, 0.1))
    np.testing.assert_allclose(vibration(4000, config=white, thrust=0.0)[:, :3].std(axis=0), 0.1, rtol=0.05)


def test_the_seed_draws_the_rotors():
    tone = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    tones = draw_tones(np.random.default_rng(1), tone, 0.5, 0.5)
    power = (tones**2).reshape(6, 4, 2, 2).sum(axis=-1)
    np.testing.assert_allclose(power[:, :, 0].sum(axis=1) / 2, tone**2)
    np.testing.assert_allclose(power[:, :, 1], 0.25 * power[:, :, 0])
    assert np.ptp(np.sqrt(power[0, :, 0])) > 0.05
    np.testing.assert_array_equal(vibration(20, seed=4), vibration(20, seed=4))
    assert not np.allclose(vibration(20, seed=4), vibration(20, seed=5))


def test_factor_scales_all_of_it():
    louder = NOISE.model_copy(update={"factor": 2.0})
    np.testing.assert_allclose(vibration(50, config=louder), 2.0 * vibration(50))


def test_a_chipped_rotor_is_averaged_too():
    shaking = np.array([[4.0, 0.2], [0, 0], [0, 0], [0, 0]])
    rows = vibration(2000, config=only(), shaking=shaking)
    np.testing.assert_allclose(
        rows[:, [0, 1, 3, 4]].std(axis=0), np.array([4.0, 4.0, 0.2, 0.2]) / sqrt(2) / 4, rtol=0.1
    )


def test_high_pass():
    b0, a1, a2 = butterworth_high_pass(70.0)

    def gain(hz):
        z = np.exp(-2j * pi * hz / 1000.0)
        return abs(b0 * (1 - z) ** 2 / (1 + a1 * z + a2 * z * z))

    assert gain(70.0) == pytest.approx(sqrt(0.5))
    assert gain(499.0) == pytest.approx(1.0, abs=1e-3)
    assert gain(9.0) < 0.02


def test_without_numba_it_is_the_same():
    rng, results = np.random.default_rng(3), []
    tones, noise = draw_tones(rng, np.ones(6), 0.5, 0.5), NormalRows(rng, 6 * SAMPLES + 6).take()
    for account, shake in ((account_tones, vibrate), (python_twin(account_tones), python_twin(vibrate))):
        state, P, sums = initial_state(MEASURED), pack_parameters(MEASURED), np.zeros(at.SUMS_SIZE)
        state[at.THRUST : at.ROTOR_PHASE] = HOVER
        memory, out = np.zeros((6, 2)), np.zeros(6)
        for k in range(10):
            state[at.ROTOR_PHASE : at.ROTOR_PHASE + 4] = 0.3 * k, 0.5 * k, 0.7 * k, 1.1 * k
            account(state, P, sums)
        shaking, high_pass = np.full((4, 2), 0.3), butterworth_high_pass(70.0)
        shake(state, sums, shaking, HOVER, tones, np.ones(6), np.ones(6), high_pass, noise, memory, out)
        assert np.all(sums[at.IMU_TONES : at.IMU_TONES + 16] == 0.0)
        results.append(np.concatenate([out, memory.ravel()]))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-12)


def test_white_sums_no_tones_and_turns_the_rotors_as_before(bench):
    white = bench({"sensors": {"imu": {"noise": "white"}}})
    white.run([0.5] * 4, 0.1)
    assert np.all(white.sums[at.IMU_TONES : at.IMU_TONES + 16] == 0.0)
    assert np.all(white.P[at.ROTOR_SPEED : at.ROTOR_SPEED + 4] == 1.0)
    measured = bench()
    measured.run([0.5] * 4, 0.1)
    assert np.all(measured.sums[at.IMU_TONES : at.IMU_TONES + 16] != 0.0)
    np.testing.assert_array_equal(measured.state[: at.ROTOR_PHASE], white.state[: at.ROTOR_PHASE])


def test_flight_with_measured_noise_repeats(vehicle, motors, frames):
    def fly(seed):
        flying = vehicle({"initial": {"position_ned_m": [0, 0, -3]}}, seed)
        flying.receive(motors([0.5] * 4), 0)
        return [datagram for k in range(1, 20) for datagram in flying.step(k * 5_000_000).to_onboard]

    assert fly(1) == fly(1)
    assert fly(1) != fly(2)
    assert frames(fly(1), "HIL_SENSOR")


@pytest.mark.parametrize(
    ("imu", "message"),
    [
        ({"noise": "pink"}, "sensors.imu.noise: 'pink': Input should be 'white' or 'measured'"),
        ({"noise": "measured", "measured": None}, "noise: measured needs the section measured"),
        ({"measured": {"rotor_spread": 1.0}}, "sensors.imu.measured.rotor_spread: 1.0: Input should be less than 1"),
        ({"measured": {"rotor_speed": [1.0, 1.0, 1.0, 0.0]}}, "sensors.imu.measured.rotor_speed.3: 0.0"),
        ({"measured": {"broad_above_hz": 500.0}}, "sensors.imu.measured.broad_above_hz: 500.0"),
        ({"measured": {"loud": 1.0}}, "sensors.imu.measured.loud: unknown key"),
    ],
)
def test_bad_values_are_named(imu, message):
    with pytest.raises(ConfigError) as caught:
        load_vehicle("mambo", {"sensors": {"imu": imu}})
    assert message in str(caught.value)
