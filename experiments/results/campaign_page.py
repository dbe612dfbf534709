"""The results of one campaign, as a section of docs/results.md or as a page: verdicts, tables and figures."""

import base64
import html
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import yaml

from experiments.results.campaign_data import CampaignData, load_data
from experiments.results.comparisons import Comparison, comparisons, judged, losses, summary
from experiments.results.figure_plan import Picture, draw_all
from experiments.results.heat_map import HeatMapRow, heat_map_rows
from experiments.results.tables import Table, tables, target_rows
from runtime.files import write_atomically

STYLE: Final = """
body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#111}
table{border-collapse:collapse;margin:1.5rem 0;font-size:13px;display:block;overflow-x:auto}
caption{text-align:left;font-weight:600;padding-bottom:.4rem}
td,th{border-bottom:1px solid #ddd;padding:.25rem .6rem;text-align:left;white-space:nowrap}
figure{margin:1.5rem 0}img{max-width:100%}figcaption{color:#444;font-size:13px}
pre{background:#f6f6f6;padding:1rem;overflow-x:auto;font-size:12px}
"""


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
        title = html.escape(self.data.title)
        opening = html.escape(summary(self.data, compared)).replace("**", "")
        body = [f"<h1>{title}</h1>", f"<p>{html.escape(self.data.config.description)}</p>", f"<p>{opening}</p>"]
        body += [table.html() for table in (*([lost] if lost else []), *self.tables)]
        body += [_figure(picture) for picture in self.pictures]
        body.append(f"<h2>Provenance and configuration</h2><pre>{html.escape(_provenance(self.data))}</pre>")
        head = f'<head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style></head>'
        return f'<!doctype html><html lang="en">{head}<body>{"".join(body)}</body></html>\n'


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


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png.read_bytes()).decode()
    caption = html.escape(picture.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )


def _provenance(data: CampaignData) -> str:
    seconds = sum(row["cpu_s"] for row in data.rows if math.isfinite(row["cpu_s"]))
    lines = [*data.flown_on, f"{len(data.rows)} flights, {seconds:.0f} s of processor time, {len(data.failed)} failed"]
    config = yaml.safe_dump(data.config.model_dump(mode="json"), sort_keys=False, allow_unicode=True, width=110)
    return "\n".join([*lines, "", config])
