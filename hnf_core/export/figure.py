"""How every picture of this project is drawn and saved: one style, no display, no global state."""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from ..errors import FileError
from ..files import write_bytes
from .tracks import INK, MUTED

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BACKGROUND = "#fbfbf9"
PNG_COMPRESSION = 4
"""Of zlib's levels: half the time of the usual 6 for 3 % more bytes."""
STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "font.size": 10.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": "#b9c0c8",
    "axes.facecolor": "#ffffff",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8eaed",
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "figure.facecolor": BACKGROUND,
    "text.parse_math": False,
    "svg.hashsalt": "hnf",
}


def write_figure(path: Path, size_px: tuple[int, int], draw: Callable[[Figure], None]) -> None:
    """Let draw fill an empty figure of size_px and save it, atomically: as SVG where path says so, else as PNG.

    Equal input gives equal bytes with one version of matplotlib. Raises FileError where matplotlib is missing or the
    file cannot be written.
    """
    try:
        import matplotlib.style
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise FileError(
            f"pictures need matplotlib ({error}).", where=str(path), remedy="Install it, or go without pictures."
        ) from error
    with matplotlib.style.context(["default", STYLE]), warnings.catch_warnings():
        # Names in scripts that the font lacks show as boxes; that is no reason to write to the terminal.
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = Figure(figsize=(size_px[0] / 100, size_px[1] / 100), dpi=100)
        FigureCanvasAgg(figure)
        draw(figure)
        buffer = io.BytesIO()
        made_by = f"Haptic Neural Fields {__version__}"
        if Path(path).suffix.lower() == ".svg":
            figure.savefig(buffer, format="svg", metadata={"Creator": made_by, "Date": None})
        else:
            packed = {"compress_level": PNG_COMPRESSION}
            figure.savefig(buffer, format="png", dpi=100, metadata={"Software": made_by}, pil_kwargs=packed)
    write_bytes(Path(path), buffer.getvalue())
