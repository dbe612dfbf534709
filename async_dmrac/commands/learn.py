"""`dmrac learn SOURCE... --out FOLDER`: learns a memory from flights and from other memories."""

import argparse
from pathlib import Path

from async_dmrac.commands.output import add_json_option, print_json
from configs.loader import ConfigError
from experiments.memory.description import as_json, describe
from experiments.memory.learning import learn_from, read_source
from offboard.memory.config import MemoryConfig
from offboard.memory.folder import write_memory
from runtime.waiting import waiting

DESCRIPTION = "Learn a memory from logged flights, of any controller, and from other memories (docs/memory.md)."
EXAMPLES = """examples:
  dmrac learn flights/* --out memory             from flights with or without a trainer
  dmrac learn memory flights/new --out memory    the same memory with another flight
  dmrac learn first second --out both            merge two memories; a flight in both counts once
  dmrac fly --memory memory                      fly with it
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of the subcommand."""
    parser.add_argument("sources", nargs="+", type=Path, metavar="SOURCE", help="a flight's folder, or a memory's")
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FOLDER", help="of the memory; replaces an older one"
    )
    parser.add_argument("--steps", type=int, help="of the inner layers; 0: they stay (default: %(default)s)")
    parser.add_argument("--seed", type=int, help="of initial weights and of the draws (default: %(default)s)")
    add_json_option(parser, "what the memory holds")
    defaults = MemoryConfig()
    parser.set_defaults(steps=defaults.steps, seed=defaults.seed)


def run(arguments: argparse.Namespace) -> int:
    """Learn, write and describe the memory; returns 0. Raises ConfigError for sources that cannot be used."""
    given = {"steps": arguments.steps, "seed": arguments.seed}
    try:
        config = MemoryConfig(**given)
    except ValueError:
        raise ConfigError(
            f"--steps {arguments.steps} --seed {arguments.seed}: allowed are 0 to 100000, and 0 or more"
        ) from None
    with waiting(f"learning from {len(arguments.sources)} sources"):
        sources = [read_source(path) for path in arguments.sources]
        memory = learn_from(sources, config)
    write_memory(arguments.out, memory)
    if arguments.json:
        print_json(as_json(arguments.out, memory))
    else:
        print("\n".join(describe(arguments.out, memory)))
    return 0
