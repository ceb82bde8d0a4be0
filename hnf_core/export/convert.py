"""Export a signal to a format and import one from it, as the command line and Blender both do.

Every export gets a sidecar, FILE.json, which states its scale and loss. This module also checks that an export, its
sidecar and its mesh overwrite no file that they do not own.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..field.resampling import MAX_RATE_HZ
from ..files import suggest_other_path
from ..json_io import read_limited_bytes
from ..signal import Signal
from .envelope import CLIPPED_PREFIX, Envelope, refine_envelope
from .fidelity import ConversionLoss, format_loss_table, measure_loss
from .formats import FOREIGN_LOADERS, Format, format_of_file
from .gltf import GENERATOR, MAX_READ_BYTES, decode_glb
from .hjif import get_mesh_path, has_path
from .options import DEFAULT_RENDER_RATE_HZ, ExportOptions, ImportOptions, choose_render_rate, require_samples
from .provenance import EnvelopeFile, get_sidecar_path, is_sidecar, write_sidecar


def check_output_paths(path: Path, *, with_mesh: bool) -> None:
    """Check that an export to `path` overwrites nothing but its own earlier files.

    Parameters
    ----------
    path : Path
        File to export to.
    with_mesh : bool
        Whether a mesh may be written next to it.

    Raises
    ------
    FileError
        If the file, its sidecar or its mesh would replace something else.
    """
    sidecar = get_sidecar_path(path)
    for output in (path, sidecar, *((get_mesh_path(path),) if with_mesh else ())):
        if output.is_dir():
            raise FileError("is a folder, and no file.", where=str(output), remedy=suggest_other_path(output))
    if is_sidecar(path):
        raise _occupied_error(
            path, f"it is the note of {path.name.removesuffix('.json')}, and says what its numbers stand for."
        )
    if os.path.lexists(sidecar) and not is_sidecar(sidecar):
        raise _occupied_error(sidecar, f"here goes the note of {path.name}, and another file is in its place.")
    if with_mesh and os.path.lexists(mesh := get_mesh_path(path)) and not _is_exported_mesh(mesh):
        raise _occupied_error(mesh, f"here goes the mesh of {path.name}, and another file is in its place.")
    owner = path.with_name(path.stem)
    if owner.suffix.lower() == ".hjif" and owner.exists() and get_mesh_path(owner) == path and _is_exported_mesh(path):
        raise _occupied_error(path, f"it is the mesh of {owner.name}, which counts its vertices.")


def _is_exported_mesh(path: Path) -> bool:
    """Return whether a file is the mesh of an exported texture: a GLB of this project without a sidecar."""
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
"""Beginning of the sentence on how a file was checked; no more is known of an individual file."""


@dataclass(frozen=True)
class ExportResult:
    """An exported file and what the conversion lost.

    Attributes
    ----------
    path : Path
        The file.
    form : Format
        Its format.
    options : ExportOptions
        Options it was written with, full scale included.
    loss : ConversionLoss
        Loss, measured on the file after it was read again.
    """

    path: Path
    form: Format
    options: ExportOptions
    loss: ConversionLoss

    @property
    def dropped(self) -> tuple[str, ...]:
        """Sentences on what of the signal the format cannot hold."""
        return self.loss.dropped

    @property
    def clipped(self) -> str:
        """Sentence on values above full scale; empty if there were none."""
        return next((sentence for sentence in self.dropped if sentence.startswith(CLIPPED_PREFIX)), "")

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
        """Format the result for a terminal, in several lines."""
        scale = f"1 = {self.options.full_scale_m_s2:g} m/s²" if self.form.states_scale else "in m/s²"
        return f"{self.path}: {self.form.what}; {scale}\n{format_loss_table(self.loss)}"


def export_signal(signal: Signal, form: Format, path: Path, options: ExportOptions, blend: str = "") -> ExportResult:
    """Export a signal, write its sidecar, read the file again and measure the loss.

    Envelopes are rendered with the signal's seed, at its rate or at one that covers the range.

    Parameters
    ----------
    signal : Signal
        Signal in m/s².
    form : Format
        Format to write.
    path : Path
        File to write, atomically. The sidecar is `path` with ".json" appended.
    options : ExportOptions
        Full scale, range and surface.
    blend : str
        Name of the .blend file with the signal's stroke, for the sidecar.

    Returns
    -------
    ExportResult
        The file and its loss.

    Raises
    ------
    FileError
        If the sample rate is invalid, another file is in the way, or the format cannot hold the signal.
    UsageError
        If an option that the format needs is missing.
    """
    if not 0.0 < signal.sample_rate <= MAX_RATE_HZ:
        raise FileError(
            f"a signal of {signal.sample_rate:g} Hz is none, so nothing was written.", where=str(path),
            remedy="Synthesise at e.g. 10000 Hz.",
        )  # fmt: skip
    options = form.fitted(signal, options)
    check_output_paths(path, with_mesh=form.word == "hjif" and has_path(options.surface))
    dropped = form.write(path, signal, options)
    import_options = ImportOptions(rate_hz=choose_render_rate(signal, options.range_hz), seed=signal.seed)
    loss = measure_loss(signal, form.read(path, import_options), dropped)
    # The sidecar holds the hash and the loss of the file, so it is written second.
    try:
        write_sidecar(path, form.word, signal, options if form.states_scale else None, loss.to_json(), blend)
    except FileError as error:
        raise FileError(
            f"the file is written, and its note is not: {get_sidecar_path(path).name} {error.what}", where=str(path),
            remedy="Free some disk space or give a shorter name, and export again.",
        ) from error  # fmt: skip
    return ExportResult(path, form, options, loss)


def import_signal(path: Path, options: ImportOptions, form: Format | None = None) -> Signal:
    """Read a signal in m/s² from `path`; the format is that of its suffix if `form` is None.

    Raises FileError if the file is damaged, UsageError if the suffix is unknown or an option is missing.
    """
    if form is None and path.suffix.lower() in FOREIGN_LOADERS:
        clip = FOREIGN_LOADERS[path.suffix.lower()](path, options)
        return require_samples(clip.render(options.rate_hz, options.seed, str(path)), str(path))
    return require_samples((form or format_of_file(path)).read(path, options), str(path))


CONVERSION_ERROR = 1e-3
"""Largest error of an envelope between its control points where it is converted, as a fraction of its peak."""


def convert_envelope(
    clip: EnvelopeFile, source: Path, form: Format, path: Path, options: ExportOptions
) -> ExportResult:
    """Write the envelope of a haptic file in another format that holds envelopes, without rendering it between.

    Clicks stay clicks and control points stay where they were, as far as the format has them.

    Parameters
    ----------
    clip : EnvelopeFile
        Content of the file.
    source : Path
        The file.
    form : Format
        Format to write; it has `store`.
    path : Path
        File to write, atomically, with its sidecar.
    options : ExportOptions
        Full scale and range of the new file.

    Returns
    -------
    ExportResult
        The file, and what a rendering of it loses against one of the source.

    Raises
    ------
    FileError
        As `export_signal`.
    """
    if form.store is None or form.load is None:
        raise ValueError(f"{form.word} holds no envelope")
    check_output_paths(path, with_mesh=False)
    rate = choose_render_rate(Signal(np.zeros(0, np.float32), DEFAULT_RENDER_RATE_HZ, 0), options.range_hz)
    before = require_samples(clip.render(rate, 0, str(source)), str(source))
    options = replace(options, error=CONVERSION_ERROR)
    dropped = form.store(path, refine_envelope(clip.envelope), before, options)
    written = form.load(path, ImportOptions(rate_hz=rate)).envelope
    dropped += (_describe_clicks(len(clip.envelope.emphases), len(written.emphases)),)
    dropped += (_describe_frequencies(clip.envelope, written, options.range_hz),)
    loss = measure_loss(before, form.read(path, ImportOptions(rate_hz=rate)), tuple(filter(None, dropped)))
    write_sidecar(path, form.word, before, options, loss.to_json())
    return ExportResult(path, form, options, loss)


def _describe_frequencies(before: Envelope, after: Envelope, range_hz: tuple[float, float]) -> str:
    """Return a sentence on frequencies that the format bounded to its range, or ""."""
    ends = [(float(each.frequency.min()), float(each.frequency.max())) for each in (before, after)]
    low, high = range_hz
    if (low <= ends[0][0] and ends[0][1] <= high) or ends[1][0] < 0.99 * low or ends[1][1] > 1.01 * high:
        return ""
    return (
        f"Frequencies beyond {low:g} … {high:g} Hz, which 0 … 1 stand for here: it has {ends[0][0]:g} … "
        f"{ends[0][1]:g} Hz. --range LOW HIGH holds more."
    )


def _describe_clicks(before: int, after: int) -> str:
    """Return a sentence on clicks that became something else, or "" if all are there."""
    return "" if after == before else f"{before - after} of {before} clicks: the format has none, so they became peaks."
