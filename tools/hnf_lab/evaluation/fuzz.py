"""Mutate small files of every kind that is read, and see that each is read or refused in one clear line.

A mutation flips bits, cuts, repeats, and puts numbers and JSON values where others stood. A reader may read what comes
out or raise an HnfError; anything else is a fault: another exception, a hang, a message that shows an exception's text.
Scene files are opened by Blender in a process of its own, which may die: what `hnf touch` then answers counts.
"""

from __future__ import annotations

import copy
import gzip
import io
import json
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import read_action_csv
from hnf_core.actuators.profile import GENERIC, read_profile, write_profile
from hnf_core.errors import FileError, HnfError
from hnf_core.export.convert import import_signal
from hnf_core.export.formats import FOREIGN_LOADERS, FORMATS, find_loader
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.material.hnf_file import from_library, read_hnf, write_hnf
from hnf_core.material.library import get_material
from hnf_core.material.probe import get_probe
from hnf_core.progress import Progress, ProgressCallback, ignore_progress
from hnf_core.scene.nerfstudio import read_transforms
from hnf_core.scene.splats.splat_file import open_splat_file, read_validated_splats
from hnf_core.signal import Signal

MAX_READ_S = 10.0
"""Longest time of a read [s]."""
MAX_OPERATIONS = 6
"""Most operations of one mutation."""
RAW_TEXT = re.compile(
    r"Traceback|\b[A-Z]\w*(?:Error|Exception)\b|object has no attribute|NoneType|index out of|unpack requires"
    r"|not iterable"
)
"""Pattern of an exception's own text, which a message for a person does not hold."""
VALUES: tuple[Any, ...] = (
    None, True, "", "x", -1, 0, 1e308, -1e308, 2**63, 1e-320, [], {}, [[]], [None], {"a": 1}, "NaN", float("nan"),
    float("inf"),
)  # fmt: skip
NUMBERS = (b"-1", b"0", b"1e308", b"1e-320", b"NaN", b"inf", b"99999999999999999999", b"", b"0x10", b"1,5", b"\xff")
SCENE_KINDS = ("gltf", "glb", "obj", "ply", "stl", "usda", "usdc", "fbx", "blend")
OLD_SCENE_KINDS = ("dae",)
"""Kinds of scenes that Blender reads up to version 4.5."""
SCENES_PER_PROCESS = 50
MAX_SCENE_S = 60.0
"""Longest time [s] after which a process is ended that is busy in Blender, where no timer of Python's interrupts it."""
MAX_COMMAND_S = 60.0
"""Longest time of the command by itself, Blender's start included [s]."""
READY, ANSWER = "hnf: ready", "hnf: answer "
"""Lines that a process prints which opens scenes: before the first, and before each answer."""

Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Fault:
    """A mutated file that was neither read nor refused in one clear line.

    Attributes
    ----------
    kind : str
        Kind of file.
    number : int
        Number of the mutation, which together with the seed makes the file again.
    what : str
        What happened.
    """

    kind: str
    number: int
    what: str


@dataclass
class Tally:
    """Results of the mutations of one kind of file.

    Attributes
    ----------
    kind : str
    read, refused : int
        Mutations that were read, and refused in one clear line.
    faults : list of Fault
    slowest_s : float
        Longest time of a read [s].
    notes : list of Fault
        Mutations with which a process ended that opened many, and what `hnf touch` answers to each by itself.
    """

    kind: str
    read: int = 0
    refused: int = 0
    faults: list[Fault] = field(default_factory=list)
    slowest_s: float = 0.0
    notes: list[Fault] = field(default_factory=list)

    def add(self, number: int, outcome: str) -> None:
        """Count a mutation whose outcome is "read", "refused" or a fault in words."""
        if outcome in ("read", "refused"):
            setattr(self, outcome, getattr(self, outcome) + 1)
        else:
            self.faults.append(Fault(self.kind, number, outcome))

    @property
    def count(self) -> int:
        """Number of mutations."""
        return self.read + self.refused + len(self.faults)


class _TooLong(BaseException):
    """Raised in a read that takes longer than MAX_READ_S."""


def _read_signal(path: Path) -> object:
    return import_signal(path, ImportOptions(30.0))


def _read_envelope(path: Path) -> object:
    load = find_loader(path)
    assert load is not None
    return load(path, ImportOptions(30.0)).render(10_000.0, 0, str(path))


def _read_splats(path: Path) -> object:
    open_splat_file(path)
    return read_validated_splats(path)


def _read_probe(path: Path) -> object:
    get_probe.cache_clear()
    return get_probe(str(path))


READERS: dict[str, Reader] = {
    **dict.fromkeys(("wav", "csv", "npz"), _read_signal),
    **{word: _read_envelope for word, form in FORMATS.items() if form.load},
    **{suffix[1:]: _read_envelope for suffix in FOREIGN_LOADERS},
    "action": read_action_csv,
    "hnf": read_hnf,
    "probe": _read_probe,
    "profile": read_profile,
    "transforms": read_transforms,
    **dict.fromkeys(("ply", "splat", "spz", "spz-4", "ksplat", "ksplat-0", "sog", "splats-glb"), _read_splats),
}  # fmt: skip
"""Kind of file → its reader."""


def make_sources(folder: Path) -> dict[str, Path]:
    """Write one small file of each kind of READERS; return kind → file."""
    time_s = np.arange(2000) / 10_000.0
    touch = Signal((3.0 * np.sin(2.0 * np.pi * 150.0 * time_s) * (time_s < 0.15)).astype(np.float32), 10_000.0, 1, {})
    # So many vectors that hardly any mutation would hit what holds them.
    brief = Signal(touch.samples[:200], touch.sample_rate, 1, {})
    files: dict[str, Path] = {}
    for word in ("wav", "csv", "npz", *(word for word, form in FORMATS.items() if form.load)):
        files[word] = folder / f"{word}{FORMATS[word].suffix}"
        FORMATS[word].write(files[word], brief if word == "hjif" else touch, ExportOptions())
    texts = {
        "tact": json.dumps(_TACT), "haps": json.dumps(_HAPS), "transforms": json.dumps(_TRANSFORMS),
        "action": "time_s,direction_rad,speed_m_s,force_n\n" + "".join(f"{i / 100},0.1,0.1,1\n" for i in range(20)),
        "probe": _PROBE,
    }  # fmt: skip
    suffixes = {"action": "csv", "probe": "toml", "transforms": "json"}
    for kind, text in texts.items():
        files[kind] = folder / f"{kind}.{suffixes.get(kind, kind)}"
        files[kind].write_text(text, encoding="utf-8")
    files["profile"] = folder / "profile.json"
    write_profile(files["profile"], GENERIC)
    files["hnf"] = folder / "material.hnf"
    write_hnf(files["hnf"], from_library(get_material("oak-wood")))
    random = np.random.default_rng(0)
    rows = np.zeros(20, [("mean", "<f4", 3), ("scale", "<f4", 3), ("colour", "u1", 4), ("turn", "u1", 4)])
    rows["mean"], rows["scale"], rows["colour"], rows["turn"] = random.random((20, 3)), 0.01, 200, (255, 128, 128, 128)
    files["splat"] = folder / "rows.splat"
    files["splat"].write_bytes(rows.tobytes())
    files["ply"], files["spz"] = folder / "splats.ply", folder / "splats.spz"
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += [f"rot_{axis}" for axis in range(4)]
    header = "ply\nformat binary_little_endian 1.0\nelement vertex 20\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    values = np.column_stack([random.random((20, 7)), np.full((20, 3), -4.0), np.tile([1.0, 0.0, 0.0, 0.0], (20, 1))])
    files["ply"].write_bytes(header.encode() + values.astype("<f4").tobytes())
    body = struct.pack("<4sIIBBBB", b"NGSP", 2, 20, 0, 12, 0, 0) + bytes(random.integers(0, 256, 20 * 19, np.uint8))
    files["spz"].write_bytes(gzip.compress(body, mtime=0))
    packed = {"spz-4": _pack_spz, "ksplat": _pack_ksplat, "ksplat-0": _pack_plain_ksplat, "sog": _pack_sog}
    for kind, pack in (packed | {"splats-glb": _pack_splats_glb}).items():
        files[kind] = folder / f"{kind}.{kind.split('-')[-1] if kind.endswith('glb') else kind.split('-')[0]}"
        files[kind].write_bytes(pack(random))
    return files


def _pack_spz(random: np.random.Generator) -> bytes:
    """Pack 20 splats as a .spz file of version 4: its attributes are streams of their own."""
    import zstandard

    parts = [random.integers(0, 256, 20 * width, np.uint8).tobytes() for width in (9, 1, 3, 3, 4)]
    streams = [zstandard.ZstdCompressor().compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(small), len(part)) for small, part in zip(streams, parts, strict=True))
    return struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 20, 0, 12, 0, len(parts), 32) + table + b"".join(streams)


def _pack_ksplat(random: np.random.Generator) -> bytes:
    """Pack 20 splats of degree 1 as a .ksplat file of level 1: two full buckets of 8 and one of 4."""
    fields = [("means", "<u2", 3), ("scales", "<f2", 3), ("turn", "<f2", 4), ("colour", "u1", 4), ("more", "<f2", 9)]
    section = struct.pack("<4IfHxxIIIIH", 20, 20, 8, 3, 1.0, 12, 32767, 0, 2, 1, 1)
    buckets = struct.pack("<I", 4) + random.random(9).astype("<f4").tobytes()
    return _join_ksplat(section, 1, buckets + _make_rows(np.dtype(fields), random).tobytes())


def _pack_plain_ksplat(random: np.random.Generator) -> bytes:
    """Pack 20 splats as a .ksplat file of level 0, in which centres are plain numbers."""
    row = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("turn", "<f4", 4), ("colour", "u1", 4)])
    return _join_ksplat(struct.pack("<2I", 20, 20), 0, _make_rows(row, random).tobytes())


def _join_ksplat(section: bytes, level: int, data: bytes) -> bytes:
    head = struct.pack("<4B4IHxx5f", 0, 1, 0, 0, 1, 1, 20, 20, level, 0, 0, 0, -1.5, 1.5)
    return head.ljust(4096, b"\0") + section.ljust(1024, b"\0") + data


def _make_rows(row: np.dtype[Any], random: np.random.Generator) -> NDArray[Any]:
    rows = np.zeros(20, row)
    rows["means"] = random.integers(0, 65536, (20, 3)) if row["means"].base == np.uint16 else random.random((20, 3))
    rows["scales"], rows["turn"], rows["colour"] = 0.01, (1.0, 0.0, 0.0, 0.0), 200
    return rows


def _pack_sog(random: np.random.Generator) -> bytes:
    """Pack 20 splats with harmonics of degree 1 as a SOG archive of version 2."""
    import PIL.Image

    table = np.linspace(-4.0, 1.0, 256).tolist()
    parts = [("means", "low"), ("means", "high"), ("scales", "scales"), ("quats", "quats"), ("sh0", "sh0")]
    parts += [("shN", "more"), ("shN", "which")]
    meta: dict[str, Any] = {"version": 2, "count": 20}
    for entry, name in parts:
        meta.setdefault(entry, {"files": []})["files"].append(f"{name}.webp")
    meta["means"] |= {"mins": [-1.0] * 3, "maxs": [1.0] * 3}
    for entry in ("scales", "sh0", "shN"):
        meta[entry]["codebook"] = table
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(zipfile.ZipInfo("meta.json"), json.dumps(meta))
        for _, name in parts:
            pixels = random.integers(0, 200, (1, 64 * 3, 4) if name == "more" else (4, 5, 4), np.uint8)
            pixels[..., 3] = {"quats": 252, "sh0": 200}.get(name, 255)
            if name == "which":  # an entry of the palette of 64, in two bytes
                pixels[..., :2] = pixels[..., :1] % 64 * [1, 0]
            picture = io.BytesIO()
            PIL.Image.fromarray(pixels).save(picture, "WEBP", lossless=True, exact=True)
            archive.writestr(zipfile.ZipInfo(f"{name}.webp"), picture.getvalue())
    return stream.getvalue()


def _pack_splats_glb(random: np.random.Generator) -> bytes:
    """Pack 20 splats as binary glTF with KHR_gaussian_splatting."""
    columns = {
        "POSITION": random.random((20, 3)), "SCALE": np.full((20, 3), 0.01), "ROTATION": np.tile([0, 0, 0, 1], (20, 1)),
        "OPACITY": np.full((20, 1), 0.9), "SH_DEGREE_0_COEF_0": random.random((20, 3)),
    }  # fmt: skip
    extension, names = "KHR_gaussian_splatting", ("SCALAR", "VEC2", "VEC3", "VEC4")
    data = [values.astype("<f4").tobytes() for values in columns.values()]
    starts = np.cumsum([0, *map(len, data)]).tolist()
    accessors = [
        {"componentType": 5126, "count": 20, "type": names[values.shape[1] - 1], "bufferView": number}
        for number, values in enumerate(columns.values())
    ]
    attributes = {key if key == "POSITION" else f"{extension}:{key}": at for at, key in enumerate(columns)}
    views = [{"buffer": 0, "byteOffset": at, "byteLength": len(part)} for at, part in zip(starts, data, strict=False)]
    about = {extension: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}}
    primitive = {"mode": 0, "attributes": attributes, "extensions": about}
    document = {
        "asset": {"version": "2.0"}, "extensionsUsed": [extension], "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}], "accessors": accessors,
        "bufferViews": views, "buffers": [{"byteLength": starts[-1]}],
    }  # fmt: skip
    return _join_glb(json.dumps(document).encode(), struct.pack("<I4s", starts[-1], b"BIN\0") + b"".join(data))


def _join_glb(text: bytes, rest: bytes) -> bytes:
    """Return binary glTF of a document and the chunks after it."""
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + rest
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


_TACT = {"project": {"tracks": [{"enable": True, "effects": [{"startTime": 200, "modes": {"Left": {
    "mode": "DOT_MODE", "dotMode": {"feedback": [{"startTime": 0, "endTime": 100, "playbackType": "FADE_OUT",
    "pointList": [{"index": 1, "intensity": 0.5}]}]}}}}]}]}}  # fmt: skip
_KEYS = [{"m_time": 0, "m_value": 1.0}, {"m_time": 0.5, "m_value": 0.0}]
_HAPS = {"m_gain": 1.0, "m_vibration": {"m_melodies": [{"m_mute": 0, "m_gain": 1.0, "m_notes": [
    {"m_startingPoint": 0.0, "m_length": 0.5, "m_gain": 0.5, "m_hapticEffect": {
        "m_amplitudeModulation": {"m_keyframes": _KEYS}, "m_frequencyModulation": {"m_keyframes": _KEYS}}},
    {"m_startingPoint": 0.6, "m_length": 0.022, "m_gain": 1.0, "m_hapticEffect": {"m_type": 0}}]}]}}  # fmt: skip
_TRANSFORMS = {
    "fl_x": 500.0, "fl_y": 500.0, "cx": 320.0, "cy": 240.0, "w": 640, "h": 480, "camera_model": "OPENCV",
    "frames": [{"file_path": f"images/{i}.png", "transform_matrix": np.eye(4).tolist()} for i in range(2)],
}  # fmt: skip
_PROBE = (Path(__file__).parents[3] / "hnf_core" / "data" / "probes" / "pen.toml").read_text("utf-8").replace(
    'name = "pen"', 'name = "mine"')  # fmt: skip


def mutate(data: bytes, random: np.random.Generator) -> bytes:
    """Return damaged data, half of the time inside its JSON, archive or compression if it has one."""
    if data[:1] in b"{[" and random.random() < 0.5:
        try:
            return _mutate_json(json.loads(data), random)
        except ValueError:
            pass
    if data[:2] == b"\x1f\x8b" and random.random() < 0.5:
        return gzip.compress(mutate(gzip.decompress(data), random), mtime=0)
    if data[:4] == b"PK\x03\x04" and random.random() < 0.5:
        return _mutate_member(data, random)
    if data[:4] == b"glTF" and random.random() < 0.5:
        (length,) = struct.unpack_from("<I", data, 12)
        return _join_glb(mutate(data[20 : 20 + length], random), data[20 + length :])
    for _ in range(min(int(random.geometric(0.6)), MAX_OPERATIONS)):
        data = _mutate_bytes(data, random)
    return data


def _mutate_member(data: bytes, random: np.random.Generator) -> bytes:
    """Damage one file of a zip archive, and pack the archive anew, so that its checksums are right."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    chosen = list(files)[int(random.integers(len(files)))]
    files[chosen] = mutate(files[chosen], random)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def _mutate_bytes(data: bytes, random: np.random.Generator) -> bytes:
    if not data:
        return bytes(random.integers(0, 256, 8, np.uint8))
    at = int(random.integers(len(data)))
    # Headers are short, and decide most.
    at = min(at, int(random.integers(64))) if random.random() < 0.4 else at
    length = int(min(random.geometric(0.1), len(data) - at))
    match int(random.integers(8)):
        case 0:
            return data[:at] + bytes([data[at] ^ (1 << int(random.integers(8)))]) + data[at + 1 :]
        case 1:
            return data[:at] + bytes(random.integers(0, 256, length, np.uint8)) + data[at + length :]
        case 2:
            return data[:at]
        case 3:
            return data[:at] + data[at + length :]
        case 4:
            return data[: at + length] + data[at : at + length] * int(random.integers(1, 20)) + data[at + length :]
        case 5:
            return data[:at] + bytes([int(random.choice([0, 127, 128, 255]))]) * length + data[at + length :]
        case 6:
            return data + bytes(random.integers(0, 256, int(random.integers(1, 64)), np.uint8))
    numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?", data))
    if not numbers:
        return data[:at] + data[at + 1 :]
    found = numbers[int(random.integers(len(numbers)))]
    return data[: found.start()] + NUMBERS[int(random.integers(len(NUMBERS)))] + data[found.end() :]


def _mutate_json(tree: Any, random: np.random.Generator) -> bytes:
    """Replace, remove or repeat up to three values of a document."""
    for _ in range(int(random.integers(1, 4))):
        places = list(_iter_places(tree))
        if not places:
            break
        holder, key = places[int(random.integers(len(places)))]
        choice = random.random()
        if choice < 0.7:
            holder[key] = copy.deepcopy(VALUES[int(random.integers(len(VALUES)))])
        elif choice < 0.9:
            del holder[key]
        elif isinstance(holder, list):
            holder.insert(key, copy.deepcopy(holder[key]))
        else:
            holder[f"{key}x"] = holder.pop(key)
    return json.dumps(tree).encode()


def _iter_places(tree: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (holder, key or index) of every value of a document."""
    pending = [tree]
    while pending:
        holder = pending.pop()
        pairs = holder.items() if isinstance(holder, dict) else enumerate(holder) if isinstance(holder, list) else ()
        for key, value in pairs:
            yield holder, key
            if isinstance(value, dict | list):
                pending.append(value)


def make_mutation(source: bytes, kind: str, seed: int, number: int) -> bytes:
    """Return the `number`-th mutation of a kind's file under a seed, the same on every machine."""
    return mutate(source, np.random.default_rng([seed, number, *kind.encode()]))


def describe_fault(error: BaseException | None, seconds: float) -> str:
    """Return what is wrong with how a read ended, "" if nothing is; `error` is None if it was read."""
    if isinstance(error, _TooLong) or seconds > MAX_READ_S:
        return f"it took more than {MAX_READ_S:g} s"
    if error is None:
        return ""
    if not isinstance(error, HnfError):
        return f"{type(error).__name__}: {error}"
    text = str(error)
    if "\n" in text or RAW_TEXT.search(text) or not error.remedy:
        return f"no clear line: {text}"
    return ""


def describe_outcome(error: BaseException | None, seconds: float) -> str:
    """Return "read", "refused", or what is wrong with how a read ended."""
    return describe_fault(error, seconds) or ("read" if error is None else "refused")


def fuzz_readers(
    kinds: Sequence[str], count: int, seed: int, progress: ProgressCallback = ignore_progress
) -> list[Tally]:
    """Read `count` mutations of each kind of READERS in this process; return a tally for each."""
    tallies = []
    with tempfile.TemporaryDirectory() as name, _alarm():
        sources = make_sources(Path(name))
        for index, kind in enumerate(kinds):
            tally, whole, path = Tally(kind), sources[kind].read_bytes(), sources[kind]
            READERS[kind](path)  # the file itself is read
            for number in range(count):
                if number % 100 == 0:
                    progress(Progress(kind, index * count + number, len(kinds) * count))
                path.write_bytes(make_mutation(whole, kind, seed, number))
                _add(tally, number, *_time_read(READERS[kind], path))
            tallies.append(tally)
    return tallies


def _time_read(reader: Reader, path: Path) -> tuple[BaseException | None, float]:
    started, error = time.monotonic(), None
    signal.setitimer(signal.ITIMER_REAL, MAX_READ_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader(path)
    except (Exception, _TooLong) as caught:
        error = caught
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return error, time.monotonic() - started


def _add(tally: Tally, number: int, error: BaseException | None, seconds: float) -> None:
    tally.slowest_s = max(tally.slowest_s, seconds)
    tally.add(number, describe_outcome(error, seconds))


class _alarm:  # noqa: N801
    """Context in which the timer of a read raises _TooLong."""

    def __enter__(self) -> None:
        self._before = signal.signal(signal.SIGALRM, self._raise)

    def __exit__(self, *about: object) -> None:
        signal.signal(signal.SIGALRM, self._before)

    @staticmethod
    def _raise(*about: object) -> None:
        raise _TooLong


def fuzz_scenes(
    kinds: Sequence[str], count: int, seed: int, progress: ProgressCallback = ignore_progress
) -> list[Tally]:
    """Open `count` mutations of each kind of scene in Blender, some in each process; return a tally for each.

    On a file with which the process ended, `hnf touch` is run by itself, and its answer counts.
    """
    tallies = []
    for index, kind in enumerate(kinds):
        tally, first = Tally(kind), 0
        while first < count:
            progress(Progress(kind, index * count + first, len(kinds) * count))
            with tempfile.TemporaryDirectory() as folder:
                first = _open_some(tally, Path(folder), seed, first, min(first + SCENES_PER_PROCESS, count))
        tallies.append(tally)
    return tallies


def _open_some(tally: Tally, folder: Path, seed: int, first: int, last: int) -> int:
    """Open mutations in a process until it ends, and add them to the tally; return the number of the next one."""
    order = [sys.executable, "-c", _CHILD, str(folder), tally.kind, *map(str, (seed, first, last))]
    done = subprocess.run(order, capture_output=True, text=True, errors="replace", timeout=3600, check=False)
    lines = done.stdout.split("\n")
    answers = [json.loads(line.removeprefix(ANSWER)) for line in lines if line.startswith(ANSWER)]
    for number, outcome, seconds in answers:
        tally.slowest_s = max(tally.slowest_s, seconds)
        tally.add(number, outcome)
    first += len(answers)
    if first == last:
        return last
    said = done.stderr.strip().splitlines()  # the process died on the next one
    why = f"the process ended with {done.returncode}" + (f": {said[-1]}" if said else "")
    if READY not in lines:
        remedy = "Check that bpy is installed, in a version that reads this kind."
        raise FileError(f"{why}.", where=f"a scene of kind '{tally.kind}'", remedy=remedy)
    if any(line.startswith("Timeout (") for line in said):
        tally.add(first, f"it took more than {MAX_SCENE_S:g} s in Blender")
    else:
        outcome = touch_alone(folder / f"ball.{tally.kind}")
        tally.add(first, outcome)
        tally.notes.append(Fault(tally.kind, first, f"{why}; by itself: {outcome}"))
    return first + 1


def touch_alone(path: Path) -> str:
    """Run `hnf touch --plan` on a scene; return "read", "refused", or what is wrong with how it ended."""
    order = [sys.executable, "-c", _TOUCH, "touch", str(path), "--plan"]
    try:
        done = subprocess.run(
            order, capture_output=True, text=True, errors="replace", timeout=MAX_COMMAND_S, check=False
        )
    except subprocess.TimeoutExpired:
        return f"hnf touch took more than {MAX_COMMAND_S:g} s"
    lines = [line for line in done.stderr.splitlines() if line.strip() and not line.startswith("note: ")]
    if done.returncode in (0, 1) and done.stdout and not lines:
        return "read"
    if (
        done.returncode == 1
        and len(lines) == 1
        and lines[0].startswith(f"hnf: {path}: ")
        and not RAW_TEXT.search(lines[0])
    ):
        return "refused"
    return f"hnf touch ended with {done.returncode}: {done.stderr.strip()}"


def open_mutated_scenes(folder: Path, kind: str, seed: int, first: int, last: int) -> None:
    """Open mutations of a ball, which Blender writes to a folder first, and print one line of JSON for each."""
    import faulthandler

    import bpy

    from hnf_blender import props
    from hnf_blender.bridge.importers import open_empty_scene, open_scene
    from hnf_blender.bridge.scene.temp_scene import suppress_output

    props.register()
    path = folder / f"ball.{kind}"
    with _alarm():
        open_empty_scene()
        with suppress_output():
            bpy.ops.mesh.primitive_uv_sphere_add(segments=8, ring_count=6, radius=0.05)
            bpy.context.object.data.materials.append(bpy.data.materials.new("Leather"))
            _export(path)
        whole = path.read_bytes()
        print(f"\n{READY}", flush=True)
        for number in range(first, last):
            path.write_bytes(make_mutation(whole, kind, seed, number))
            faulthandler.dump_traceback_later(MAX_SCENE_S, exit=True)
            error, seconds = _time_read(lambda path: open_scene(path), path)
            faulthandler.cancel_dump_traceback_later()
            print(ANSWER + json.dumps([number, describe_outcome(error, seconds), seconds]), flush=True)


def _export(path: Path) -> None:
    import bpy

    kind, wm = path.suffix[1:], bpy.ops.wm
    if kind in ("gltf", "glb"):
        form = {"gltf": "GLTF_SEPARATE", "glb": "GLB"}[kind]
        bpy.ops.export_scene.gltf(filepath=str(path), export_format=form)
    elif kind == "fbx":
        bpy.ops.export_scene.fbx(filepath=str(path))
    elif kind == "blend":
        wm.save_as_mainfile(filepath=str(path), copy=True, compress=False)
    elif kind == "dae":
        if "collada_export" not in dir(wm):
            raise SystemExit(f"Blender {bpy.app.version_string} reads no COLLADA; versions up to 4.5 do")
        wm.collada_export(filepath=str(path))
    else:
        {"obj": wm.obj_export, "ply": wm.ply_export, "stl": wm.stl_export}.get(kind, wm.usd_export)(filepath=str(path))


_CHILD = (
    "import sys; from pathlib import Path; from hnf_lab.evaluation.fuzz import open_mutated_scenes; "
    "folder, kind, *numbers = sys.argv[1:]; open_mutated_scenes(Path(folder), kind, *map(int, numbers))"
)
_TOUCH = "import sys; from hnf_blender.cli import main; sys.exit(main())"


def format_tallies(tallies: Sequence[Tally], seed: int) -> str:
    """Format the tallies as a Markdown table, with every different fault once below it."""
    lines = ["| file | mutated | read | refused | at fault | slowest |", "| --- | ---: | ---: | ---: | ---: | ---: |"]
    lines += [
        f"| {each.kind} | {each.count} | {each.read} | {each.refused} | {len(each.faults)} | {each.slowest_s:.2f} s |"
        for each in tallies
    ]
    faults = [fault for each in tallies for fault in (*each.faults, *each.notes)]
    alike = Counter((fault.kind, _strip_numbers(fault.what)) for fault in faults)
    for (kind, what), count in alike.most_common():
        first = next(fault for fault in faults if (fault.kind, _strip_numbers(fault.what)) == (kind, what))
        lines.append(f"* {count} × {kind}, first mutation {first.number} of seed {seed}: {first.what}")
    return "\n".join(lines)


def _strip_numbers(text: str) -> str:
    return re.sub(r"\d+|'[^']*'|/\S+", "…", text)
