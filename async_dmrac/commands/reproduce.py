"""`dmrac reproduce`: flies every campaign and rebuilds docs/results.md with its tables and figures."""

import argparse
import time
from pathlib import Path

from async_dmrac.commands.shared import (
    add_core_option,
    add_worker_options,
    open_workers,
    plain_console,
    positive,
    progress_bar,
)
from configs.loader import ConfigError
from runtime.waiting import waiting

EXAMPLES = """examples:
  dmrac reproduce --quick          every campaign with few seeds, minutes; page and figures in campaigns/quick
  dmrac reproduce                  all seeds, hours; continues after an interruption
  dmrac reproduce --seeds 20       fewer seeds per point
  dmrac reproduce --only retention transfer
  dmrac reproduce --core c         with the core in C, several times as fast
  dmrac reproduce --extend --seeds 40
                                   start from the rows in docs/data: fly what is missing of 40 seeds
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac reproduce`."""
    parser.add_argument("--quick", action="store_true", help="few seeds per point; does not write docs/results.md")
    parser.add_argument("--seeds", type=positive, metavar="N", help="seeds per point (default: each campaign's)")
    parser.add_argument("--only", nargs="+", metavar="CAMPAIGN", help="only these campaigns")
    parser.add_argument(
        "--extend", action="store_true", help="start from the rows published beside the page; keep its other campaigns"
    )
    add_worker_options(parser)
    add_core_option(parser)
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder of the flights (default: campaigns/full or campaigns/quick)"
    )
    parser.add_argument("--page", type=Path, metavar="FILE", help="page to write (default: docs/results.md)")
    parser.add_argument("--draw-only", action="store_true", help="fly nothing, rebuild the page from the flown flights")


def run(arguments: argparse.Namespace) -> int:
    """Fly and draw; return 0 (done), 1 (some flights failed) or 130 (interrupted; the same command continues)."""
    from experiments.results.reproduction import CAMPAIGNS, Reproduction, copy_published, draw, fly, write_results

    unknown = [name for name in arguments.only or () if name not in CAMPAIGNS]
    if unknown:
        raise ConfigError(f"--only {unknown[0]}: allowed are {', '.join(CAMPAIGNS)}")
    folder = arguments.out or Path("campaigns") / ("quick" if arguments.quick else "full")
    page = arguments.page or (folder / "results.md" if arguments.quick else Path("docs/results.md"))
    only = tuple(name for name in CAMPAIGNS if name in (arguments.only or CAMPAIGNS))
    plan = Reproduction(folder, page, arguments.quick, arguments.seeds, only, arguments.extend, arguments.core)
    console = plain_console()

    started, reports, failed = time.monotonic(), [], 0
    try:
        for name in plan.shown:
            flying = name in plan.only and not arguments.draw_only
            if plan.extend and (rows := copy_published(plan, name, flying)):
                console.print(f"{name}: {rows} published flights copied into {plan.folder / name}")
            if flying:
                with progress_bar(name, console) as report:
                    failed += fly(plan, name, lambda: open_workers(arguments), report).errors
            with waiting(f"comparing and drawing {name}", console):
                reports.append(draw(plan, name, lambda text: console.print(f"  {text}")))
                write_results(plan, reports)
    except KeyboardInterrupt:
        console.print("interrupted; all flown flights are stored, the same command continues")
        return 130
    console.print(f"written: {page}, {(time.monotonic() - started) / 60.0:.1f} minutes")
    return 1 if failed else 0
