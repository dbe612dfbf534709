"""A Bode plot of measured and predicted loops."""

from pathlib import Path

import numpy as np

from experiments.margins.table import Loop


def draw_bode(controller: str, loops: list[Loop], path: Path) -> None:
    """Draw magnitude and phase of all loops, one column each, into a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.0 * len(loops), 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(2, len(loops), squeeze=False)
    for column, loop in enumerate(loops):
        response, (magnitude, phase) = loop.measured, panels[:, column]
        lines = [(response.L, "o", "measured")]
        if loop.predicted is not None:
            lines.append((loop.predicted, "-", "predicted"))
        for L, style, label in lines:
            magnitude.loglog(response.omega, np.abs(L), style, label=label, markersize=4)
            phase.semilogx(response.omega, np.degrees(np.unwrap(np.angle(L))), style, markersize=4)
        magnitude.axhline(1.0, color="0.6", linewidth=0.8)
        phase.axhline(-180.0, color="0.6", linewidth=0.8)
        magnitude.set_title(loop.measured.loop)
        phase.set_xlabel("frequency [rad/s]")
    panels[0, 0].set_ylabel("|L|")
    panels[1, 0].set_ylabel("phase of L [deg]")
    panels[0, 0].legend(frameon=False)
    figure.suptitle(f"{controller}: open loops, broken at the demand")
    figure.savefig(path, dpi=120)
