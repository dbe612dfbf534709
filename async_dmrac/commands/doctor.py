"""`dmrac doctor`: what is installed here, and what this machine grants a flight."""

import argparse
from pathlib import Path

from rich.text import Text

from async_dmrac.commands.output import add_json_option, console_for, print_json
from async_dmrac.doctor import examine
from runtime.waiting import waiting

DESCRIPTION = "Check installation and machine: packages, compiler, clock, priorities, ports, disk. Changes nothing."
EXAMPLES = """examples:
  dmrac doctor
  dmrac doctor --json

exit status: 0 a flight can run here, 1 something that it needs is missing
"""
COLOURS = {"ok": "green", "absent": "yellow", "warning": "yellow", "missing": "bold red"}
NAME_WIDTH = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac doctor`."""
    add_json_option(parser, "the findings")


def run(arguments: argparse.Namespace) -> int:
    """Check and print; returns 0, or 1 if something is missing that a flight needs."""
    console = console_for(arguments)
    with waiting("checking", console):
        findings = list(examine(Path()))
    if arguments.json:
        print_json(findings)
    else:
        for one in findings:
            line = Text(f"{one.name:<{NAME_WIDTH}}").append(f"{one.state:<9}", style=COLOURS[one.state])
            console.print(line.append(one.detail), soft_wrap=True, highlight=False)
            if one.remedy:
                console.print(Text(f"{'':<{NAME_WIDTH + 9}}-> {one.remedy}"), soft_wrap=True, highlight=False)
    return int(any(one.state == "missing" for one in findings))
