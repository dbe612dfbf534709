"""`dmrac completion SHELL`: a script that completes commands, options and names in a shell."""

import argparse
from typing import Final

from configs.loader import CONFIG_DIRECTORY

DESCRIPTION: Final = "Print a completion script for a shell: subcommands, options, names of configuration files, paths."
EXAMPLES: Final = """examples:
  dmrac completion bash > ~/.local/share/bash-completion/completions/dmrac
  dmrac completion zsh > ~/.zfunc/_dmrac           with `fpath+=~/.zfunc` before `compinit` in ~/.zshrc

The script holds the names of today's configurations: print it again after adding some.
"""
SHELLS: Final = ("bash", "zsh", "tcsh")
NAMED: Final = {
    "scenario": ("scenarios", "*.yaml"),
    "controller": ("controllers", "*.yaml"),
    "campaign": ("campaigns", "*.yaml"),
    "traces": ("dropouts", "*"),
}
"""The folder of configs/ whose names an argument takes, by the argument's name."""
FOLDERS: Final = {"folder", "flight", "flights", "sources", "places", "memory"}
FILES: Final = {"out", "save", "config", "bode", "page", "certificate", "save_trace", "file"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac completion`."""
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def run(arguments: argparse.Namespace) -> int:
    """Print the script; returns 0."""
    import shtab

    from async_dmrac.command_line import build_whole_parser

    parser = build_whole_parser()
    _describe(parser, shtab.FILE, shtab.DIRECTORY)
    print(shtab.complete(parser, shell=arguments.shell))
    return 0


def _describe(parser: argparse.ArgumentParser, file: dict[str, str], folder: dict[str, str]) -> None:
    """Tell the generator which arguments are names of configurations, files or folders."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _describe(below, file, folder)
        elif action.dest in NAMED and action.choices is None:
            action.choices = names(action.dest)
        elif action.dest in FOLDERS:
            action.complete = folder  # type: ignore[attr-defined]
        elif action.dest in FILES or action.dest.endswith("key_file"):
            action.complete = file  # type: ignore[attr-defined]


def names(argument: str) -> list[str]:
    """The names of the configurations that an argument takes."""
    below, pattern = NAMED[argument]
    return sorted(path.stem for path in (CONFIG_DIRECTORY / below).glob(pattern) if path.suffix in (".yaml", ".csv"))
