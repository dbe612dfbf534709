"""Every campaign from flights to docs/results.md: what `dmrac reproduce` does, step by step and resumable."""

import math
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

from experiments.campaigns.campaign import load_campaign
from experiments.campaigns.flown import is_campaign, publish, read_about, unpublish
from experiments.campaigns.runner import CampaignRun, Progress, Workers, open_store, prepare_folder, run_campaign
from experiments.results.campaign_data import CampaignData, load_data
from experiments.results.campaign_page import write_page
from experiments.results.figure_plan import Picture, draw_all
from experiments.results.losses import comparisons, first_paragraph
from experiments.results.tables import TARGET_HEADER, Table, markdown_report, target_rows
from runtime.files import write_atomically

CAMPAIGNS: Final = (
    *("wind_figure8", "chip_in_flight", "retention", "transfer", "rotor_chip", "steady_wind", "cloth_circle"),
    *("sim_to_real", "features", "dropouts", "shared_trainer", "paper_preset", "ablations"),
)
"""In the order of docs/results.md."""


@dataclass(frozen=True)
class Reproduction:
    """What to fly, and where to write."""

    folder: Path
    """Campaign folders go below it."""
    page: Path
    """docs/results.md, or a page elsewhere; pictures go beside it into pictures/results."""
    quick: bool
    seeds: int | None = None
    """So many a point instead of the campaigns' own number."""
    only: tuple[str, ...] = CAMPAIGNS
    """What is flown."""
    extend: bool = False
    """Go on from the rows beside the page, and keep on it what is not flown now."""

    @property
    def shown(self) -> tuple[str, ...]:
        """Campaigns on the page."""
        kept = {name for name in CAMPAIGNS if self.extend and row_file(self, name).exists()}
        return tuple(name for name in CAMPAIGNS if name in kept or name in self.only)

    @property
    def command(self) -> str:
        """The command that makes the page again."""
        words = ["dmrac reproduce"]
        words += ["--quick"] if self.quick else []
        words += ["--extend"] if self.extend else []
        words += [f"--seeds {self.seeds}"] if self.seeds is not None else []
        words += ["--only", *self.only] if self.only != CAMPAIGNS else []
        return " ".join(words)

    def run(self, name: str) -> CampaignRun:
        """One campaign of it."""
        campaign, _ = load_campaign(name)
        seeds = campaign.quick_seeds if self.quick else self.seeds
        return CampaignRun(campaign, name, self.folder / name, seeds)


@dataclass(frozen=True)
class Section:
    """One campaign of the page."""

    data: CampaignData
    pictures: tuple[Picture, ...]
    extra: tuple[Table, ...]

    @cached_property
    def losses(self) -> str:
        """Its line of the page's first paragraph; "" if DMRAC flew alone."""
        if not any(comparisons(self.data)):
            return ""
        return f"- {self.data.config.title or self.data.name}: {first_paragraph(self.data, brief=True)}"

    @cached_property
    def report(self) -> str:
        """Its part of the page, worked out once: the page is written anew after every campaign."""
        listed = [(Path("pictures/results") / one.png.name, one.caption) for one in self.pictures]
        return "\n".join([markdown_report(self.data, listed), *(table.markdown() for table in self.extra)])

    @cached_property
    def targets(self) -> list[tuple[str, ...]]:
        """Its rows of the table of targets."""
        title = self.data.config.title or self.data.name
        return [(title, *row) for row in target_rows(self.data)]


def fly(
    plan: Reproduction, name: str, open_workers: Callable[[], Workers], report: Callable[[Progress], None]
) -> Progress:
    """Flies what is missing of one campaign. Raises ConfigError if its folder holds flights of other settings."""
    run = plan.run(name)
    prepare_folder(run, resume=True)
    with open_store(run.folder) as store:
        return run_campaign(run, store, open_workers(), report)


def draw(plan: Reproduction, name: str, report: Callable[[str], None]) -> Section:
    """Figures and page of one campaign; its PNGs, and tables that need traces, are copied beside results.md."""
    data = load_data(plan.folder / name)
    out = plan.folder / name / "figures"
    pictures, extra = draw_all(data, out, report)
    write_page(out / "report.html", data, pictures, extra)
    shown = picture_folder(plan)
    shown.mkdir(parents=True, exist_ok=True)
    for path in [*(picture.png for picture in pictures), *out.glob(f"{name}_[0-9][0-9]_*.json")]:
        shutil.copyfile(path, shown / path.name)
    publish_rows(plan, name)
    return Section(data, tuple(pictures), tuple(extra))


def picture_folder(plan: Reproduction) -> Path:
    """Where the page's pictures lie."""
    return plan.page.parent / "pictures" / "results"


def row_file(plan: Reproduction, name: str) -> Path:
    """Where one campaign's rows lie beside the page, for those who want to look at the numbers in another way."""
    return plan.page.parent / "data" / f"{name}.parquet"


def publish_rows(plan: Reproduction, name: str) -> Path:
    """Writes one campaign's rows beside the page."""
    file = row_file(plan, name)
    publish(plan.folder / name, file)
    return file


def take_up(plan: Reproduction, name: str) -> int:
    """Lays published rows and pictures into a campaign's folder that is not there yet; returns the number of rows.

    Raises ConfigError if they were flown with other settings.
    """
    folder, file = plan.folder / name, row_file(plan, name)
    if is_campaign(folder) or not file.exists():
        return 0
    campaign, _ = load_campaign(name)
    advice = f"fly them anew without --extend: dmrac reproduce --only {name}"
    read_about(file).check_settings(campaign, f"--extend {file}", advice)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    for path in picture_folder(plan).glob(f"{name}_[0-9][0-9]_*"):
        shutil.copyfile(path, folder / "figures" / path.name)
    return unpublish(file, folder)


def write_results(plan: Reproduction, sections: Sequence[Section]) -> None:
    """Writes the page, complete or not at all."""
    parts = ["# Results\n", _opening(sections), _provenance(plan, sections)]
    targets = _targets(sections)
    parts += [targets.markdown()] if targets.rows else []
    for section in sections:
        parts.append(section.report)
        rows = row_file(plan, section.data.name).relative_to(plan.page.parent)
        parts.append(f"All of these flights, a row each: [{rows}]({rows}). {_flown_on(section.data)}\n")
    write_atomically(plan.page, "\n".join(parts).encode())


def _opening(sections: Sequence[Section]) -> str:
    """The first paragraph: where DMRAC loses, campaign by campaign."""
    lines = [section.losses for section in sections if section.losses]
    return "\n".join(lines or ["These campaigns fly DMRAC alone: there is no other controller to lose against."]) + "\n"


def _provenance(plan: Reproduction, sections: Sequence[Section]) -> str:
    flights = sum(len(section.data.rows) for section in sections)
    failed = sum(len(section.data.failed) for section in sections)
    used = [row["cpu_s"] for section in sections for row in section.data.rows if math.isfinite(row["cpu_s"])]
    return (
        f"Made by `{plan.command}`, no number or picture is edited by hand. "
        f"{flights} flights ({failed} failed), {sum(used) / 3600.0:.1f} core hours of flying; each section says where. "
        "Medians are over survivors, with 95 % bootstrap intervals (six flights at least); survival has Wilson "
        "intervals; ratios are paired by seed, and so is the test of survival (McNemar's, exact). Nothing is "
        "corrected for the number of comparisons: between equals, one in forty would be called a loss. "
        "What each column means: [experiments.md](experiments.md).\n"
    )


def _flown_on(data: CampaignData) -> str:
    return f"Flown on {' and on '.join(data.flown_on)}." if data.flown_on else ""


def _targets(sections: Sequence[Section]) -> Table:
    rows = tuple(row for section in sections for row in section.targets)
    return Table("Targets", ("campaign", *TARGET_HEADER), rows)
