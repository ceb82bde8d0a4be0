"""Write and read the samples themselves, without loss, as CSV and NPZ.

CSV: the header `time_s,acceleration_m_s2` and one row per sample, as float32 with nine digits, which restore the same
bits. The rate is inferred from the times; seed and provenance are in the sidecar. NPZ: `samples` (n,) float32 [m/s²],
`sample_rate_hz`, `seed`, and `origin`, a JSON text. The arrays hold plain numbers and text and are read without pickle.
"""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..files import NPZ_ERRORS, check_text, refuse_pointer, write_bytes
from ..json_io import REEXPORT_REMEDY, read_limited_bytes
from ..signal import Signal
from ..tables import decode_text, parse_columns
from .options import ExportOptions, ImportOptions, get_finite_samples
from .provenance import encode_provenance, read_sidecar_provenance

HEADER = "time_s,acceleration_m_s2"
MAX_TABLE_BYTES = 2**29
MAX_ROW_BYTES = 40
"""Largest size of a row [bytes]: a time of nine digits before the point and twelve after it, and a float32."""
MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e9
DOUBTED_RATE_HZ = 100.0
"""Sample rate below which the unit of the times is doubted, since such a signal cannot hold touch."""
_ALIASES = {"t": "time", "accel": "acceleration", "acc": "acceleration", "a": "acceleration"}
MAX_TIME_DEVIATION = 0.1
"""Largest deviation of a time from an even grid, as a fraction of the sample interval, since tables round times."""


def write_csv(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as a table; return sentences on what was left out.

    Raises FileError if a sample is not finite, there are fewer than two samples (which define no rate), the table would
    be too large to be read again, or the file cannot be written.
    """
    samples = get_finite_samples(signal, str(path))
    if len(samples) < 2:
        raise FileError(f"a table of {len(samples)} rows tells no rate.", where=str(path), remedy="Write NPZ instead.")
    if len(samples) * MAX_ROW_BYTES > MAX_TABLE_BYTES:
        raise FileError(f"{len(samples)} rows are too many for a table.", where=str(path), remedy="Write NPZ instead.")
    time = np.arange(len(samples)) / signal.sample_rate
    rows = io.StringIO()
    np.savetxt(rows, np.stack([time, samples.astype(np.float64)], axis=1), fmt=["%.12f", "%.9g"], delimiter=",")
    write_bytes(path, f"{HEADER}\n{rows.getvalue()}".encode("ascii"))
    return ("Seed and origin stand in the .json beside it.",)


def read_csv(path: Path, options: ImportOptions) -> Signal:
    """Read a table of times and accelerations; seed and provenance come from the sidecar if it matches the file.

    Raises FileError if the header is another one, times do not rise evenly, a value is not finite, or there are fewer
    than two rows.
    """
    data = read_limited_bytes(path, MAX_TABLE_BYTES)
    refuse_pointer(data, path)
    text = decode_text(data, str(path))
    header, _, body = text.partition("\n")
    if [cell.strip() for cell in header.split(",")] == HEADER.split(","):
        try:
            rows = np.loadtxt(io.StringIO(body), delimiter=",", ndmin=2) if body.strip() else np.zeros((0, 2))
        except ValueError as error:
            raise FileError(f"is damaged ({error}).", where=str(path), remedy=REEXPORT_REMEDY) from error
        if rows.shape[1] != 2:
            raise FileError(
                "its rows have not two cells.", where=str(path), remedy=f"Give the header {HEADER} and rows."
            )
    else:
        columns, missing = parse_columns(text, ("time", "acceleration"), _ALIASES, str(path))
        if missing:
            raise FileError("is no table of accelerations.", where=str(path), remedy=f"Give the header {HEADER}.")
        rows = np.stack([columns["time"], columns["acceleration"]], axis=1)
    if len(rows) < 2:
        raise FileError("has fewer than two rows.", where=str(path), remedy="Give a row for each sample.")
    with np.errstate(over="ignore"):
        samples = rows[:, 1].astype(np.float32)
    if not (np.isfinite(rows).all() and np.isfinite(samples).all()):
        raise FileError("some values are not finite.", where=str(path), remedy=REEXPORT_REMEDY)
    seed, facts = read_sidecar_provenance(path) or (options.seed, {"source": path.name})
    rate = _infer_rate(rows[:, 0], path)
    if rate < DOUBTED_RATE_HZ:
        facts = facts | {"doubt": f"time_s steps by {1.0 / rate:g} s: is it in milliseconds? Then write time_ms"}
    return Signal(samples, rate, seed, facts)


def _infer_rate(time: NDArray[np.float64], path: Path) -> float:
    """Return the sample rate [Hz] of times (n,) [s]: a whole number if the rounded times allow one."""
    with np.errstate(over="ignore"):
        span = time[-1] - time[0]
    if not span > 0.0:
        raise FileError("its times do not rise.", where=str(path), remedy="Sort the rows by time_s.")
    with np.errstate(over="ignore"):
        rate = (len(time) - 1) / span
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise FileError(
            f"its times are {span / (len(time) - 1):g} s apart.", where=str(path), remedy="Give times in seconds."
        )
    if np.abs((time - time[0]) * rate - np.arange(len(time))).max() > MAX_TIME_DEVIATION:
        raise FileError("its times are not even.", where=str(path), remedy="Resample it to even times.")
    rounded = float(round(rate))
    return rounded if abs(rate - rounded) <= rate * max(1e-6, 2e-12 / span) else float(rate)


def write_npz(path: Path, signal: Signal, options: ExportOptions) -> tuple[str, ...]:
    """Write a signal as an NPZ archive; equal signals give equal bytes.

    Raises FileError if a sample is not finite or the file cannot be written.
    """
    arrays: dict[str, NDArray[Any]] = {
        "samples": get_finite_samples(signal, str(path)),
        "sample_rate_hz": np.array(float(signal.sample_rate)),
        "seed": np.array(str(int(signal.seed))),
        "origin": np.array(encode_provenance(signal, None)),
    }
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            member = io.BytesIO()
            np.save(member, array, allow_pickle=False)
            # A fixed date, so that equal signals give equal bytes.
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0)), member.getvalue())
    write_bytes(path, buffer.getvalue())
    return ()


def read_npz(path: Path, options: ImportOptions) -> Signal:
    """Read an archive that `write_npz` wrote.

    Raises FileError if it is no archive, or if an array is missing, of the wrong type or size, or not finite.
    """
    data = read_limited_bytes(path, MAX_TABLE_BYTES)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            arrays = {name: _read_member(archive, name) for name in ("samples", "sample_rate_hz", "seed", "origin")}
        samples, rate = arrays["samples"], float(arrays["sample_rate_hz"])
        seed, record = int(str(arrays["seed"])), json.loads(str(arrays["origin"]))
        facts = {str(name): str(value) for name, value in record["provenance"].items()}
        is_valid = (
            samples.ndim == 1
            and samples.dtype == np.float32
            and np.isfinite(samples).all()
            and 0.0 < rate <= MAX_RATE_HZ
        )
    except NPZ_ERRORS as error:
        raise FileError("is damaged, or no archive of a signal.", where=str(path), remedy=REEXPORT_REMEDY) from error
    if not is_valid:
        raise FileError("its samples are no finite float32 at a rate.", where=str(path), remedy=REEXPORT_REMEDY)
    return Signal(samples, rate, seed, facts)


def _read_member(archive: zipfile.ZipFile, name: str) -> NDArray[Any]:
    """Read an array of an NPZ archive after checking that its header claims no more data than the file holds."""
    info = archive.getinfo(f"{name}.npy")
    if info.file_size > MAX_TABLE_BYTES:
        raise ValueError(f"{name} is larger than {MAX_TABLE_BYTES} bytes")
    stream = io.BytesIO(archive.read(info))
    shape, fortran, dtype = _read_array_header(stream)
    content = stream.read()
    if dtype.hasobject or dtype.kind not in "fU" or fortran or any(size < 0 for size in shape):
        raise ValueError(f"{name} is of the kind {dtype}")
    count = 1
    for size in shape:
        count *= int(size)
    if count * dtype.itemsize != len(content):
        raise ValueError(f"{name} claims {count} values and holds {len(content)} bytes")
    array = np.frombuffer(content, dtype, count).reshape(shape).copy()
    check_text(name, array)
    return array


def _read_array_header(stream: io.BytesIO) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Read shape, Fortran order and dtype of the .npy array that follows in a stream.

    The header is a Python literal, which numpy parses without evaluating it.
    """
    layout: Any = np.lib.format
    read = layout.read_array_header_1_0 if layout.read_magic(stream) == (1, 0) else layout.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    return shape, fortran, dtype
