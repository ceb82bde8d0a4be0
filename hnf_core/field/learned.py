"""A material that brings its own field: learned from recordings of it, kept and sent as one `.hnf` file."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..material.hnf_file import MAX_NAME_BYTES, MaterialFile
from ..material.token import Token
from .field import Field
from .weights import parse_field, read_trained_material

CACHED_FIELDS = 16
"""Fields that are read once: of the learned materials of a scene."""


def build_learned_material(weights: bytes, where: str) -> MaterialFile:
    """The material that weights (field.weights.field_bytes) were trained for, with the weights in it. Its token is
    known where training knew one; else the library says what it is like wherever the field is not asked.

    where: names the source in messages. Raises WeightsError where the weights are damaged or of no one material.
    """
    field = parse_field(weights, where)
    trained = read_trained_material(field, where)
    token = Token(trained.token, np.full(trained.token.shape, bool(trained.token.any())))
    name = "".join(each if each.isprintable() else " " for each in trained.name).strip() or "learned"
    while len(name.encode()) > MAX_NAME_BYTES:
        name = name[:-1]
    licence = field.metadata.get("licence", "")
    return MaterialFile(name, token, trained.mechanics, words=(name.lower(),), licence=licence, field=weights)


def load_material_field(material: MaterialFile) -> Field | None:
    """The field that material brings, read once; None where it brings none. Raises WeightsError where it is damaged or
    of no one material."""
    return _parse_material_field(material.field, material.name) if material.field else None


@lru_cache(maxsize=CACHED_FIELDS)
def _parse_material_field(weights: bytes, name: str) -> Field:
    where = f"material '{name}'"
    field = parse_field(weights, where)
    read_trained_material(field, where)
    return field
