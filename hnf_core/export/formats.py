"""Table of all file formats that a signal can be written to and read from: name → `Format`.

To add one, write the two functions below in a file of its own and add a `Format` with them to `FORMATS`. The command
line, the loss report and the tests of all formats use this table.

* A *writer* `(path, signal, options) -> (sentence, …)` writes `path` atomically (`hnf_core/files.py`) and returns
  sentences on what the format cannot hold and on what was clipped; the loss report measures the rest. It raises
  FileError if the signal cannot be written (not finite, unsupported rate), UsageError if an option is missing.
* A *reader* `(path, options) -> Signal` returns m/s². A format that stores only envelopes is rendered on a carrier
  (`envelope.py`). It raises one FileError for any defect of the file, within bounded memory (see `json_io.py`). It
  must read everything that the writer writes, since the loss is measured on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from ..errors import UsageError
from ..signal import Signal
from .ahap import load_ahap, read_ahap, store_ahap, write_ahap
from .android import (
    load_android,
    load_android_xml,
    read_android,
    read_android_xml,
    store_android,
    store_android_xml,
    write_android,
    write_android_xml,
)
from .csv_npz import read_csv, read_npz, write_csv, write_npz
from .envelope import Envelope
from .foreign_clips import load_haps, load_tact
from .gltf import read_glb, write_glb
from .haptic import load_haptic, read_haptic, store_haptic, write_haptic
from .hjif import read_hjif, write_hjif
from .hjif_envelope import load_hjif, store_hjif
from .options import ExportOptions, ImportOptions
from .provenance import EnvelopeFile
from .wav import LISTEN_FORMAT as LISTEN
from .wav import fit_full_scale, make_copy_writer, read_wav_scaled, write_listening_copy, write_native_wav

Writer = Callable[[Path, Signal, ExportOptions], tuple[str, ...]]
Reader = Callable[[Path, ImportOptions], Signal]
Loader = Callable[[Path, ImportOptions], EnvelopeFile]
Storer = Callable[[Path, Envelope, Signal, ExportOptions], tuple[str, ...]]
Fit = Callable[[Signal, ExportOptions], ExportOptions]


@dataclass(frozen=True)
class Format:
    """A file format with its writer and reader.

    Attributes
    ----------
    word : str
        Name on the command line.
    suffix : str
        Suffix of its files, with the dot.
    what : str
        Description in a sentence.
    checked : str
        References that the tests check its files against, and what was not checked.
    write, read : callable
        Writer and reader, see the module.
    scaled : bool
        Whether its numbers are fractions of a full scale and of a range instead of m/s².
    surface : bool
        Whether it can hold the surface of the stroke.
    sampled : bool
        Whether it holds the waveform; otherwise it holds amplitude and frequency over time, from which reading renders
        a waveform.
    fit : callable or None
        Derives the full scale from the signal itself; None if the options state it.
    load, store : callable or None
        Reader and writer of the envelope itself, of formats that can hold one.
    """

    word: str
    suffix: str
    what: str
    checked: str
    write: Writer
    read: Reader
    scaled: bool = True
    surface: bool = False
    sampled: bool = True
    fit: Fit | None = None
    load: Loader | None = None
    store: Storer | None = None

    def fitted(self, signal: Signal, options: ExportOptions) -> ExportOptions:
        """Return the options that a file of `signal` is written with: with the full scale of `fit`, if there is one."""
        return options if self.fit is None else self.fit(signal, options)

    @property
    def states_scale(self) -> bool:
        """True if 1 in its files stands for a full scale in m/s²."""
        return self.scaled or self.fit is not None


_RIFF = "scipy's reader; the rules are IBM's and Microsoft's RIFF specification"
_LOFELT = "the rules of Lofelt's own reader (NiceVibrations, `core/datamodel/src/v1.rs`)"

FORMATS: dict[str, Format] = {
    each.word: each
    for each in (
        Format(
            "wav", ".wav", "WAV, 32-bit float in m/s², at the signal's own rate",
            _RIFF, write_native_wav, read_wav_scaled, scaled=False,
        ),
        Format(
            "wav8k", ".wav", "WAV for an actuator: 8 kHz, 16 bit, full scale as told",
            _RIFF, make_copy_writer(8000), read_wav_scaled,
        ),
        Format(
            "wav48k", ".wav", "WAV for a sound card: 48 kHz, 16 bit, full scale as told",
            _RIFF, make_copy_writer(48000), read_wav_scaled,
        ),
        Format(
            LISTEN, ".wav", "WAV to listen to, for no actuator: 48 kHz, 16 bit, as loud as it goes without clipping",
            _RIFF, write_listening_copy, read_wav_scaled, scaled=False, fit=fit_full_scale,
        ),
        Format(
            "haptic", ".haptic", "Meta Haptics (Lofelt) 1.0.0: strength and frequency over time",
            f"{_LOFELT}; not played on a device", write_haptic, read_haptic, sampled=False,
            load=load_haptic, store=store_haptic,
        ),
        Format(
            "ahap", ".ahap", "Apple Core Haptics: strength and sharpness over time",
            "Apple's documentation of its keys, ranges and the 30 s; the 16 points a curve are Lofelt's converter's; "
            "not loaded by Core Haptics, which runs on Apple's systems alone",
            write_ahap, read_ahap, sampled=False, load=load_ahap, store=store_ahap,
        ),
        Format(
            "android", ".json", "Android waveform: timings and amplitudes of VibrationEffect.createWaveform",
            "the method's documentation; not played on a device",
            write_android, read_android, sampled=False, load=load_android, store=store_android,
        ),
        Format(
            "android-xml", ".xml", "Android 16 envelope: intensity and sharpness over time, as Android's own XML",
            "the rules of Android's parser (com.android.internal.vibrator.persistence); not played on a device",
            write_android_xml, read_android_xml, sampled=False, load=load_android_xml, store=store_android_xml,
        ),
        Format(
            "hjif", ".hjif", "MPEG haptics (ISO/IEC 23090-31): the vibration; given the surface, with its vertices",
            "what MPEG's reference software reads and checks (`IOJson.cpp`, `IOCompatibility.h`); not against its JSON "
            "schema, which is not public, and not played by it",
            write_hjif, read_hjif, surface=True, load=load_hjif, store=store_hjif,
        ),
        Format(
            "glb", ".glb", "glTF: the touched mesh, what is baked on it as MPEG_haptic_material, and the signal",
            "Blender's importer and, where it is installed, Khronos's glTF validator; the extension against its public "
            "schemas, which do not say how pixels count",
            write_glb, read_glb, scaled=False, surface=True,
        ),
        Format(
            "csv", ".csv", "a table time_s,acceleration_m_s2", "numpy.loadtxt",
            write_csv, read_csv, scaled=False,
        ),
        Format(
            "npz", ".npz", "numpy arrays, without pickle", "numpy.load",
            write_npz, read_npz, scaled=False,
        ),
    )
}  # fmt: skip


FOREIGN_LOADERS: dict[str, Loader] = {".tact": load_tact, ".haps": load_haps}
"""Readers of the envelopes of other programs, by suffix; these formats are not written."""
SUFFIXES = tuple(sorted({each.suffix for each in FORMATS.values()} | set(FOREIGN_LOADERS)))


def format_of(word: str) -> Format:
    """Return the format with this name. Raises UsageError, which lists all names, if there is none."""
    if word not in FORMATS:
        raise UsageError(f"there is no format '{word}'.", remedy=f"There are: {', '.join(FORMATS)}.")
    return FORMATS[word]


def find_loader(path: Path) -> Loader | None:
    """Return the reader of a file's envelope, by its suffix; None if it holds no envelope or is of an unknown kind."""
    suffix = path.suffix.lower()
    matching = (form.load for form in FORMATS.values() if form.suffix == suffix)
    return FOREIGN_LOADERS.get(suffix) or next(matching, None)


def format_of_file(path: Path, *, is_written: bool = False) -> Format:
    """Return the format to read `path` with, or to write it in, by its suffix. Raises UsageError for an unknown one."""
    matching = [form for form in FORMATS.values() if form.suffix == path.suffix.lower()]
    if matching:
        return matching[0]
    suffixes = sorted({form.suffix for form in FORMATS.values()}) if is_written else SUFFIXES
    done = "written" if is_written else "read"
    raise UsageError(
        f"{path.name}: files of the kind '{path.suffix}' cannot be {done}.",
        remedy=f"Give one of {', '.join(suffixes)}.",
    )
