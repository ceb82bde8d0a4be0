"""The palette of a mesh: its distinct materials once each, so that faces store only an index."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import FileError, MaterialError
from ..files import content_hash
from ..safetensors_io import pack_header, split_header
from .contact_model import LEARNED_MECHANICS, MECHANICS_NAMES, Mechanics
from .token import ENCODER_ID, ENCODER_NAMES, TOKEN_DIM, joined_encoders, split_encoders

PALETTE_SCHEMA = 1
MERGE_TOLERANCE = 0.01
"""Largest difference of any token feature at which materials merge: 0.01 of a level is 0.2 dB of height, well below
what can be felt."""
_KIND = "hnf-palette"
_PROPERTY_COUNTS = (len(LEARNED_MECHANICS), len(MECHANICS_NAMES) - 1, len(MECHANICS_NAMES))
"""Properties a material in palettes of version 0.1, in those without a scatter of pitch, and today."""
_REMEDY = "Bake the object again."


@dataclass(frozen=True, eq=False)
class Palette:
    """Tokens (feature vectors) and mechanics of the P distinct materials of a mesh.

    Palettes are equal if their contents are, bit for bit. Raises MaterialError if the parts do not fit together or a
    token is not finite.

    Attributes
    ----------
    tokens : ndarray of float32, shape (P, TOKEN_DIM)
        Material tokens.
    mechanics : tuple of Mechanics
        Mechanics of each material.
    names : tuple of str
        Names of the materials.
    schema : int
        Version of the stored form.
    encoder_id : str
        Names of the encoders that made the tokens, joined by `token.joined_encoders`.
    """

    tokens: NDArray[np.float32]
    mechanics: tuple[Mechanics, ...]
    names: tuple[str, ...]
    schema: int = PALETTE_SCHEMA
    encoder_id: str = ENCODER_ID

    def __post_init__(self) -> None:
        if self.tokens.shape != (len(self.names), TOKEN_DIM) or len(self.mechanics) != len(self.names):
            raise MaterialError(
                f"a palette of {len(self.names)} names needs ({len(self.names)}, {TOKEN_DIM}) tokens and as many "
                f"mechanics, not {self.tokens.shape} and {len(self.mechanics)}."
            )
        if self.tokens.dtype != np.float32 or not np.isfinite(self.tokens).all():
            raise MaterialError("a palette's tokens must be finite float32 values.")

    def __len__(self) -> int:
        return len(self.names)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Palette) and self.to_bytes() == other.to_bytes()

    def __hash__(self) -> int:
        return hash(self.content_hash)

    @property
    def content_hash(self) -> str:
        """Hex digest of the palette's content."""
        facts, tokens, mechanics = self._serialise_parts()
        return content_hash(json.dumps(facts, sort_keys=True), tokens, mechanics)

    def to_bytes(self) -> bytes:
        """Serialise in the safetensors layout (no pickle), digest included; equal palettes give equal bytes."""
        facts, tokens, mechanics = self._serialise_parts()
        header = {
            "__metadata__": {**facts, "digest": self.content_hash},
            "mechanics": {
                "dtype": "F64",
                "shape": [len(self), self._property_count],
                "data_offsets": [0, len(mechanics)],
            },
            "tokens": {
                "dtype": "F32",
                "shape": [len(self), TOKEN_DIM],
                "data_offsets": [len(mechanics), len(mechanics) + len(tokens)],
            },
        }
        return pack_header(header) + mechanics + tokens

    @classmethod
    def from_bytes(cls, data: bytes) -> Palette:
        """Parse the bytes of `to_bytes`; raise FileError if damaged, of another schema, or of an unknown encoder."""
        try:
            facts, tokens, table = _unpack_palette(data)
            schema, encoder = int(facts["schema"]), facts["encoder"]
            names = tuple(str(name) for name in json.loads(facts["names"]))
            mechanics = tuple(Mechanics(*(None if np.isnan(v) else float(v) for v in row)) for row in table)
            palette = cls(tokens, mechanics, names, schema, encoder)
            # A palette has one serialised form, so writing it again must give the same bytes, digest included.
            if palette.to_bytes() != bytes(data):
                raise ValueError("its digest does not match its contents")
        except (ValueError, KeyError, TypeError, RecursionError, MaterialError) as error:
            raise FileError(f"the stored palette is damaged ({error}).", remedy=_REMEDY) from error
        try:
            split_encoders(encoder)
            known = schema == PALETTE_SCHEMA
        except ValueError:
            known = False
        if not known:
            raise FileError(
                f"the stored palette has schema {schema} and encoder '{encoder}'; this version reads schema "
                f"{PALETTE_SCHEMA} and {' and '.join(ENCODER_NAMES)}.",
                remedy=_REMEDY,
            )
        return palette

    @property
    def _property_count(self) -> int:
        """Number of properties written: as many as are known, so that older palettes keep their bytes."""
        known = [
            index
            for index, name in enumerate(MECHANICS_NAMES)
            if any(getattr(entry, name) is not None for entry in self.mechanics)
        ]
        return next(width for width in _PROPERTY_COUNTS if width > max(known, default=0))

    def _serialise_parts(self) -> tuple[dict[str, str], bytes, bytes]:
        facts = {
            "kind": _KIND,
            "schema": str(self.schema),
            "encoder": self.encoder_id,
            "names": json.dumps(list(self.names)),
        }
        table = np.array(
            [
                [_or_nan(getattr(entry, name)) for name in MECHANICS_NAMES[: self._property_count]]
                for entry in self.mechanics
            ],
            dtype="<f8",
        ).reshape(len(self), self._property_count)
        return facts, self.tokens.astype("<f4").tobytes(), table.tobytes()


def build_palette(
    tokens: Sequence[NDArray[np.float32]],
    mechanics: Sequence[Mechanics],
    names: Sequence[str],
    encoders: Iterable[str] = (ENCODER_ID,),
) -> tuple[Palette, NDArray[np.int32]]:
    """Build the palette of n materials, in which near-equal materials are merged.

    They have the same name and mechanics, and tokens whose features differ by at most MERGE_TOLERANCE.

    Parameters
    ----------
    tokens : sequence of ndarray
        Tokens of the materials.
    mechanics : sequence of Mechanics
        Mechanics of the materials.
    names : sequence of str
        Names of the materials.
    encoders : iterable of str
        Names of the encoders that any of the tokens came from.

    Returns
    -------
    palette : Palette
        First material of each merged group, in order of first appearance.
    index : ndarray of int32, shape (n,)
        Position of each material in the palette.

    Raises
    ------
    ValueError
        For an unknown encoder.
    """
    unique: list[int] = []
    index = np.empty(len(tokens), dtype=np.int32)
    for i, token in enumerate(tokens):
        for position, k in enumerate(unique):
            same = names[k] == names[i] and mechanics[k] == mechanics[i]
            if same and float(np.max(np.abs(tokens[k].astype(np.float64) - token))) <= MERGE_TOLERANCE:
                index[i] = position
                break
        else:
            index[i] = len(unique)
            unique.append(i)
    table = np.array([tokens[k] for k in unique], dtype=np.float32).reshape(len(unique), TOKEN_DIM)
    palette = Palette(
        table,
        tuple(mechanics[k] for k in unique),
        tuple(names[k] for k in unique),
        encoder_id=joined_encoders(encoders),
    )
    return palette, index


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _unpack_palette(data: bytes) -> tuple[dict[str, str], NDArray[np.float32], NDArray[np.float64]]:
    """Return metadata, tokens (P, TOKEN_DIM) and mechanics (P, properties).

    Raises ValueError, KeyError or TypeError.
    """
    header, body = split_header(data)
    facts = dict(header["__metadata__"])
    if facts["kind"] != _KIND:
        raise ValueError("it is something else")
    count = int(header["tokens"]["shape"][0])
    width = int(header["mechanics"]["shape"][1])
    middle = count * width * 8
    if width not in _PROPERTY_COUNTS:
        raise ValueError(f"it has {width} properties a material")
    if count < 0 or len(body) != middle + count * TOKEN_DIM * 4:
        raise ValueError("its arrays have unexpected shapes")
    table = np.frombuffer(body, dtype="<f8", count=count * width).reshape(count, width)
    values = np.frombuffer(body, dtype="<f4", offset=middle).reshape(count, TOKEN_DIM)
    return facts, values.astype(np.float32), table.astype(np.float64)
