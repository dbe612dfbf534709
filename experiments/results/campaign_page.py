"""One self-contained HTML page about a campaign: first paragraph, tables, figures, configuration, versions."""

import base64
import html
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import yaml

from experiments.results.campaign_data import CampaignData
from experiments.results.figure_plan import Picture
from experiments.results.losses import first_paragraph
from experiments.results.tables import Table, tables
from runtime.files import write_atomically

STYLE: Final = """
body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#111}
table{border-collapse:collapse;margin:1.5rem 0;font-size:13px;display:block;overflow-x:auto}
caption{text-align:left;font-weight:600;padding-bottom:.4rem}
td,th{border-bottom:1px solid #ddd;padding:.25rem .6rem;text-align:left;white-space:nowrap}
figure{margin:1.5rem 0}img{max-width:100%}figcaption{color:#444;font-size:13px}
pre{background:#f6f6f6;padding:1rem;overflow-x:auto;font-size:12px}
"""


def write_page(path: Path, data: CampaignData, pictures: Sequence[Picture], extra: Sequence[Table]) -> None:
    """Writes the page, complete or not at all."""
    title = html.escape(data.config.title or data.name)
    opening = re.sub(r"\*\*(.+?)\*\*", r"<strong>\1</strong>", html.escape(first_paragraph(data)))
    body = [f"<h1>{title}</h1>", f"<p>{opening}</p>", f"<p>{html.escape(data.config.description)}</p>"]
    body += [table.html() for table in [*tables(data), *extra]]
    body += [_figure(picture) for picture in pictures]
    body.append(f"<h2>Made with</h2><pre>{html.escape(_provenance(data))}</pre>")
    text = f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
    text += f"<style>{STYLE}</style></head><body>{''.join(body)}</body></html>\n"
    write_atomically(path, text.encode())


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
