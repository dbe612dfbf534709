"""The results of one campaign, as a section of docs/results.md or as a page: verdicts, tables and figures."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import yaml

from experiments.results.campaign_data import CampaignData, load_data
from experiments.results.comparisons import Comparison, comparisons, judged, losses, summary
from experiments.results.figure_plan import Picture, draw_all
from experiments.results.heat_map import HeatMapRow, heat_map_rows
from experiments.results.tables import Table, tables, target_rows
from flight_log.html import code, figure, page, paragraph, section
from runtime.files import write_atomically


@dataclass(frozen=True)
class CampaignReport:
    """The results of one campaign."""

    data: CampaignData
    pictures: tuple[Picture, ...] = ()
    extra: tuple[Table, ...] = ()
    """Tables that were computed from traces."""

    @cached_property
    def compared(self) -> tuple[Comparison, ...]:
        """All comparisons, without verdicts: these depend on how many there are on the page."""
        return tuple(comparisons(self.data))

    @cached_property
    def tables(self) -> tuple[Table, ...]:
        """All tables but that of the losses."""
        return (*tables(self.data), *self.extra)

    @cached_property
    def heat_map(self) -> tuple[HeatMapRow, ...]:
        """Rows of the heat map."""
        return tuple(heat_map_rows(self.data))

    @cached_property
    def targets(self) -> tuple[tuple[str, ...], ...]:
        """Rows of the table of targets."""
        return tuple((self.data.title, *row) for row in target_rows(self.data))

    def markdown(self, compared: Sequence[Comparison], pictures: Path, rows: str = "") -> str:
        """Return the section: verdicts, losses and the first figure, then everything else, folded.

        Parameters
        ----------
        compared: this campaign's comparisons with their verdicts.
        pictures: folder of the pictures, as seen from the page.
        rows: a sentence on where the flights' rows are.
        """
        lost = losses(compared)
        shown = [
            f"![{one.caption}]({(pictures / one.png.name).as_posix()})\n\n*{one.caption}*\n" for one in self.pictures
        ]
        parts = [f"## {self.data.title}\n", self.data.config.description + "\n"]
        parts += [f"{summary(self.data, compared)} `{self.data.command}`\n"]
        parts += [lost.markdown()] if lost else []
        parts += [*shown[:1], "<details>\n<summary>All tables and figures</summary>\n"]
        parts += [*(table.markdown() for table in self.tables), *shown[1:], "</details>\n"]
        return "\n".join([*parts, rows] if rows else parts)

    def html(self) -> str:
        """Return a self-contained page; its verdicts are corrected for the comparisons of this campaign."""
        compared = judged(self.compared)
        lost = losses(compared)
        return page(
            self.data.title,
            [
                paragraph(self.data.config.description),
                paragraph(summary(self.data, compared).replace("**", "")),
                *(table.html() for table in (*([lost] if lost else []), *self.tables)),
                *(figure(picture.png.read_bytes(), picture.caption) for picture in self.pictures),
                section("Provenance and configuration", code(_provenance(self.data))),
            ],
        )


def write_report(folder: Path, out: Path, report: Callable[[str], None]) -> CampaignReport:
    """Draw a campaign's figures into `out` and write report.html and report.md beside them.

    Raises
    ------
    ConfigError
        If `folder` is not a campaign's, or an entry of the campaign's `figures` is wrong.
    """
    data = load_data(folder)
    out.mkdir(parents=True, exist_ok=True)
    pictures, extra = draw_all(data, out, report)
    made = CampaignReport(data, tuple(pictures), tuple(extra))
    write_atomically(out / "report.html", made.html().encode())
    write_atomically(out / "report.md", made.markdown(judged(made.compared), Path()).encode())
    return made


def _provenance(data: CampaignData) -> str:
    seconds = sum(row["cpu_s"] for row in data.rows if math.isfinite(row["cpu_s"]))
    lines = [*data.flown_on, f"{len(data.rows)} flights, {seconds:.0f} s of processor time, {len(data.failed)} failed"]
    config = yaml.safe_dump(data.config.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=110)
    return "\n".join([*lines, "", config])
