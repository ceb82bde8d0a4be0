"""What the shared field is trained on: surfaces, strokes over them, and what was felt. Kept on disk between runs."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError
from ..files import write_bytes
from ..material.contact_model import Mechanics
from ..material.probe import PROBES
from ..safetensors_io import dump_tensors, load_tensors
from .simulated_strokes import (
    Specimen,
    SteadyStroke,
    draw_steady_strokes,
    load_library_specimens,
    make_class_specimens,
    make_patches,
    make_random_surfaces,
    record_strokes,
)

Float = NDArray[np.float64]

MATERIALS_PER_BATCH = 8


@dataclass(frozen=True)
class Sizes:
    """instances: of every class, beside the library's own. patches: stroked, per material; described: more, only looked
    at. strokes: per patch, of `seconds`, middle_share of them where strokes mostly are. random: surfaces of no
    material; random_strokes: on each."""

    instances: int = 1
    patches: int = 2
    described: int = 6
    strokes: int = 70
    middle_share: float = 0.7
    random: int = 150
    random_strokes: int = 16
    seconds: float = 0.3


@dataclass(frozen=True)
class TrainingData:
    """names, classes: one per material, in words. material: (surfaces,) index, −1 for a surface of no material.
    tokens: (surfaces, TOKEN_DIM). power: (strokes, 107) observed."""

    names: tuple[str, ...]
    classes: tuple[str, ...]
    material: NDArray[np.int64]
    tokens: NDArray[np.float32]
    strokes: tuple[SteadyStroke, ...]
    power: Float

    def get_stroke_materials(self) -> NDArray[np.int64]:
        """(strokes,) index, −1 for none."""
        return self.material[[stroke.surface for stroke in self.strokes]]

    def select_strokes(self, rows: NDArray[np.bool_]) -> TrainingData:
        """The same surfaces, some of the strokes."""
        kept = tuple(stroke for stroke, row in zip(self.strokes, rows, strict=True) if row)
        return replace(self, strokes=kept, power=self.power[rows])

    def draw_alternative_patches(self, rng: np.random.Generator) -> list[int]:
        """For every stroke another surface of the same material at random; its own where there is no other."""
        same = {m: np.flatnonzero(self.material == m) for m in range(len(self.names))}
        found = []
        for stroke in self.strokes:
            patches_here = same.get(int(self.material[stroke.surface]), np.zeros(0, dtype=np.intp))
            others = patches_here[patches_here != stroke.surface]
            found.append(int(rng.choice(others)) if len(others) else stroke.surface)
        return found


def load_specimens(library: Path, sizes: Sizes) -> list[Specimen]:
    """The library's materials, then the instances of every class."""
    return load_library_specimens(library) + make_class_specimens(range(1, sizes.instances + 1))


def build_training_data(specimens: Sequence[Specimen], sizes: Sizes, seed: int, workers: int = 2) -> TrainingData:
    """Simulate everything. The result depends on the seed, not on the number of workers."""
    surfaces = make_patches(specimens, 0, sizes.patches, workers)
    own = len(surfaces)
    surfaces += make_random_surfaces(sizes.random, seed, workers)
    more = make_patches(specimens, sizes.patches, sizes.described, workers) if sizes.described else []
    print(f"{len(surfaces) + len(more)} surfaces", file=sys.stderr)
    strokes = draw_steady_strokes(surfaces[:own], sizes.strokes, seed + 1, middle_share=sizes.middle_share)
    strokes += [
        replace(stroke, surface=stroke.surface + own)
        for stroke in draw_steady_strokes(surfaces[own:], sizes.random_strokes, seed + 2)
    ]
    rows = np.arange(len(specimens))
    nothing = np.full(len(surfaces) - own, -1)
    material = np.concatenate([np.repeat(rows, sizes.patches), nothing, np.repeat(rows, sizes.described)])
    return TrainingData(
        names=tuple(each.name for each in specimens),
        classes=tuple(each.class_name for each in specimens),
        material=material,
        tokens=np.stack([surface.token for surface in surfaces + more]),
        strokes=tuple(strokes),
        power=record_strokes(surfaces, strokes, sizes.seconds, workers),
    )


def encode_surfaces(
    encoder: str, specimens: Sequence[Specimen], sizes: Sizes, seed: int, workers: int = 2
) -> NDArray[np.float32]:
    """(surfaces, TOKEN_DIM): what another make of E (its name or file) says of the surfaces that gather describes."""

    def of_patches(first: int, count: int) -> list[NDArray[np.float32]]:
        # A few materials at a time: only their tokens are kept, not their heights.
        return [
            surface.token
            for start in range(0, len(specimens), MATERIALS_PER_BATCH)
            for surface in make_patches(specimens[start : start + MATERIALS_PER_BATCH], first, count, workers, encoder)
        ]

    tokens = of_patches(0, sizes.patches)
    tokens += [surface.token for surface in make_random_surfaces(sizes.random, seed, workers, encoder)]
    tokens += of_patches(sizes.patches, sizes.described) if sizes.described else []
    return np.stack(tokens)


_COLUMNS = ("surface", "stiffness", "damping", "friction", "probe", "speed", "angle", "force", "start_x", "start_y")


def save_training_data(path: Path, data: TrainingData) -> None:
    """Write as safetensors. Every stroke's mechanics must be known. Raises FileError."""
    table = np.array(
        [
            (s.surface, s.mechanics.stiffness_n_m, s.mechanics.damping_ratio, s.mechanics.friction,
             list(PROBES).index(s.probe), s.speed, s.angle, s.force, *s.start)
            for s in data.strokes
        ],
        dtype=np.float64,
    )  # fmt: skip
    tensors: dict[str, NDArray[Any]] = {
        "material": data.material,
        "tokens": data.tokens,
        "strokes": table,
        "power": data.power,
    }
    metadata = {"names": "\n".join(data.names), "classes": "\n".join(data.classes)}
    write_bytes(path, dump_tensors(tensors, metadata))


def load_training_data(path: Path) -> TrainingData:
    """What save_gathered wrote. Raises FileError where it cannot be read."""
    try:
        tensors, metadata = load_tensors(path.read_bytes())
        material, tokens, table, power = (tensors[name] for name in ("material", "tokens", "strokes", "power"))
        names, classes = (tuple(metadata[key].split("\n")) for key in ("names", "classes"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileError(
            f"no gathered strokes ({error}).", where=str(path), remedy="Delete it to simulate again."
        ) from error
    strokes = []
    for row in table:
        each = dict(zip(_COLUMNS, row, strict=True))
        strokes.append(
            SteadyStroke(
                surface=int(each["surface"]),
                mechanics=Mechanics(each["stiffness"], each["damping"], each["friction"]),
                probe=tuple(PROBES)[int(each["probe"])],
                speed=int(each["speed"]),
                angle=float(each["angle"]),
                force=float(each["force"]),
                start=(float(each["start_x"]), float(each["start_y"])),
            )
        )
    return TrainingData(names, classes, material, tokens, tuple(strokes), power)


def select_classes(data: TrainingData, class_names: Sequence[str]) -> TrainingData:
    """Strokes on materials of these classes and on surfaces of no material."""
    classes = np.array([name in class_names for name in data.classes])
    material = data.get_stroke_materials()
    return data.select_strokes(np.where(material < 0, True, classes[material]))
