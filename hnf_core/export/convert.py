"""Export a signal to a format and import it back: the entry points for the command line and Blender.

An export also writes a sidecar, and for some formats a mesh. Files at these paths that belong to something else are
never overwritten.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import FileError
from ..field.resampling import MAX_RATE_HZ
from ..files import suggest_other_path
from ..signal import Signal
from .envelope import CLIPPED_PREFIX
from .fidelity import ConversionLoss, format_loss_table, measure_loss
from .formats import Format, format_of_file
from .gltf import GENERATOR, MAX_READ_BYTES, decode_glb
from .hjif import get_mesh_path, has_path
from .json_reader import read_limited_bytes
from .options import ExportOptions, ImportOptions, choose_render_rate
from .provenance import get_sidecar_path, is_sidecar, write_sidecar


def check_output_paths(path: Path, *, with_mesh: bool) -> None:
    """Check that an export to `path` overwrites nothing but its own earlier files, before anything is written.

    `with_mesh` includes the mesh next to the file. Raises FileError if the path, its sidecar or its mesh is another
    file.
    """
    note = get_sidecar_path(path)
    for each in (path, note, *((get_mesh_path(path),) if with_mesh else ())):
        if each.is_dir():
            raise FileError("is a folder, and no file.", where=str(each), remedy=suggest_other_path(each))
    if is_sidecar(path):
        raise _occupied_error(
            path, f"it is the note of {path.name.removesuffix('.json')}, and says what its numbers stand for."
        )
    if os.path.lexists(note) and not is_sidecar(note):
        raise _occupied_error(note, f"here goes the note of {path.name}, and another file is in its place.")
    if with_mesh and os.path.lexists(there := get_mesh_path(path)) and not _is_exported_mesh(there):
        raise _occupied_error(there, f"here goes the mesh of {path.name}, and another file is in its place.")
    owner = path.with_name(path.stem)
    if owner.suffix.lower() == ".hjif" and owner.exists() and get_mesh_path(owner) == path and _is_exported_mesh(path):
        raise _occupied_error(path, f"it is the mesh of {owner.name}, which counts its vertices.")


def _is_exported_mesh(path: Path) -> bool:
    """Return True for a GLB that this project wrote next to a texture: it has no sidecar of its own."""
    if not path.exists() or get_sidecar_path(path).exists():
        return False
    try:
        tree, _ = decode_glb(read_limited_bytes(path, MAX_READ_BYTES), path)
        return str(tree["asset"]["generator"]).startswith(GENERATOR)
    except (FileError, KeyError, TypeError):
        return False


def _occupied_error(path: Path, why: str) -> FileError:
    return FileError(why, where=str(path), remedy=suggest_other_path(path))


CHECKED_PREFIX = "This file was read again by hnf. Files of this writer are checked in the tests against"
"""Beginning of the sentence on a file's checks: more than reading it back was not done with this file."""


@dataclass(frozen=True)
class ExportResult:
    """Result of an export.

    Attributes
    ----------
    path : Path
        Written file.
    form : Format
        Its format.
    options : ExportOptions
        Options it was written with; they hold the full scale.
    loss : ConversionLoss
        Loss measured on the file after reading it back.
    """

    path: Path
    form: Format
    options: ExportOptions
    loss: ConversionLoss

    @property
    def dropped(self) -> tuple[str, ...]:
        """Sentences on what the format cannot hold."""
        return self.loss.dropped

    @property
    def clipped(self) -> str:
        """Sentence on values above full scale; empty if there are none."""
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
        """Format the result as several lines for the terminal."""
        scale = f"1 = {self.options.full_scale_m_s2:g} m/s²" if self.form.states_scale else "in m/s²"
        return f"{self.path}: {self.form.what}; {scale}\n{format_loss_table(self.loss)}"


def export_signal(signal: Signal, form: Format, path: Path, options: ExportOptions, blend: str = "") -> ExportResult:
    """Write a signal and its sidecar, read the file back, and measure the loss.

    Parameters
    ----------
    signal : Signal
        Acceleration [m/s²].
    form : Format
        Format to write.
    path : Path
        File to write, atomically; the sidecar is written to path.json.
    options : ExportOptions
        Scale, range, envelope error and surface.
    blend : str
        Name of the .blend file that the signal comes from, for the sidecar.

    Returns
    -------
    ExportResult
        The options in use and the measured loss. Envelopes are rendered with the signal's seed, at its rate or one
        that holds the range.

    Raises
    ------
    FileError
        If the sample rate is not valid, another file is at one of the paths, or the format cannot hold the signal.
    UsageError
        If the format needs an option that is missing.
    """
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
    """Read a signal from a file in any known format.

    Parameters
    ----------
    path : Path
        File to read.
    options : ImportOptions
        Scale, range, rate and seed for what the file does not state.
    form : Format, optional
        Format of the file; by default its suffix decides.

    Returns
    -------
    Signal
        Acceleration [m/s²].

    Raises
    ------
    FileError, UsageError
        If the file is damaged or its format is not known.
    """
    return (form or format_of_file(path)).read(path, options)
