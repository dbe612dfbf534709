"""One description of the vehicle, for the simulator, for onboard, and for draws."""

from pathlib import Path

import pytest

from configs.flight_tree import Choices
from configs.loader import ConfigError
from configs.parts import part_names
from configs.vehicle import AIRFRAME, Range, read_vehicle
from experiments.flights.scenario import resolve
from sim_vehicle.config import load_vehicle


@pytest.mark.parametrize("name", part_names("vehicles"))
def test_onboard_and_the_reference_of_the_truth_get_the_nominal_values(name: str) -> None:
    vehicle, nominal = read_vehicle(name), load_vehicle(name).nominal
    for key, path in AIRFRAME.items():
        section, _, inner = path.partition(".")
        value = getattr(getattr(nominal, section), inner)
        assert vehicle.airframe[key] == (list(value) if isinstance(value, tuple) else value)


def test_the_simulated_vehicle_differs_from_the_one_that_onboard_assumes() -> None:
    flight = resolve("figure8_real")
    assert (flight.vehicle.body.mass_kg, flight.onboard.airframe.mass_kg) == (0.070, 0.063)
    assert flight.onboard.airframe.motor_response_s == 0.02
    assert flight.vehicle.motors.lag_down_s > flight.onboard.airframe.motor_lag_down_s == 0.05
    chosen = Choices(assignments=("vehicle.body.mass_kg=0.065", "onboard.airframe.mass_kg=0.06"))
    flight = resolve("hover", chosen)
    masses = (flight.vehicle.body.mass_kg, flight.onboard.airframe.mass_kg, flight.vehicle.nominal.body.mass_kg)
    assert masses == (0.065, 0.06, 0.063)


def own_vehicle(folder: Path, text: str) -> str:
    (folder / "mine.yaml").write_text(f"extends: mambo\n{text}", encoding="utf-8")
    return str(folder / "mine.yaml")


def test_a_vehicle_of_ones_own(tmp_path: Path) -> None:
    text = "body: {mass_kg: 0.1}\nonboard: {arm_x_m: 0.04}\nsimulated: {body: {mass_kg: 0.11}}"
    vehicle = read_vehicle(own_vehicle(tmp_path, text))
    assert (vehicle.airframe["mass_kg"], vehicle.airframe["arm_x_m"]) == (0.1, 0.04)
    assert vehicle.simulated["body"] == vehicle.simulated["nominal"]["body"] | {"mass_kg": 0.11}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("motors: {lag_up_s: 0.5}", r"mine\.yaml: ranges\.motors\.lag_up_s: does not hold .* own value, 0\.5"),
        ("ranges: {body.colour: {times: [0, 1]}}", r"ranges\.body\.colour: does not hold .* own value, None"),
        ("ranges: {body.mass_kg: {between: [1, 2]}}", r"ranges\.body\.mass_kg: give either between or times"),
        ("ranges: {body.mass_kg: {to: 1}}", r"ranges\.body\.mass_kg\.to: unknown key"),
        ("ranges: {body.mass_kg: {times: [1.2, 0.9]}}", r"ranges\.body\.mass_kg: 1\.2 to 0\.9: expected the low end"),
        (
            "held_out_ranges: {body.colour: {times: [0, 1]}}",
            r"held_out_ranges\.body\.colour: unknown path; allowed are the paths of ranges: body\.mass_kg, ",
        ),
        ("simulated: 3", r"mine\.yaml: simulated: 3: expected a mapping"),
    ],
)
def test_what_is_wrong_in_a_vehicle_is_named(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=said):
        read_vehicle(own_vehicle(tmp_path, text))


def test_a_fault_in_a_vehicle_of_ones_own_names_its_file(tmp_path: Path) -> None:
    vehicle = own_vehicle(tmp_path, "simulated: {drag: {linear_n_s_m: -1.0}}")
    (tmp_path / "flight.yaml").write_text(f"extends: hover\nvehicle: {vehicle}", encoding="utf-8")
    said = r"flight\.yaml, vehicle .*mine\.yaml: vehicle\.drag\.linear_n_s_m: -1\.0: Input should be greater than"
    with pytest.raises(ConfigError, match=said):
        resolve(str(tmp_path / "flight.yaml"))


def test_a_range_goes_from_low_to_high() -> None:
    times, between = Range(times=(0.5, 2.0)), Range(between=(0.02, 0.07))
    assert [times.value(4.0, share) for share in (0.0, 0.5, 1.0)] == [2.0, 5.0, 8.0]
    assert times.value([1e-5, 2e-5], 1.0) == [2e-5, 4e-5]
    assert [between.value(0.03, share) for share in (0.0, 1.0)] == [0.02, 0.07]


@pytest.mark.parametrize("name", part_names("vehicles"))
def test_every_value_has_a_tuning_range_and_another_one_held_out(name: str) -> None:
    vehicle = read_vehicle(name)
    tuning, held_out = vehicle.ranges["tuning"], vehicle.ranges["held_out"]
    assert tuning.keys() == held_out.keys()
    for path in tuning:
        ends = [[vehicle.drawn(path, share, chosen) for share in (0.0, 1.0)] for chosen in ("tuning", "held_out")]
        assert ends[0] != ends[1], path
        assert tuning[path] != held_out[path], path
