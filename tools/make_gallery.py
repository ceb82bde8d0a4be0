"""Make docs/gallery: ten materials under the same stroke, as sounds for ears, spectrograms and a table of levels.

    .venv/bin/python tools/make_gallery.py

Sounds are encoded by Blender's own audio library. Each is as loud as it goes: the table beside them has the levels.
"""

from __future__ import annotations

import sys
from pathlib import Path

import aud
import bpy  # noqa: F401  first: it puts aud on the path
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import hnf_core as hnf
from hnf_core.export.figure import compute_spectrogram
from hnf_core.signal import Signal

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "docs" / "gallery"
PAGE = ROOT / "docs" / "gallery.md"
STROKE = "scrape left to right, 1 N, 100 mm/s, 1.5 s"
MATERIALS = (
    "oak-wood", "corduroy", "denim", "leather", "sandpaper", "ribbed-plastic", "knurled-metal", "clear-glass",
    "brick", "terry-towel",
)  # fmt: skip
BIT_RATE, PEAK = 64_000, 0.5
RANGE_DB, COLOURS = 60.0, 32
BEGIN, END = "<!-- made by tools/make_gallery.py -->", "<!-- end -->"


def write_sound(path: Path, signal: Signal) -> None:
    """Write a signal as MP3, scaled to a common peak and resampled to 48 kHz."""
    samples = np.asarray(signal.samples, np.float32)
    sound = aud.Sound.buffer((samples * (PEAK / np.abs(samples).max())).reshape(-1, 1), signal.sample_rate)
    sound.write(str(path), 48_000, aud.CHANNELS_MONO, aud.FORMAT_S16, aud.CONTAINER_MP3, aud.CODEC_MP3, BIT_RATE, 1152)


def write_picture(path: Path, signals: dict[str, Signal]) -> None:
    """Write the spectrograms side by side, their levels on one scale."""
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    axes = figure.subplots(2, 5, sharex=True, sharey=True)
    grids = {name: compute_spectrogram(signal) for name, signal in signals.items()}
    levels = {name: 10.0 * np.log10(np.maximum(grid.power, 1e-20)) for name, grid in grids.items()}
    top = max(float(level.max()) for level in levels.values())
    for panel, (name, level) in zip(axes.flat, levels.items(), strict=True):
        grid = grids[name]
        extent = (grid.time[0], grid.time[-1], grid.frequency[0], grid.frequency[-1])
        panel.imshow(level, origin="lower", aspect="auto", extent=extent, vmin=top - RANGE_DB, vmax=top, cmap="magma")
        panel.set_title(name, fontsize=9)
        panel.set_ylim(0, 1000)
        panel.tick_params(labelsize=7)
    figure.supxlabel("time [s]", fontsize=8)
    figure.supylabel("frequency [Hz]", fontsize=8)
    figure.savefig(path, dpi=80)
    Image.open(path).convert("RGB").quantize(COLOURS).save(path, optimize=True)


def format_table(signals: dict[str, Signal]) -> str:
    """Format one row for each material: a player, and its level."""
    rows = ["| material | listen | RMS [m/s²] |", "|---|---|---:|"]
    for name, signal in signals.items():
        rms = float(np.sqrt(np.mean(np.square(signal.samples, dtype=np.float64))))
        player = f'<audio controls preload="none" src="gallery/{name}.mp3"></audio>'
        rows.append(f"| {name} | {player} [MP3](gallery/{name}.mp3) | {rms:.2f} |")
    return "\n".join(rows)


def main() -> int:
    """Make sounds, picture and table."""
    FOLDER.mkdir(exist_ok=True)
    signals = {name: hnf.synthesise(name, STROKE, seed=0).signal for name in MATERIALS}
    for name, signal in signals.items():
        write_sound(FOLDER / f"{name}.mp3", signal)
    write_picture(FOLDER / "spectrograms.png", signals)
    text = PAGE.read_text(encoding="utf-8")
    head, _, rest = text.partition(BEGIN)
    PAGE.write_text(f"{head}{BEGIN}\n{format_table(signals)}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
