"""How training went, in one picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .figure import write_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TRAINING_CURVE_SIZE_PX = (900, 520)


def write_training_curve(path: Path, title: str, history: NDArray[np.float64]) -> None:
    """history: (epochs, 3) number, training and validation loss. Marks the epoch that was kept. Raises FileError."""
    kept = int(np.argmin(history[:, 2]))

    def draw(figure: Figure) -> None:
        axes = figure.add_axes((0.1, 0.13, 0.86, 0.73))
        axes.plot(history[:, 0], history[:, 1], color="#8a94a0", label="training")
        axes.plot(history[:, 0], history[:, 2], color="#2a6f97", label="validation")
        axes.plot(history[kept, 0], history[kept, 2], "o", color="#d1495b", label=f"kept: epoch {kept + 1}")
        axes.set(xlabel="epoch", ylabel="negative log-likelihood per bin")
        axes.legend(frameon=False)
        figure.text(0.1, 0.92, title, fontsize=14, fontweight="bold")

    write_figure(path, TRAINING_CURVE_SIZE_PX, draw)
