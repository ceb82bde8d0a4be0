"""The `.hnf` file: one material, its token, mechanics and appearance, and optionally a field trained for it.

The layout is safetensors (no pickle): "token" F32 and "known" BOOL, (TOKEN_DIM,) each; text metadata format, encoder,
name, category, licence, and as JSON words, appearance and mechanics, null = unknown. A file is a few kilobytes; the
weights of a field, "field" U8, add a megabyte or less.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, MaterialError
from ..files import write_bytes
from ..safetensors_io import pack_header, split_header
from .contact_model import UNKNOWN_MECHANICS, Mechanics, describe_limit_violation
from .fuse import fuse
from .library import Appearance, LibraryMaterial, load_library
from .ranking import rank
from .token import ENCODER_ID, ENCODER_NAMES, LARGEST_VALUE, TOKEN_DIM, Token

HNF_SUFFIX = ".hnf"
HNF_FORMAT = "hnf-material-1"
MAX_FILE_BYTES = 1 << 24
"""Largest accepted file, and more than any header needs [bytes]."""
MAX_NAME_BYTES = 63
"""Longest name that Blender stores without cutting [bytes]."""
UNKNOWN_APPEARANCE = Appearance()
_TENSORS = {"token": ("F32", 4), "known": ("BOOL", 1)}
_FIELD = "field"
_REMEDY = "Get the file again, or write it with: hnf materials --export NAME --out FILE.hnf"


@dataclass(frozen=True, eq=False)
class MaterialFile:
    """Content of a `.hnf` file.

    Two are equal if their bytes are. Raises MaterialError for a value that cannot be: an empty name, a token that is
    not finite, a stiffness of zero, or more in total than a file may hold.

    Attributes
    ----------
    name : str
        Name for people, one line.
    token : Token
        Token (feature vector of the micro-geometry); unknown values can be completed from the library (`complete`).
    mechanics : Mechanics
        Stiffness, damping and friction; None = unknown.
    category : str
        Category of the library, or "".
    words : tuple of str
        Words that name such a material.
    appearance : Appearance
        Typical shading values.
    licence : str
        SPDX expression or text.
    encoder : str
        Encoders that the token came from (`token.joined_encoders`).
    field : bytes
        Weights of a field trained for this material alone (read by `field.weights.load_material_field`); empty if the
        shared field is used.
    """

    name: str
    token: Token
    mechanics: Mechanics = UNKNOWN_MECHANICS
    category: str = ""
    words: tuple[str, ...] = ()
    appearance: Appearance = UNKNOWN_APPEARANCE
    licence: str = ""
    encoder: str = ENCODER_ID
    field: bytes = b""

    def __post_init__(self) -> None:
        if not self.name.strip() or not self.name.isprintable() or len(self.name.encode()) > MAX_NAME_BYTES:
            raise MaterialError(f"a material's name must be one line of at most {MAX_NAME_BYTES} bytes.")
        values, known = self.token.values, self.token.known
        if values.shape != (TOKEN_DIM,) or known.shape != (TOKEN_DIM,):
            raise MaterialError(f"a token has {TOKEN_DIM} values and flags, not {values.shape} and {known.shape}.")
        if values.dtype != np.float32 or known.dtype != np.bool_ or not (np.abs(values) <= LARGEST_VALUE).all():
            raise MaterialError(
                f"a token's values must be finite float32, none beyond ±{LARGEST_VALUE:g}, its flags true or false."
            )
        problem = describe_limit_violation(self.mechanics)
        if problem:
            raise MaterialError(problem)
        for name, value in asdict(self.appearance).items():
            for channel in () if value is None else np.ravel(value):
                if not 0.0 <= channel <= 1.0:
                    raise MaterialError(f"{name} must lie between 0 and 1, not {channel:g}.")
        size = len(self._header()) + TOKEN_DIM * sum(width for _, width in _TENSORS.values()) + len(self.field)
        if size > MAX_FILE_BYTES:
            raise MaterialError(
                f"its file would be of {size} bytes, and {MAX_FILE_BYTES} ({MAX_FILE_BYTES >> 20} MiB) are the most.",
                remedy="Train its field with fewer units (hidden), or shorten its words.",
            )

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MaterialFile) and self.to_bytes() == other.to_bytes()

    def __hash__(self) -> int:
        return hash(self.to_bytes())

    def to_bytes(self) -> bytes:
        """Return the file's bytes; equal materials give equal bytes."""
        token, known = self.token.values.astype("<f4").tobytes(), self.token.known.tobytes()
        return self._header() + token + known + self.field

    def _header(self) -> bytes:
        metadata = {
            "format": HNF_FORMAT,
            "encoder": self.encoder,
            "name": self.name,
            "category": self.category,
            "licence": self.licence,
            "words": json.dumps(self.words),
            "appearance": json.dumps(asdict(self.appearance), sort_keys=True),
            "mechanics": json.dumps(asdict(self.mechanics), sort_keys=True),
        }
        header: dict[str, Any] = {"__metadata__": metadata}
        start = 0
        for name, (dtype, width) in _TENSORS.items():
            end = start + TOKEN_DIM * width
            header[name] = {"dtype": dtype, "shape": [TOKEN_DIM], "data_offsets": [start, end]}
            start = end
        if self.field:
            header[_FIELD] = {
                "dtype": "U8", "shape": [len(self.field)], "data_offsets": [start, start + len(self.field)]
            }  # fmt: skip
        return pack_header(header)

    def complete(self, prior: LibraryMaterial) -> LibraryMaterial:
        """Return this material as a library material, with unknown token values and mechanics taken from `prior`."""
        is_complete = bool(self.token.known.all())
        token = self.token.values if is_complete else fuse(self.token, prior.token, 0.0).values
        given = {name: value for name, value in asdict(self.mechanics).items() if value is not None}
        mechanics = replace(prior.mechanics, **given)
        return LibraryMaterial(self.name, self.category, self.words, self.appearance, mechanics, token)


def with_library_defaults(material: MaterialFile) -> LibraryMaterial:
    """Complete a material from the library material that best fits its name, category, words and appearance."""
    library = load_library()
    names = [material.name, material.category, *material.words]
    best = rank(library, material.appearance, names)[0].name
    return material.complete(next(entry for entry in library if entry.name == best))


def from_library(material: LibraryMaterial, licence: str = "") -> MaterialFile:
    """Convert a library material to a material file, without the recipe that its surface was generated from."""
    token = Token(material.token.astype(np.float32), np.ones(TOKEN_DIM, dtype=bool))
    return MaterialFile(
        material.name, token, material.mechanics, material.category, material.words, material.appearance, licence
    )


def write_hnf(path: Path, material: MaterialFile) -> None:
    """Write a material file atomically; raise FileError if the disk refuses, with an earlier file unharmed."""
    write_bytes(path, material.to_bytes())


def read_hnf(path: Path) -> MaterialFile:
    """Read a `.hnf` file; raise FileError if it is missing or damaged (see `parse_hnf`)."""
    try:
        with path.open("rb") as stream:
            data = stream.read(MAX_FILE_BYTES + 1)
    except OSError as error:
        raise FileError(
            f"cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the file's path."
        ) from error
    return parse_hnf(data, str(path))


def parse_hnf(data: bytes, where: str) -> MaterialFile:
    """Parse the bytes of a `.hnf` file.

    Parameters
    ----------
    data : bytes
        Content of the file.
    where : str
        Name of the source in messages.

    Returns
    -------
    MaterialFile
        The material.

    Raises
    ------
    FileError
        If the bytes are no such file, cut short, claim a huge header, hold arrays of another shape or impossible
        values, or belong to an unknown encoder.
    """
    try:
        metadata, arrays = _unpack(data)
        if metadata.get("format") != HNF_FORMAT:
            raise ValueError(f"its format is {metadata.get('format', 'not given')!r}, not {HNF_FORMAT!r}")
        encoder = str(metadata.get("encoder", ""))
        if not all(name in ENCODER_NAMES for name in encoder.split("+")):
            raise FileError(
                f"its token comes from encoder {encoder!r}, and this version reads "
                f"{' and '.join(map(repr, ENCODER_NAMES))}.",
                where=where,
                remedy="Ask for a file of this version, or describe the material again with this version.",
            )
        return MaterialFile(
            name=metadata["name"],
            token=Token(np.frombuffer(arrays["token"], "<f4").astype(np.float32), _parse_flags(arrays["known"])),
            mechanics=Mechanics(**_parse_numbers(dict(json.loads(metadata["mechanics"])), Mechanics)),
            category=metadata.get("category", ""),
            words=_parse_words(metadata.get("words", "[]")),
            appearance=_parse_appearance(dict(json.loads(metadata["appearance"]))),
            licence=metadata.get("licence", ""),
            encoder=encoder,
            field=arrays.get(_FIELD, b""),
        )
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError, MaterialError) as error:
        why = f"{error} is missing" if isinstance(error, KeyError) else str(error).rstrip(".")
        raise FileError(f"is not a usable material file: {why}.", where=where, remedy=_REMEDY) from error


def _unpack(data: bytes) -> tuple[dict[str, str], dict[str, bytes]]:
    """Return metadata and the raw bytes of each array of a file; raise ValueError, KeyError or TypeError if damaged."""
    if len(data) >= 8 and max(len(data), int.from_bytes(data[:8], "little")) > MAX_FILE_BYTES:
        raise ValueError("it is larger than any material, or something else")
    header, body = split_header(data)
    metadata = {str(key): str(value) for key, value in dict(header["__metadata__"]).items()}
    arrays = {}
    for name, (dtype, width) in _TENSORS.items():
        entry = header[name]
        start, stop = (int(offset) for offset in entry["data_offsets"])
        if entry["dtype"] != dtype or entry["shape"] != [TOKEN_DIM] or stop - start != TOKEN_DIM * width:
            raise ValueError(f"{name} should be {dtype} of shape [{TOKEN_DIM}]")
        if start < 0 or stop > len(body):
            raise ValueError("it ends early")
        arrays[name] = body[start:stop]
    if _FIELD in header:
        start, stop = (int(offset) for offset in header[_FIELD]["data_offsets"])
        if header[_FIELD]["dtype"] != "U8" or not 0 <= start < stop <= len(body):
            raise ValueError("it ends early")
        arrays[_FIELD] = body[start:stop]
    return metadata, arrays


def _parse_flags(data: bytes) -> np.ndarray[Any, np.dtype[np.bool_]]:
    flags = np.frombuffer(data, np.uint8)
    if (flags > 1).any():
        raise ValueError("known holds something else than true and false")
    return flags.astype(np.bool_)


def _parse_words(text: str) -> tuple[str, ...]:
    words = json.loads(text)
    if not isinstance(words, list):
        raise ValueError("its words are no list")
    return tuple(str(word) for word in words)


def _parse_numbers(record: Mapping[str, Any], kind: type) -> dict[str, float | None]:
    """Convert a JSON object to numeric fields of dataclass `kind`, null to None; an unknown field raises ValueError."""
    unknown = set(record) - {field.name for field in fields(kind)}
    if unknown:
        raise ValueError(f"{', '.join(sorted(unknown))} is not known here")
    return {name: None if value is None else float(value) for name, value in record.items()}


def _parse_appearance(record: dict[str, Any]) -> Appearance:
    colour = record.pop("base_color", None)
    if colour is not None:
        red, green, blue = (float(channel) for channel in colour)
        colour = (red, green, blue)
    return Appearance(colour, **_parse_numbers(record, Appearance))
