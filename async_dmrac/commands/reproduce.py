"""`dmrac reproduce`: flies every campaign and rebuilds docs/results.md with its tables and figures."""

import argparse
import time
from pathlib import Path

from rich.console import Console

from async_dmrac.commands.worker_options import add_worker_options, open_workers, positive, progress_bar
from configs.loader import ConfigError

EXAMPLES = """examples:
  dmrac reproduce --quick          every campaign with few seeds, minutes; page and figures in campaigns/quick
  dmrac reproduce                  the full one, hours; goes on where it was interrupted
  dmrac reproduce --seeds 20       fewer seeds a point
  dmrac reproduce --only retention transfer
  dmrac reproduce --extend --seeds 40
                                   from the rows in docs/data on: fly what they lack of 40 seeds
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `dmrac reproduce`."""
    parser.add_argument("--quick", action="store_true", help="few seeds a point; leaves docs/results.md alone")
    parser.add_argument("--seeds", type=positive, metavar="N", help="seeds a point (default: each campaign's own)")
    parser.add_argument("--only", nargs="+", metavar="CAMPAIGN", help="these campaigns alone")
    parser.add_argument(
        "--extend",
        action="store_true",
        help="go on from the rows published beside the page, and keep there what is not flown now",
    )
    add_worker_options(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="flights (default: campaigns/full or campaigns/quick)")
    parser.add_argument("--page", type=Path, metavar="FILE", help="page to write (default: docs/results.md)")
    parser.add_argument("--draw-only", action="store_true", help="fly nothing, rebuild the page from what was flown")


def run(arguments: argparse.Namespace) -> int:
    """Exit status: 0 done, 1 some flights failed, 130 interrupted (call again to go on)."""
    from experiments.results.reproduction import (
        CAMPAIGNS,
        Reproduction,
        draw,
        fly,
        take_up,
        write_results,
    )

    unknown = [name for name in arguments.only or () if name not in CAMPAIGNS]
    if unknown:
        raise ConfigError(f"--only {unknown[0]}: allowed are {', '.join(CAMPAIGNS)}")
    folder = arguments.out or Path("campaigns") / ("quick" if arguments.quick else "full")
    page = arguments.page or (folder / "results.md" if arguments.quick else Path("docs/results.md"))
    only = tuple(name for name in CAMPAIGNS if name in (arguments.only or CAMPAIGNS))
    plan = Reproduction(folder, page, arguments.quick, arguments.seeds, only, arguments.extend)
    console = Console()

    started, sections, failed = time.monotonic(), [], 0
    try:
        for name in plan.shown:
            if plan.extend and (rows := take_up(plan, name)):
                console.print(f"{name}: {rows} flights taken up from those published beside the page", highlight=False)
            if name in plan.only and not arguments.draw_only:
                with progress_bar(name, console) as report:
                    failed += fly(plan, name, lambda: open_workers(arguments), report).errors
            sections.append(draw(plan, name, lambda text: console.print(f"  {text}", highlight=False, soft_wrap=True)))
            write_results(plan, sections)
    except KeyboardInterrupt:
        console.print("interrupted; everything flown is kept, the same command goes on")
        return 130
    console.print(
        f"written: {page}, {(time.monotonic() - started) / 60.0:.1f} minutes", soft_wrap=True, highlight=False
    )
    return 1 if failed else 0
