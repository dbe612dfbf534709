"""`dmrac bench`: times the onboard step, the loop, the simulated vehicle, the trainer and lockstep.

`dmrac bench sensors` compares the noise of the simulated sensors with real flight logs instead; `dmrac bench flood`
flies while ports are flooded; `dmrac bench gym` counts the steps per second of the Gymnasium environments.
"""

import argparse
import json
from pathlib import Path
from typing import Any, Final

from async_dmrac.commands.shared import plain_console
from configs.loader import ConfigError
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve

SENSORS: Final = "sensors"
FLOOD: Final = "flood"
GYM: Final = "gym"
EXAMPLES: Final = """examples:
  dmrac bench
  dmrac bench sensors --set vehicle.sensors.imu.noise=white
  dmrac bench flood --controller mrac --seconds 12
  dmrac bench gym
  dmrac bench figure8_wind --controller mrac --seconds 30 --json bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac bench`."""
    parser.add_argument(
        "scenario",
        nargs="?",
        default=DEFAULT_SCENARIO,
        help="scenario to fly (default: %(default)s); sensors: compare the sensors' noise with real flight logs; "
        "flood: fly with flooded ports (needs root); gym: the Gymnasium environments",
    )
    parser.add_argument("--controller", help="another controller than the scenario's")
    parser.add_argument("--seconds", type=float, default=15.0, help="flight time to measure, 2 to 600 s")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value by path")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers to this file")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0. Raises ConfigError for bad options."""
    if not 2.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds {arguments.seconds:g}: allowed are 2 to 600")
    report: Any = {SENSORS: _sensors, FLOOD: _flood, GYM: _gym}.get(arguments.scenario, _times)(arguments)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


def _times(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.timing.benchmark import measure

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    return measure(resolve(arguments.scenario, choices), arguments.seconds, plain_console().print)


def _flood(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from experiments.link.flood import PORTS, RATES_HZ, as_json, measure, table

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    console = plain_console()
    flights = measure(resolve(DEFAULT_SCENARIO, choices), tuple(PORTS), RATES_HZ, console.print)
    console.print(table(flights))
    return as_json(flights)


def _gym(arguments: argparse.Namespace) -> dict[str, float]:
    del arguments
    from async_dmrac.record import need

    need("gymnasium", "'async-dmrac[gym]'")
    from async_dmrac.environments.speed import environment_speeds

    speeds = environment_speeds()
    plain_console().print("\n".join(f"{name:34} {speed:9.0f} steps/s" for name, speed in speeds.items()))
    return speeds


def _sensors(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.flights.sensor_noise import NOT_MEASURED_S, as_json, compare_noise, nis_table, noise_table

    choices = Choices(arguments.controller, None, arguments.seconds + NOT_MEASURED_S, tuple(arguments.set))
    config = resolve("hover", choices)
    comparison, console = compare_noise(choices), plain_console()
    console.print(noise_table(config, comparison.rows))
    console.print(nis_table(comparison.nis))
    return as_json(config, comparison)
