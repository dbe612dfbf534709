"""The steps of `dmrac reproduce`, from flights to docs/results.md; each can be resumed."""

import math
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.flown import is_campaign, publish, read_about, unpublish
from experiments.campaigns.provenance import commits_of
from experiments.campaigns.runner import CampaignRun, Progress, open_store, prepare_folder, run_campaign
from experiments.campaigns.worker_pools import Workers
from experiments.results.campaign_data import OURS
from experiments.results.campaign_page import CampaignReport, write_report
from experiments.results.comparisons import BETTER, OPEN, WORSE, Comparison, judged, verdict_counts
from experiments.results.figure_style import save
from experiments.results.heat_map import HEAT_MAP_CAPTION, draw_heat_map, losses_first
from experiments.results.tables import TARGET_HEADER, Table
from onboard.cores import NUMPY, core_option
from runtime.files import write_atomically

CAMPAIGNS: Final = (
    *(
        "wind_figure8",
        "wind_lissajous",
        "chip_in_flight",
        "retention",
        "transfer",
        "memory",
        "rotor_chip",
        "steady_wind",
    ),
    *("cloth_circle", "survival", "second_vehicle", "third_vehicle", "adaptive_quad_cases"),
    *("sim_to_real", "features", "dropouts"),
    *("shared_trainer", "paper_preset", "ablations"),
)
"""In the order of docs/results.md."""

PICTURES: Final = Path("pictures") / "results"
"""Folder of the pictures, beside the page."""
HEAT_MAP: Final = "heat_map"
OTHER_SETTINGS: Final = (
    "**Flown with other settings than those of today: the campaign's file or the configuration has changed since.** "
    "Texts, targets and figures are those of then."
)


@dataclass(frozen=True)
class Reproduction:
    """The campaigns to fly, and the files to write."""

    folder: Path
    """Parent of the campaigns' folders."""
    page: Path
    """docs/results.md, or another page; its pictures are in pictures/results beside it."""
    quick: bool
    seeds: int | None = None
    """Seeds per point; None: each campaign's number."""
    only: tuple[str, ...] = CAMPAIGNS
    """Campaigns to fly."""
    extend: bool = False
    """Start from the rows beside the page, and keep its other campaigns."""
    core: str = NUMPY
    """The onboard core that flies, one of onboard.cores.CORES."""

    @property
    def shown(self) -> tuple[str, ...]:
        """Campaigns on the page."""
        published = {name for name in CAMPAIGNS if self.extend and row_file(self, name).exists()}
        return tuple(name for name in CAMPAIGNS if name in published or name in self.only)

    @property
    def command(self) -> str:
        """The command that rebuilds the page."""
        words = ["dmrac reproduce"]
        words += ["--quick"] if self.quick else []
        words += ["--extend"] if self.extend else []
        words += [f"--seeds {self.seeds}"] if self.seeds is not None else []
        words += core_option(self.core)
        words += ["--only", *self.only] if self.only != CAMPAIGNS else []
        return " ".join(words)

    def run(self, name: str) -> CampaignRun:
        """Return one of the campaigns."""
        campaign, _ = load_campaign(name)
        seeds = campaign.quick_seeds if self.quick else self.seeds
        return CampaignRun(campaign, name, self.folder / name, seeds, core=self.core)


def fly(
    plan: Reproduction, name: str, open_workers: Callable[[], Workers], report: Callable[[Progress], None]
) -> Progress:
    """Fly what is missing of one campaign. Raises ConfigError if its folder has flights with other settings."""
    run = plan.run(name)
    prepare_folder(run, resume=True)
    with open_store(run.folder) as store:
        return run_campaign(run, store, open_workers(), report)


def draw(plan: Reproduction, name: str, report: Callable[[str], None]) -> CampaignReport:
    """Draw one campaign, write its own page, and copy pictures, rows and tables made from traces beside results.md."""
    out = plan.folder / name / "figures"
    made = write_report(plan.folder / name, out, report)
    _show(plan, [*(picture.png for picture in made.pictures), *out.glob(f"{name}_[0-9][0-9]_*.json")])
    publish_rows(plan, name)
    return made


def _show(plan: Reproduction, files: Iterable[Path]) -> None:
    """Copy files into the page's folder of pictures."""
    picture_folder(plan).mkdir(parents=True, exist_ok=True)
    for path in files:
        shutil.copyfile(path, picture_folder(plan) / path.name)


def picture_folder(plan: Reproduction) -> Path:
    """Return the folder of the page's pictures."""
    return plan.page.parent / PICTURES


def row_file(plan: Reproduction, name: str) -> Path:
    """Return the file of one campaign's published rows, beside the page."""
    return plan.page.parent / "data" / f"{name}.parquet"


def publish_rows(plan: Reproduction, name: str) -> Path:
    """Write one campaign's rows beside the page."""
    file = row_file(plan, name)
    publish(plan.folder / name, file)
    return file


def copy_published(plan: Reproduction, name: str, extended: bool) -> int:
    """Copy published rows and pictures into a new folder of a campaign; return the number of rows, 0 if it exists.

    extended: whether more will be flown into the folder, and not only the page be built.

    Raises ConfigError if they are to be extended and were flown with other settings: the two are never mixed.
    """
    folder, file = plan.folder / name, row_file(plan, name)
    if is_campaign(folder) or not file.exists():
        return 0
    if extended:
        campaign, _ = load_campaign(name)
        advice = f"repeat them without --extend: dmrac reproduce --only {name}"
        read_about(file).check_settings(campaign, f"--extend {file}", advice)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    for path in picture_folder(plan).glob(f"{name}_[0-9][0-9]_*"):
        shutil.copyfile(path, folder / "figures" / path.name)
    return unpublish(file, folder)


def write_results(plan: Reproduction, reports: Sequence[CampaignReport]) -> None:
    """Write the page: losses, heat map, targets, provenance, number of verdicts, then a section for each campaign."""
    compared = judged([one for report in reports for one in report.compared])
    of = {report.data.title: [one for one in compared if one.campaign == report.data.title] for report in reports}
    parts = ["# Results\n", _heat_map(plan, reports)]
    targets = _targets(reports)
    parts += [targets.markdown()] if targets.rows else []
    parts += [_provenance(plan, reports)]
    parts += [_verdicts(of).markdown(), _statistics(len(compared))]
    for report in reports:
        rows = row_file(plan, report.data.name).relative_to(plan.page.parent)
        flown_on = " and on ".join(report.data.flown_on)
        where = f"All flights of this campaign, one per row: [{rows}]({rows}). "
        where += f"Flown on {flown_on}." if flown_on else ""
        where += "\n" if report.data.as_today else f" {OTHER_SETTINGS}\n"
        parts.append(report.markdown(of[report.data.title], PICTURES, where))
    write_atomically(plan.page, "\n".join(parts).encode())


def _heat_map(plan: Reproduction, reports: Sequence[CampaignReport]) -> str:
    rows = [row for report in reports for row in report.heat_map]
    if not rows:
        return ""
    folder = plan.folder / "figures"
    save(draw_heat_map(rows), folder, HEAT_MAP)
    _show(plan, [folder / f"{HEAT_MAP}.png"])
    picture = f"{(PICTURES / HEAT_MAP).as_posix()}.png"
    image = f"![Heat map of the errors by controller and condition]({picture})"
    return f"{losses_first(rows)}\n{image}\n\n*{HEAT_MAP_CAPTION}*\n"


def _provenance(plan: Reproduction, reports: Sequence[CampaignReport]) -> str:
    flights = sum(len(report.data.rows) for report in reports)
    failed = sum(len(report.data.failed) for report in reports)
    used = [row["cpu_s"] for report in reports for row in report.data.rows if math.isfinite(row["cpu_s"])]
    commits = commits_of(line for report in reports for line in report.data.flown_on)
    return (
        f"Flown with the code of commits {', '.join(commits) or 'unknown'}; each section lists its own. "
        "Flights of other commits may differ ([the same to the bit](experiments.md#the-same-to-the-bit)). "
        f"Made by `{plan.command}`; no number or picture is edited by hand. "
        f"{flights} flights ({failed} failed), {sum(used) / 3600.0:.1f} core hours of flying.\n"
    )


def _verdicts(of: Mapping[str, Sequence[Comparison]]) -> Table:
    rows = tuple((title, str(len(found)), *map(str, verdict_counts(found))) for title, found in of.items() if found)
    caption = f"Comparisons of {OURS} with every other controller: survival, and each error in the tables"
    return Table(caption, ("campaign", "comparisons", BETTER, WORSE, OPEN), rows)


def _statistics(comparisons: int) -> str:
    return (
        "A comparison pairs the flights by seed and uses the exact sign test; for survival this is McNemar's test. "
        "The verdicts are significant at the 5 % level after Holm's correction (1979) for all "
        f"{comparisons} comparisons of this page: if no two controllers differed, the probability of a single verdict "
        "would be below 5 %. Targets are compared with the medians, without a test. Medians are over survivors, with "
        "95 % bootstrap intervals (from six flights on); survival has Wilson intervals; ratios are medians of ratios "
        "paired by seed. The intervals are not corrected. [experiments.md](experiments.md) explains each column.\n"
    )


def _targets(reports: Sequence[CampaignReport]) -> Table:
    rows = tuple(row for report in reports for row in report.targets)
    return Table("Targets", ("campaign", *TARGET_HEADER), rows)
