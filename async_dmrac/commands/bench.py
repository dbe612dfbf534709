"""`dmrac bench`: times the onboard step, the loop, the simulated vehicle, the trainer and lockstep.

`dmrac bench sensors` compares the noise of the simulated sensors with real flight logs instead; `dmrac bench flood`
flies while ports are flooded; `dmrac bench core` measures the core in C beside numpy's; `dmrac bench gym` counts the
steps per second of the Gymnasium environments.
"""

import argparse
import json
from pathlib import Path
from typing import Any, Final

from async_dmrac.commands.output import add_json_option, print_json
from async_dmrac.commands.shared import plain_console, positive
from configs.loader import ConfigError
from experiments.flights.scenario import DEFAULT_SCENARIO, Choices, resolve
from runtime.extras import require_modules

SENSORS: Final = "sensors"
FLOOD: Final = "flood"
CORE: Final = "core"
GYM: Final = "gym"
VEHICLES_MAX: Final = 64
"""Of --vehicles, unless given."""
EXAMPLES: Final = """examples:
  dmrac bench
  dmrac bench sensors --set vehicle.sensors.imu.noise=white
  dmrac bench flood --controller mrac --seconds 12
  dmrac bench core --seconds 20 --vehicles 64
  dmrac bench gym
  dmrac bench figure8_wind --controller mrac --seconds 30 --out bench.json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac bench`."""
    parser.add_argument(
        "scenario",
        nargs="?",
        default=DEFAULT_SCENARIO,
        help="scenario to fly (default: %(default)s); sensors: compare the sensors' noise with real flight logs; "
        "flood: fly with flooded ports (needs root); core: the core in C beside numpy's; gym: the "
        "Gymnasium environments",
    )
    parser.add_argument(
        "--vehicles",
        type=positive,
        metavar="N",
        help=f"core: most vehicles in one process (default: {VEHICLES_MAX})",
    )
    parser.add_argument("--controller", help="another controller than the scenario's")
    parser.add_argument("--seconds", type=float, default=15.0, help="flight time to measure, 2 to 600 s")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a value by path")
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write the numbers to this file as JSON")
    add_json_option(parser, "the numbers")


def run(arguments: argparse.Namespace) -> int:
    """Measure and print; return 0. Raises ConfigError for bad options."""
    if not 2.0 <= arguments.seconds <= 600.0:
        raise ConfigError(f"--seconds {arguments.seconds:g}: allowed are 2 to 600")
    if arguments.vehicles is not None and arguments.scenario != CORE:
        raise ConfigError(f"--vehicles {arguments.vehicles}: only with dmrac bench {CORE}")
    kinds = {SENSORS: _sensors, FLOOD: _flood, CORE: _core, GYM: _gym}
    report: Any = kinds.get(arguments.scenario, _times)(arguments)
    if arguments.json:
        print_json(report)
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return 0


def _times(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.timing.benchmark import measure

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    return measure(resolve(arguments.scenario, choices), arguments.seconds, plain_console(arguments.json).print)


def _core(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.campaigns.provenance import here
    from experiments.timing.core_speed import measure

    if arguments.controller is not None or arguments.set:
        raise ConfigError(
            f"dmrac bench {CORE}: --controller and --set are not allowed: its flights are always the same"
        )
    show, place = plain_console(arguments.json).print, here()
    show(place)
    figures = measure(max(arguments.seconds, 5.0), arguments.vehicles or VEHICLES_MAX, show)
    return {"machine": place, "figures": [one.as_json() for one in figures]}


def _flood(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    from experiments.link.flood import PORTS, RATES_HZ, as_json, measure, table

    choices = Choices(arguments.controller, None, max(arguments.seconds, 5.0), tuple(arguments.set))
    console = plain_console(arguments.json)
    flights = measure(resolve(DEFAULT_SCENARIO, choices), tuple(PORTS), RATES_HZ, console.print)
    console.print(table(flights))
    return as_json(flights)


def _gym(arguments: argparse.Namespace) -> dict[str, float]:
    require_modules("gymnasium", "numba", purpose=f"dmrac bench {GYM}")
    from async_dmrac.environments.speed import environment_speeds

    speeds = environment_speeds()
    show = plain_console(arguments.json).print
    show("\n".join(f"{name:34} {speed:9.0f} steps/s" for name, speed in speeds.items()))
    return speeds


def _sensors(arguments: argparse.Namespace) -> dict[str, Any]:
    from experiments.flights.sensor_noise import NOT_MEASURED_S, as_json, compare_noise, nis_table, noise_table

    choices = Choices(arguments.controller, None, arguments.seconds + NOT_MEASURED_S, tuple(arguments.set))
    config = resolve("hover", choices)
    comparison, console = compare_noise(choices), plain_console(arguments.json)
    console.print(noise_table(config, comparison.rows))
    console.print(nis_table(comparison.nis))
    return as_json(config, comparison)
