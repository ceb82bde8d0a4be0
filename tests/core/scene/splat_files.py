"""Splats and splat files that tests make themselves: INRIA's layout in any number format, and PlayCanvas's compressed
one, packed here in whole numbers one splat at a time."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.scene.splats.gaussians import Splats

C0 = 0.28209479177387814
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


def random_splats(count: int, degree: int = 0, seed: int = 0) -> Splats:
    """Splats of a small object: centres within ±1, scales of e^-6 … e^-2, all opacities, colours beyond 0 … 1."""
    random = np.random.default_rng(seed)
    turns = random.normal(size=(count, 4))
    return Splats(
        means=random.uniform(-1.0, 1.0, (count, 3)).astype(np.float32),
        scales=np.exp(random.uniform(-6.0, -2.0, (count, 3))).astype(np.float32),
        rotations=(turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32),
        opacities=random.uniform(0.0, 1.0, count).astype(np.float32),
        harmonics=random.uniform(-2.0, 2.0, (count, (degree + 1) ** 2, 3)).astype(np.float32),
    )


def inria_columns(splats: Splats) -> dict[str, NDArray[np.float64]]:
    """Property name → its numbers, as INRIA's layout has them."""
    opacities = splats.opacities.astype(np.float64)
    found = {name: splats.means[:, axis] for axis, name in enumerate("xyz")}
    found |= {f"f_dc_{channel}": splats.harmonics[:, 0, channel] for channel in range(3)}
    higher = splats.harmonics.shape[1] - 1
    for channel in range(3):
        for number in range(higher):
            found[f"f_rest_{channel * higher + number}"] = splats.harmonics[:, 1 + number, channel]
    found["opacity"] = np.log(opacities / (1.0 - opacities))
    found |= {f"scale_{axis}": np.log(splats.scales[:, axis].astype(np.float64)) for axis in range(3)}
    found |= {f"rot_{part}": splats.rotations[:, part] for part in range(4)}
    return found


def ply_bytes(
    elements: Sequence[tuple[str, dict[str, tuple[str, NDArray]]]],
    form: str = "binary_little_endian",
    comments: Sequence[str] = (),
) -> bytes:
    """elements: (name, property → (type word, numbers)) in order."""
    words = {"float": "f4", "double": "f8", "uchar": "u1", "uint": "u4", "int": "i4"}
    lines = ["ply", f"format {form} 1.0", *(f"comment {each}" for each in comments)]
    data = b""
    for name, columns in elements:
        count = len(next(iter(columns.values()))[1])
        lines.append(f"element {name} {count}")
        lines += [f"property {word} {each}" for each, (word, _) in columns.items()]
        order = ORDERS.get(form, "=")
        rows = np.empty(count, dtype=[(each, order + words[word]) for each, (word, _) in columns.items()])
        for each, (_, numbers) in columns.items():
            rows[each] = numbers
        if form == "ascii":
            data += "".join(" ".join(str(number) for number in row) + "\n" for row in rows.tolist()).encode()
        else:
            data += rows.tobytes()
    return "\n".join([*lines, "end_header\n"]).encode() + data


def floats(columns: dict[str, NDArray], word: str = "float") -> dict[str, tuple[str, NDArray]]:
    return {name: (word, numbers) for name, numbers in columns.items()}


def write_compressed(path: Path, splats: Splats, *, bounds_of_colour: bool = True) -> None:
    """PlayCanvas's layout, quantised splat by splat as its format says (no attempt at speed).

    Without bounds of colour, colours are clipped to 0 … 1.
    """
    count = len(splats)
    chunks = b""
    packed = b""
    logs = np.log(splats.scales.astype(np.float64))
    colours = 0.5 + C0 * splats.harmonics[:, 0].astype(np.float64)
    for first in range(0, count, 256):
        here = slice(first, min(first + 256, count))
        tables = [splats.means[here].astype(np.float64), logs[here], colours[here]]
        ends = [(table.min(axis=0).astype("<f4"), table.max(axis=0).astype("<f4")) for table in tables]
        if not bounds_of_colour:
            ends[2] = (np.zeros(3, "<f4"), np.ones(3, "<f4"))
        for low, high in ends if bounds_of_colour else ends[:2]:
            chunks += low.tobytes() + high.tobytes()
        parts = [
            np.clip((table - low) / np.where(high > low, high.astype(np.float64) - low, 1.0), 0.0, 1.0)
            for table, (low, high) in zip(tables, ends, strict=True)
        ]
        for place in range(here.stop - here.start):
            position, scale, colour = (part[place] for part in parts)
            red, green, blue, alpha = (round(255 * x) for x in (*colour, float(splats.opacities[first + place])))
            packed += struct.pack(
                "<4I",
                _pack_three(position),
                _pack_rotation(splats.rotations[first + place].tolist()),
                _pack_three(scale),
                red << 24 | green << 16 | blue << 8 | alpha,
            )
    names = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
    names += [f"{end}_{axis}" for end in ("min", "max") for axis in "rgb"] if bounds_of_colour else []
    lines = ["ply", "format binary_little_endian 1.0", f"element chunk {-(-count // 256)}"]
    lines += [f"property float {name}" for name in names] + [f"element vertex {count}"]
    lines += [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    higher = splats.harmonics[:, 1:].transpose(0, 2, 1).reshape(count, -1)
    if higher.shape[1]:
        lines += [f"element sh {count}", *(f"property uchar f_rest_{number}" for number in range(higher.shape[1]))]
    harmonics = np.clip(np.trunc((higher / 8.0 + 0.5) * 256.0), 0, 255).astype(np.uint8).tobytes()
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + chunks + packed + harmonics)


def _pack_three(fractions: Sequence[float]) -> int:
    x, y, z = fractions
    return round(2047 * x) << 21 | round(1023 * y) << 11 | round(2047 * z)


def _pack_rotation(rotation: list[float]) -> int:
    largest = max(range(4), key=lambda part: abs(rotation[part]))
    sign = -1.0 if rotation[largest] < 0.0 else 1.0
    word = largest
    for part in range(4):
        if part != largest:
            word = word << 10 | min(max(round(1023 * (sign * rotation[part] / 2**0.5 + 0.5)), 0), 1023)
    return word


def angles_between(one: Splats, other: Splats) -> NDArray[np.float64]:
    """(N,) radians between the rotations, q and −q being the same; from the chord, which is exact near 0."""
    here, there = one.rotations.astype(np.float64), other.rotations.astype(np.float64)
    chord = np.minimum(np.linalg.norm(here - there, axis=1), np.linalg.norm(here + there, axis=1))
    return np.asarray(4.0 * np.arcsin(chord / 2.0))
