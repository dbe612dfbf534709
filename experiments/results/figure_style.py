"""The style of the figures: a colour, line and marker for each controller, distinct in black and white too."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from experiments.results.statistics import Estimate

WIDTH_IN: Final = 8.0
DPI: Final = 130
ASKED: Final = "Description"
"""Keyword of the PNG metadata that holds the entry a picture was drawn for."""
LABEL_CHARACTERS: Final = 36
"""Longer labels of a vertical axis take two lines."""
OUTLIER_RATIO: Final = 5.0
"""A value this much larger than the next smaller one is cut off by `cut_outliers`."""
LOGARITHMIC_FROM: Final = 8.0
"""Ratio of the largest to the smallest value from which `upward_axis` is logarithmic."""


class Style(NamedTuple):
    """Colour (Okabe and Ito), line and marker."""

    colour: str
    line: Any
    marker: str


STYLES: Final = {
    "none": Style("#999999", (0, (1, 1)), "x"),
    "pid": Style("#e69f00", "--", "s"),
    "indi": Style("#cc79a7", (0, (5, 1, 1, 1)), "v"),
    "l1": Style("#56b4e9", "-.", "^"),
    "repetitive": Style("#000000", (0, (2, 1)), "*"),
    "ilc": Style("#555555", (0, (6, 2)), "<"),
    "bias": Style("#009e73", (0, (3, 1, 1, 1, 1, 1)), "D"),
    "mrac": Style("#d55e00", (0, (4, 2)), "P"),
    "dmrac": Style("#0072b2", "-", "o"),
    "paper_mrac": Style("#d55e00", ":", "p"),
    "paper_dmrac": Style("#0072b2", ":", "h"),
}
SPARE: Final = (Style("#000000", "-", "*"), Style("#f0e442", "--", "<"), Style("#555555", "-.", ">"))


def style(controller: str) -> Style:
    """Return a controller's style; an unknown controller gets a spare one, chosen by its name."""
    if controller in STYLES:
        return STYLES[controller]
    return SPARE[sum(controller.encode()) % len(SPARE)]


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Any:
    """Return an empty figure with its own canvas, without the global state of pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(panel: Any, x_label: str = "", y_label: str = "", title: str = "") -> None:
    """Add labels and a light grid to a panel."""
    panel.grid(alpha=0.25, linewidth=0.6)
    if x_label:
        panel.set_xlabel(x_label)
    if y_label:
        long = len(y_label) > LABEL_CHARACTERS and ", " in y_label
        panel.set_ylabel(y_label.replace(", ", ",\n", 1) if long else y_label)
    if title:
        panel.set_title(title, fontsize=10)


def draw_intervals(
    panel: Any, x: Sequence[float], estimates: Sequence[Estimate], controller: str, joined: bool = False
) -> None:
    """Draw a controller's estimates with their intervals, joined by its line or not."""
    look = style(controller)
    values = np.array([(one.value, one.value - one.low, one.high - one.value) for one in estimates]).reshape(-1, 3)
    panel.errorbar(
        x,
        values[:, 0],
        np.nan_to_num(values[:, 1:].T) if estimates else None,
        marker=look.marker,
        color=look.colour,
        linestyle=look.line if joined else "none",
        linewidth=1.1,
        markersize=4.5,
        elinewidth=0.9,
        capsize=2,
        label=controller,
    )


def upward_axis(panel: Any, values: Sequence[float]) -> None:
    """Start the vertical axis at zero; make it logarithmic if the values span a wide range."""
    if not values or min(values) <= 0.0 or max(values) < LOGARITHMIC_FROM * min(values):
        panel.set_ylim(bottom=0.0)
        return
    panel.set_yscale("log")
    plain_ticks(panel.yaxis, (1.0, 2.0, 5.0))


def cut_outliers(panel: Any, points: Sequence[tuple[float, float]]) -> bool:
    """End the vertical axis below values that would squeeze all others, and write these at its end with an arrow.

    Parameters
    ----------
    points: place along the horizontal axis and value of each point.

    Returns
    -------
    Whether a value was cut off.
    """
    values = sorted(value for _, value in points)
    kept = next((count for count in range(1, len(values)) if values[count] > OUTLIER_RATIO * values[count - 1]), None)
    if kept is None or 2 * kept < len(values) or values[0] <= 0.0:
        return False
    top = values[kept - 1]
    panel.set_ylim(0.0, 1.3 * top)
    for place, value in points:
        if value > top:
            panel.annotate(
                f"{value:.2g}",
                (place, 1.28 * top),
                (place, 1.13 * top),
                arrowprops={"arrowstyle": "->"},
                ha="center",
                fontsize=8,
            )
    return True


def plain_ticks(axis: Any, of_a_decade: tuple[float, ...]) -> None:
    """Give a logarithmic axis few ticks, with plain numbers."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axis.set_major_locator(LogLocator(subs=of_a_decade))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_below(figure: Any, panels: Sequence[Any], columns: int = 7, neutral: str = "") -> None:
    """Add one legend for all panels, below them.

    neutral: label whose line is drawn black, because each panel shows it in another colour.
    """
    from matplotlib.lines import Line2D

    found: dict[str, Any] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            found.setdefault(label, Line2D([], [], color="k", linewidth=1.1) if label == neutral else handle)
    if found:
        columns = min(columns, len(found))
        figure.legend(
            found.values(),
            found.keys(),
            loc="outside lower center",
            ncols=columns,
            fontsize=8,
            frameon=False,
            markerscale=1.3,
        )


def save(figure: Any, folder: Path, name: str, asked: str = "") -> None:
    """Write PNG and SVG; the SVG has no date, so that it changes only with its content.

    asked: the entry it was drawn for; stored in the PNG, for `drawn_for`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={ASKED: asked})
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None})


def drawn_for(png: Path) -> str | None:
    """Return the entry that a picture was drawn for, as given to `save`; None if there is none."""
    from PIL import Image

    try:
        with Image.open(png) as image:
            return image.info.get(ASKED)
    except OSError:  # no such file, or not a picture
        return None
