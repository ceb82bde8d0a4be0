"""Out into a format and back in: the two ways that the command line and Blender share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileError
from ..field.resampling import MAX_RATE_HZ
from ..signal import Signal
from .formats import Format, format_of_file
from .hjif import has_path
from .loss import ConversionLoss, format_loss_table, measure_loss
from .options import ExportOptions, ImportOptions
from .places import check_output_paths
from .samples import choose_render_rate
from .shares import CLIPPED_PREFIX
from .sidecar import get_sidecar_path, write_sidecar

CHECKED_PREFIX = "This file was read again by hnf. Files of this writer are checked in the tests against"
"""How what is told of a file's checking begins: of this very file no more is true."""


@dataclass(frozen=True)
class ExportResult:
    """path: of the file. form: its format. options: what 1 stands for. loss: measured on the file, read again."""

    path: Path
    form: Format
    options: ExportOptions
    loss: ConversionLoss

    @property
    def dropped(self) -> tuple[str, ...]:
        """What the format has no place for, in words."""
        return self.loss.dropped

    @property
    def clipped(self) -> str:
        """The sentence of what exceeded full scale; empty where nothing did."""
        return next((each for each in self.dropped if each.startswith(CLIPPED_PREFIX)), "")

    def to_json(self) -> dict[str, Any]:
        scaled = self.form.scaled
        return {
            "file": str(self.path),
            "format": self.form.word,
            "full_scale_m_s2": self.options.full_scale_m_s2 if self.form.states_scale else None,
            "range_hz": list(self.options.range_hz) if scaled else None,
            "checked": f"{CHECKED_PREFIX} {self.form.checked}",
            "dropped": list(self.dropped),
            "loss": self.loss.to_json(),
        }

    def report(self) -> str:
        """For people, several lines."""
        scale = f"1 = {self.options.full_scale_m_s2:g} m/s²" if self.form.states_scale else "in m/s²"
        return f"{self.path}: {self.form.what}; {scale}\n{format_loss_table(self.loss)}"


def export_signal(signal: Signal, form: Format, path: Path, options: ExportOptions, blend: str = "") -> ExportResult:
    """Write signal to path, atomically, and what its numbers stand for to path.json, with the name of the .blend it
    comes from; then read the file again and measure what is missing. Envelopes are rendered with the signal's seed, at
    its rate or one that holds the range. Raises FileError for a rate that is none or where something else is in the
    place of what would be written, FileError and UsageError of the format."""
    if not 0.0 < signal.sample_rate <= MAX_RATE_HZ:
        raise FileError(
            f"a signal of {signal.sample_rate:g} Hz is none, so nothing was written.", where=str(path),
            remedy="Synthesise at e.g. 10000 Hz.",
        )  # fmt: skip
    options = form.fitted(signal, options)
    check_output_paths(path, with_mesh=form.word == "hjif" and has_path(options.surface))
    dropped = form.write(path, signal, options)
    told = ImportOptions(rate_hz=choose_render_rate(signal, options.range_hz), seed=signal.seed)
    loss = measure_loss(signal, form.read(path, told), dropped)
    # The note holds the file's hash and what it lost, so that it comes second.
    try:
        write_sidecar(path, form.word, signal, options if form.states_scale else None, loss.to_json(), blend)
    except FileError as error:
        raise FileError(
            f"the file is written, and its note is not: {get_sidecar_path(path).name} {error.what}", where=str(path),
            remedy="Free some disk space or give a shorter name, and export again.",
        ) from error  # fmt: skip
    return ExportResult(path, form, options, loss)


def import_signal(path: Path, options: ImportOptions, form: Format | None = None) -> Signal:
    """The signal in path, in m/s². form: its format; None: as its suffix says. Raises FileError and UsageError."""
    return (form or format_of_file(path)).read(path, options)
