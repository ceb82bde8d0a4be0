"""Small pictures as data sets hold them: JPEG or PNG in sRGB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

image = pytest.importorskip("PIL.Image", reason="needs Pillow to write small pictures")

MID_GREY = 188
"""sRGB code of linear 0.5028."""


def write_picture(path: Path, width: int = 64, height: int = 48, colour=(MID_GREY, 128, 0), mode: str = "RGB") -> Path:
    """One colour throughout, so that a JPEG keeps it to two codes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    fill = colour if mode == "RGB" else (colour[0] if mode == "L" else (*colour, 7))
    image.new(mode, (width, height), fill).save(path)
    return path


def write_pixels(path: Path, values) -> Path:
    """(H, W, 3) codes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    image.fromarray(np.asarray(values, dtype=np.uint8)).save(path)
    return path


def linear(code: float) -> float:
    """IEC 61966-2-1."""
    value = code / 255.0
    return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4
