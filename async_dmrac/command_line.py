"""The `dmrac` command: one subcommand a module, imported only when it is called, so that onboard starts quickly."""

import argparse
import os
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Final, NamedTuple

import async_dmrac

# numpy's and torch's own threads would compete with the 200 Hz loop; set before either is imported.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

EXIT_FAILED: Final = 1
EXIT_USAGE: Final = 2


class Subcommand(NamedTuple):
    """Where a subcommand lives, and what it is for."""

    module: str
    help: str
    modules: tuple[str, ...] = ()
    """Of the extras (runtime.extras), that it cannot do without."""


TRAINER: Final = ("torch",)
ROWS: Final = ("torch", "pyarrow", "threadpoolctl")
DRAWN: Final = ("matplotlib", "pyarrow", "sklearn", "threadpoolctl")
SUBCOMMANDS: Final[dict[str, Subcommand]] = {
    "fly": Subcommand("async_dmrac.commands.fly", "fly a scenario: vehicle, onboard and offboard together"),
    "onboard": Subcommand("onboard.command", "the 200 Hz flight process alone"),
    "offboard": Subcommand("offboard.command", "the training process alone"),
    "sim": Subcommand("sim_vehicle.command", "the simulated vehicle and its radio alone"),
    "mocap": Subcommand("async_dmrac.commands.mocap", "sign the poses of a motion capture and send them to offboard"),
    "replay": Subcommand(
        "async_dmrac.commands.replay", "re-fly a recorded flight with exactly the deliveries its link had"
    ),
    "dropouts": Subcommand(
        "async_dmrac.commands.dropouts", "fly the shipped dropouts of the link and print a table", ROWS
    ),
    "attack": Subcommand("async_dmrac.commands.attack", "fly bad learners and count the vehicles that they cost", ROWS),
    "soak": Subcommand(
        "async_dmrac.commands.soak", "fly for long while processes are killed and ports flooded", TRAINER
    ),
    "learn": Subcommand(
        "async_dmrac.commands.learn", "learn a memory from logged flights and from other memories", TRAINER
    ),
    "memory": Subcommand("async_dmrac.commands.memory", "check a memory and show what it holds", TRAINER),
    "config": Subcommand("async_dmrac.commands.config", "write the resolved configuration of a scenario"),
    "bench": Subcommand("async_dmrac.commands.bench", "time the onboard step, the loop's pace and lockstep", TRAINER),
    "margins": Subcommand("async_dmrac.commands.margins", "measure the stability margins of a controller's loops"),
    "keygen": Subcommand("async_dmrac.commands.keygen", "make a key that protects the onboard/offboard link"),
    "tune": Subcommand("async_dmrac.commands.tune", "search a controller's gains on training seeds", (*ROWS, "optuna")),
    "campaign": Subcommand("async_dmrac.commands.campaign", "fly scenario x controllers x sweeps x seeds", ROWS),
    "refly": Subcommand("async_dmrac.commands.refly", "fly some of a campaign's flights again and compare", ROWS),
    "figures": Subcommand("async_dmrac.commands.figures", "tables and figures of a campaign", DRAWN),
    "reproduce": Subcommand(
        "async_dmrac.commands.reproduce", "fly every campaign and rebuild docs/results.md", (*TRAINER, *DRAWN)
    ),
    "log": Subcommand("async_dmrac.commands.log", "look into, check, merge and export flight logs"),
    "view": Subcommand("async_dmrac.commands.view", "open a flight in the 3-D viewer"),
    "report": Subcommand("async_dmrac.commands.report", "one self-contained page about a flight"),
    "compare": Subcommand("async_dmrac.commands.compare", "overlay flights"),
    "core": Subcommand("async_dmrac.commands.core", "build the onboard core in C"),
    "mambo": Subcommand("async_dmrac.commands.mambo", "build, configure, check and install the library for the Mambo"),
    "preflight": Subcommand("async_dmrac.commands.preflight", "check a vehicle's link before it may fly"),
    "modes": Subcommand("async_dmrac.commands.modes", "print the flight modes, also for a ground station"),
    "demo": Subcommand(
        "async_dmrac.commands.demo", "fly the same wind with two controllers and draw both", (*TRAINER, "matplotlib")
    ),
    "doctor": Subcommand("async_dmrac.commands.doctor", "check installation and machine"),
    "completion": Subcommand("async_dmrac.commands.completion", "print a shell's completion script", ("shtab",)),
}


def build_parser(name: str | None) -> argparse.ArgumentParser:
    """The parser; only the subcommand that is called is imported and gets its options."""
    parser = argparse.ArgumentParser(
        prog="dmrac",
        description="A small quadrotor that learns in flight.",
        epilog="examples:\n  dmrac fly\n  dmrac fly rotor_chip --controller pid --lockstep\n  dmrac fly --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"dmrac {async_dmrac.__version__}")
    subparsers = parser.add_subparsers(dest="subcommand", metavar="SUBCOMMAND", required=True)
    for key, subcommand in SUBCOMMANDS.items():
        if key != name:
            subparsers.add_parser(key, help=subcommand.help)
            continue
        _add_whole(subparsers, key)
    return parser


def build_whole_parser() -> argparse.ArgumentParser:
    """The parser with the options of every subcommand, for completion scripts. Imports all of them."""
    parser = argparse.ArgumentParser(prog="dmrac", description="A small quadrotor that learns in flight.")
    subparsers = parser.add_subparsers(dest="subcommand", metavar="SUBCOMMAND", required=True)
    for key in SUBCOMMANDS:
        _add_whole(subparsers, key)
    return parser


def _add_whole(subparsers: "argparse._SubParsersAction[argparse.ArgumentParser]", key: str) -> None:
    """Import a subcommand and add its options."""
    subcommand = SUBCOMMANDS[key]
    module = import_module(subcommand.module)
    own = subparsers.add_parser(
        key,
        help=subcommand.help,
        description=getattr(module, "DESCRIPTION", subcommand.help),
        epilog=getattr(module, "EXAMPLES", None),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.add_arguments(own)
    own.set_defaults(run=module.run)


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns 0 for success, 1 for a lost vehicle, failed check or full disk, 2 for bad usage."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    name = next((word for word in arguments if not word.startswith("-")), None)
    from configs.loader import ConfigError
    from runtime.errors import PlainError
    from runtime.files import no_space

    try:
        if name in SUBCOMMANDS and SUBCOMMANDS[name].modules:
            from runtime.extras import require_modules

            require_modules(*SUBCOMMANDS[name].modules)
        parsed = build_parser(name).parse_args(arguments)
        parsed.words = arguments
        status: int = parsed.run(parsed)
    except (ConfigError, PlainError) as error:
        print(f"dmrac {name}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except OSError as error:
        if error.filename is None and not no_space(error):
            raise
        print(f"dmrac {name}: {error.filename or 'a file'}: {error.strerror}", file=sys.stderr)
        return EXIT_FAILED if no_space(error) else EXIT_USAGE
    except KeyboardInterrupt:
        return 130
    return status
