"""Training data of the shared field: surfaces, simulated strokes over them and their spectra; kept in files."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import FileError
from hnf_core.field.features import PROBE_KINDS
from hnf_core.files import write_bytes
from hnf_core.material.contact_model import Mechanics
from hnf_core.safetensors_io import dump_tensors, load_tensors
from hnf_lab.shared_field.simulated_strokes import (
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
"""Materials encoded together, which bounds the memory of their height maps."""


@dataclass(frozen=True)
class Sizes:
    """Amounts of training data for the shared field.

    Attributes
    ----------
    instances
        Random materials of every material class, besides those of the library.
    patches
        Patches (height maps) per material on which strokes are simulated.
    described
        Further patches per material, of which only the token is computed.
    strokes
        Strokes per patch.
    middle_share
        Fraction of them in the middle ranges of speed and force.
    random
        Random surfaces that belong to no material.
    random_strokes
        Strokes on each of these.
    seconds
        Duration of a stroke [s].
    """

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
    """Surfaces, simulated strokes over them and the spectra of these.

    Attributes
    ----------
    names, classes
        Name of each material and of its class.
    material
        (surfaces,) index of the material, −1 for a surface of no material.
    tokens
        (surfaces, TOKEN_DIM) token of each surface.
    strokes
        Steady strokes, each on one of the surfaces.
    power
        (strokes, 107) spectral densities of the strokes: 100 bins of 10 Hz, then seven wider bands.
    """

    names: tuple[str, ...]
    classes: tuple[str, ...]
    material: NDArray[np.int64]
    tokens: NDArray[np.float32]
    strokes: tuple[SteadyStroke, ...]
    power: Float

    def get_stroke_materials(self) -> NDArray[np.int64]:
        """Return the material index (strokes,) of each stroke, −1 for none."""
        return self.material[[stroke.surface for stroke in self.strokes]]

    def select_strokes(self, rows: NDArray[np.bool_]) -> TrainingData:
        """Return the same surfaces with only the strokes that the mask `rows` (strokes,) selects."""
        strokes = tuple(stroke for stroke, row in zip(self.strokes, rows, strict=True) if row)
        return replace(self, strokes=strokes, power=self.power[rows])

    def draw_alternative_patches(self, rng: np.random.Generator) -> list[int]:
        """Draw for every stroke the index of another surface of the same material; its own if there is no other."""
        surfaces_by_material = {index: np.flatnonzero(self.material == index) for index in range(len(self.names))}
        drawn = []
        for stroke in self.strokes:
            candidates = surfaces_by_material.get(int(self.material[stroke.surface]), np.zeros(0, dtype=np.intp))
            others = candidates[candidates != stroke.surface]
            drawn.append(int(rng.choice(others)) if len(others) else stroke.surface)
        return drawn


def load_specimens(library: Path, sizes: Sizes) -> list[Specimen]:
    """Return the materials to train on: the library's, then random ones of every material class."""
    return load_library_specimens(library) + make_class_specimens(range(1, sizes.instances + 1))


def build_training_data(specimens: Sequence[Specimen], sizes: Sizes, seed: int, workers: int = 2) -> TrainingData:
    """Build all surfaces and simulate strokes over them; the result does not depend on the number of workers."""
    surfaces = make_patches(specimens, 0, sizes.patches, workers)
    stroked_count = len(surfaces)
    surfaces += make_random_surfaces(sizes.random, seed, workers)
    described_surfaces = make_patches(specimens, sizes.patches, sizes.described, workers) if sizes.described else []
    print(f"{len(surfaces) + len(described_surfaces)} surfaces", file=sys.stderr)
    strokes = draw_steady_strokes(surfaces[:stroked_count], sizes.strokes, seed + 1, middle_share=sizes.middle_share)
    strokes += [
        replace(stroke, surface=stroke.surface + stroked_count)
        for stroke in draw_steady_strokes(surfaces[stroked_count:], sizes.random_strokes, seed + 2)
    ]
    rows = np.arange(len(specimens))
    no_material = np.full(len(surfaces) - stroked_count, -1)
    material = np.concatenate([np.repeat(rows, sizes.patches), no_material, np.repeat(rows, sizes.described)])
    return TrainingData(
        names=tuple(specimen.name for specimen in specimens),
        classes=tuple(specimen.class_name for specimen in specimens),
        material=material,
        tokens=np.stack([surface.token for surface in surfaces + described_surfaces]),
        strokes=tuple(strokes),
        power=record_strokes(surfaces, strokes, sizes.seconds, workers),
    )


def encode_surfaces(
    encoder: str, specimens: Sequence[Specimen], sizes: Sizes, seed: int, workers: int = 2
) -> NDArray[np.float32]:
    """Compute tokens (surfaces, TOKEN_DIM) of build_training_data's surfaces with another encoder (name or file)."""

    def encode_patches(first: int, count: int) -> list[NDArray[np.float32]]:
        # Only the tokens stay in memory, not the heights of all materials.
        return [
            surface.token
            for start in range(0, len(specimens), MATERIALS_PER_BATCH)
            for surface in make_patches(specimens[start : start + MATERIALS_PER_BATCH], first, count, workers, encoder)
        ]

    tokens = encode_patches(0, sizes.patches)
    tokens += [surface.token for surface in make_random_surfaces(sizes.random, seed, workers, encoder)]
    tokens += encode_patches(sizes.patches, sizes.described) if sizes.described else []
    return np.stack(tokens)


_COLUMNS = ("surface", "stiffness", "damping", "friction", "probe", "speed", "angle", "force", "start_x", "start_y")


def save_training_data(path: Path, data: TrainingData) -> None:
    """Write training data as safetensors; the mechanics of every stroke must be known. Raises FileError."""
    table = np.array(
        [
            (s.surface, s.mechanics.stiffness_n_m, s.mechanics.damping_ratio, s.mechanics.friction,
             PROBE_KINDS.index(s.probe), s.speed, s.angle, s.force, *s.start)
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
    """Read the file that save_training_data wrote. Raises FileError."""
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
        values = dict(zip(_COLUMNS, row, strict=True))
        strokes.append(
            SteadyStroke(
                surface=int(values["surface"]),
                mechanics=Mechanics(values["stiffness"], values["damping"], values["friction"]),
                probe=PROBE_KINDS[int(values["probe"])],
                speed=int(values["speed"]),
                angle=float(values["angle"]),
                force=float(values["force"]),
                start=(float(values["start_x"]), float(values["start_y"])),
            )
        )
    return TrainingData(names, classes, material, tokens, tuple(strokes), power)


def select_classes(data: TrainingData, class_names: Sequence[str]) -> TrainingData:
    """Return the strokes on materials of these classes and on surfaces of no material."""
    classes = np.array([name in class_names for name in data.classes])
    material = data.get_stroke_materials()
    return data.select_strokes(np.where(material < 0, True, classes[material]))
