"""How figures look: one colour, line and marker for each controller, told apart in black and white too."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

WIDTH_IN: Final = 8.0
DPI: Final = 130
ASKED: Final = "Description"
"""Keyword of a PNG under which it says what it was drawn for."""
LABEL_CHARACTERS: Final = 36
"""Longer labels of an upright axis take two lines."""


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
    "bias": Style("#009e73", (0, (3, 1, 1, 1, 1, 1)), "D"),
    "mrac": Style("#d55e00", (0, (4, 2)), "P"),
    "dmrac": Style("#0072b2", "-", "o"),
    "paper_mrac": Style("#d55e00", ":", "p"),
    "paper_dmrac": Style("#0072b2", ":", "h"),
}
SPARE: Final = (Style("#000000", "-", "*"), Style("#f0e442", "--", "<"), Style("#555555", "-.", ">"))


def style(controller: str) -> Style:
    """A controller's style; unknown ones get a spare one by name."""
    if controller in STYLES:
        return STYLES[controller]
    return SPARE[sum(controller.encode()) % len(SPARE)]


def new_figure(height_in: float, width_in: float = WIDTH_IN) -> Any:
    """An empty figure with a canvas of its own: no global state of pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def finish(panel: Any, x_label: str = "", y_label: str = "", title: str = "") -> None:
    """Labels and a light grid."""
    panel.grid(alpha=0.25, linewidth=0.6)
    if x_label:
        panel.set_xlabel(x_label)
    if y_label:
        long = len(y_label) > LABEL_CHARACTERS and ", " in y_label
        panel.set_ylabel(y_label.replace(", ", ",\n", 1) if long else y_label)
    if title:
        panel.set_title(title, fontsize=10)


def legend_below(figure: Any, panels: Sequence[Any], columns: int = 7, neutral: str = "") -> None:
    """One legend for all panels, outside them, so that it covers nothing.

    neutral: the label whose line is drawn black, because each panel shows it in another colour.
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
    """Writes PNG and SVG; the SVG carries no date, so that it only changes when its content does.

    asked: what it was drawn for; the PNG keeps it, for `drawn_for`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"{name}.png", dpi=DPI, metadata={ASKED: asked})
    import matplotlib

    with matplotlib.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None})


def drawn_for(png: Path) -> str | None:
    """What a picture was drawn for, as `save` was told; None if there is no picture that says so."""
    from PIL import Image

    try:
        with Image.open(png) as image:
            return image.info.get(ASKED)
    except OSError:  # there is none, or no picture
        return None
