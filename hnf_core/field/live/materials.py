"""A material, as one has it at hand, ready to be touched."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import UsageError
from ...material.hnf_file import HNF_SUFFIX, MaterialFile, read_hnf, with_library_defaults
from ...material.library import get_material
from ...material.material import LibraryMaterial
from ..field import Field
from ..learned import load_material_field
from ..weights import load_field, read_trained_material
from .synthesis import LiveSynthesis

AnyMaterial = str | Path | LibraryMaterial | MaterialFile
"""A name of the library, a `.hnf` file, or what was read from either."""


def resolve_material(material: AnyMaterial) -> LibraryMaterial:
    """With nothing left open: what a file does not know comes from the library (hnf_file.completed).

    Raises MaterialError for a name that is not in the library, FileError for a file that cannot be used.
    """
    if isinstance(material, LibraryMaterial):
        return material
    definition = _read_definition(material)
    return get_material(str(material)) if definition is None else with_library_defaults(definition)


def create_live_synthesis(
    *materials: AnyMaterial, seed: int = 0, probe: str = "pen", field: Field | None = None
) -> LiveSynthesis:
    """Materials 0, 1, … under a hand. field: None is that of a single material that brings one, else the shared one.
    Takes some 50 ms, as its first noise is made.

    Raises what material_of() and LiveSynthesis raise.
    """
    if not materials:
        raise UsageError("there is nothing to touch.", remedy="Name a material.")
    if len(materials) == 1 and field is None:
        definition = _read_definition(materials[0])
        field = None if definition is None else load_material_field(definition)
        if definition is not None and field is not None:
            materials = (read_trained_material(field, definition.name),)
    known = [resolve_material(material) for material in materials]
    tokens = np.stack([material.token for material in known])
    return LiveSynthesis(
        load_field() if field is None else field, tokens, [each.mechanics for each in known], seed=seed, probe=probe
    )


def _read_definition(material: AnyMaterial) -> MaterialFile | None:
    """What a file says, where material is or names one."""
    if isinstance(material, Path) or (isinstance(material, str) and material.lower().endswith(HNF_SUFFIX)):
        return read_hnf(Path(material))
    return material if isinstance(material, MaterialFile) else None
