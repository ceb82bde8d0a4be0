"""Out into a format and back in: the two ways that the command line and Blender share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..signal import Signal
from .formats import Format, format_of_file
from .loss import Loss, loss_between, loss_table
from .options import ExportOptions, ImportOptions
from .sidecar import write_sidecar

UNMEASURED = "Nothing here reads this format back, so that the loss is told in words alone."


@dataclass(frozen=True)
class Exported:
    """path: of the file. form: its format. options: what 1 stands for. dropped: in words. loss: measured on the file,
    read again; None where nothing reads it."""

    path: Path
    form: Format
    options: ExportOptions
    dropped: tuple[str, ...]
    loss: Loss | None

    def to_json(self) -> dict[str, Any]:
        scaled = self.form.scaled
        return {
            "file": str(self.path),
            "format": self.form.word,
            "full_scale_m_s2": self.options.full_scale_m_s2 if scaled else None,
            "range_hz": list(self.options.range_hz) if scaled else None,
            "checked": self.form.checked,
            "dropped": list(self.dropped),
            "loss": None if self.loss is None else self.loss.to_json(),
        }

    def report(self) -> str:
        """For people, several lines."""
        scale = f"1 = {self.options.full_scale_m_s2:g} m/s²" if self.form.scaled else "in m/s²"
        head = f"{self.path}: {self.form.what}; {scale}"
        if self.loss is not None:
            return f"{head}\n{loss_table(self.loss)}"
        return "\n".join([head, *(f"- {each}" for each in (*self.dropped, UNMEASURED))])


def export_signal(signal: Signal, form: Format, path: Path, options: ExportOptions) -> Exported:
    """Write signal to path, atomically, and what its numbers stand for to path.json; then read the file again and
    measure what is missing. Envelopes are rendered with the signal's seed, at its rate or one that holds the range.
    Raises FileError and UsageError of the format."""
    dropped = form.write(path, signal, options)
    loss = None
    if form.read is not None:
        rate = max(round(signal.sample_rate), round(2.5 * options.range_hz[1]), 1)
        loss = loss_between(signal, form.read(path, ImportOptions(rate_hz=float(rate), seed=signal.seed)), dropped)
    exported = Exported(path, form, options, dropped, loss)
    measured = None if loss is None else loss.to_json()
    write_sidecar(path, form.word, signal, options if form.scaled else None, measured)
    return exported


def import_signal(path: Path, options: ImportOptions, form: Format | None = None) -> Signal:
    """The signal in path, in m/s². form: its format; None: as its suffix says. Raises FileError and UsageError."""
    read = (form or format_of_file(path)).read
    if read is None:
        raise UsageError(f"files of the format '{form.word if form else path.suffix}' cannot be read back.")
    return read(path, options)
