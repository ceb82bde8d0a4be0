"""Weights of fields F_Θ on disk, as safetensors with JSON metadata that is validated on reading.

Covers the shipped weights, files of the user, and the field of a single material, which is stored inside its `.hnf`
file.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import WeightsError
from ..files import write_bytes
from ..material.contact_model import LEARNED_MECHANICS, Mechanics, describe_limit_violation
from ..material.library import Appearance, LibraryMaterial
from ..material.token import ENCODER_ID, LARGEST_VALUE, TOKEN_DIM, Token, split_encoders
from ..safetensors_io import WeightsFile, WeightsKind, dump_tensors, parse_weights, read_weights
from .carriers import MODEL_RATE_HZ, TIME_BLOCK, Carriers, find_first_bins
from .field import Field, FieldConfig
from .training_ranges import SECTORS, PropertyRange, TrainingRanges

if TYPE_CHECKING:
    from ..material.hnf_file import MaterialFile

DEFAULT_WEIGHTS = Path(__file__).parent.parent / "data" / "field.safetensors"
HELD_OUT_WEIGHTS = DEFAULT_WEIGHTS.with_name("field-held-out.safetensors")
"""Weights trained without a class of every category (metadata held_out), for evaluation only."""
EVERY_ENCODER_WEIGHTS = DEFAULT_WEIGHTS.with_name("field-encoders.safetensors")
"""Weights trained on tokens of every encoder; a little worse than the default on those of the library's."""
FORMAT = "hnf-field-1"
MAX_OCTAVES, MAX_LAYERS = 16, 100
"""Largest accepted numbers of octaves and layers."""
MIN_WAVENUMBER_PER_M, MAX_WAVENUMBER_PER_M = 1e-3, 1e9
"""Accepted range of arc carriers [cycles/m]: waves of a kilometre to a nanometre."""
_TOKEN_LOW, _TOKEN_HIGH = "ranges.token_low", "ranges.token_high"
_KIND = WeightsKind(
    "weights", FORMAT, "these are not field weights", "Train it again with this version, or choose other weights."
)


def save_field(path: Path, field: Field) -> None:
    """Write a field atomically.

    Parameters
    ----------
    path
        Path of the weights.
    field
        The field; see serialise_field for what is written.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    write_bytes(path, serialise_field(field))


def serialise_field(field: Field) -> bytes:
    """Serialise parameters, ranges and metadata of a field; the bytes of a field that was read are the file's own.

    field.metadata (training data, seed, metrics, licence, all text) is preserved, with the encoders of the tokens it
    was trained on (the library's if none is named). Format, architecture and ranges are added.
    """
    tensors = {name: np.ascontiguousarray(value, dtype=np.float32) for name, value in field.parameters.items()}
    metadata = {
        "encoder": ENCODER_ID,
        **field.metadata,
        "format": FORMAT,
        "architecture": json.dumps(dataclasses.asdict(field.config), sort_keys=True),
    }
    if field.ranges is not None:
        tensors[_TOKEN_LOW], tensors[_TOKEN_HIGH] = field.ranges.token_low, field.ranges.token_high
        metadata["ranges"] = json.dumps(_serialise_ranges(field.ranges))
    return dump_tensors(tensors, metadata)


def read_encoders(metadata: Mapping[str, str]) -> tuple[str, ...]:
    """Return the encoders (image to material token) whose tokens a field was trained on.

    They are in metadata["encoder"]: a JSON list, or one name.
    """
    text = metadata.get("encoder", "")
    try:
        listed = json.loads(text)
    except ValueError:
        return (text,) if text else ()
    return tuple(str(name) for name in listed) if isinstance(listed, list) else (text,)


def check_encoders(field: Field, names: Iterable[str], where: str = "") -> None:
    """Raise WeightsError if the field was not trained on tokens of one of the encoders.

    A field without encoders in its metadata (made in memory) accepts the library's. where: source named in the message.
    """
    known = read_encoders(field.metadata) or (ENCODER_ID,)
    unknown = [name for name in names if name not in known]
    if unknown:
        raise WeightsError(
            f"trained on tokens of encoder {' and '.join(map(repr, known))}, but tokens here come from {unknown[0]!r}.",
            where=where,
            remedy="Choose an encoder that the field knows, or weights trained on this one's tokens.",
        )


def load_field(path: Path | str | None = None) -> Field:
    """Read field weights.

    Parameters
    ----------
    path
        Path of the weights; None for the shipped default, which is read once.

    Returns
    -------
    Field
        With its training ranges and metadata.

    Raises
    ------
    FileError
        If there is no file.
    WeightsError
        If it is damaged, of another format or architecture, not finite, or of another encoder.
    """
    return _load(DEFAULT_WEIGHTS) if path is None else _read_field(Path(path))


def parse_field(data: bytes, where: str) -> Field:
    """Parse the bytes of serialise_field. where: source named in messages. Raises WeightsError as load_field."""
    return _build_field(parse_weights(data, _KIND, where))


def load_field_for_encoders(encoders: Iterable[str]) -> Field:
    """Return the shipped field that can be used on material tokens from these encoders.

    The default field if it was trained on all of them, else the one that was trained on every encoder.

    Raises
    ------
    WeightsError
        If no shipped field was trained on one of them, or the field needed is missing, as in the Blender extension.
    """
    names = tuple(encoders)
    field = load_field()
    if all(name in read_encoders(field.metadata) for name in names):
        return field
    if not EVERY_ENCODER_WEIGHTS.is_file():
        raise WeightsError(
            "the field that knows every make of E is not part of the Blender extension.",
            where=str(EVERY_ENCODER_WEIGHTS),
            remedy=f"Choose {ENCODER_ID}, or use hnf outside Blender: pip install . in its source.",
        )
    field = load_field(EVERY_ENCODER_WEIGHTS)
    check_encoders(field, names, str(EVERY_ENCODER_WEIGHTS))
    return field


def read_trained_material(field: Field, where: str) -> LibraryMaterial:
    """Return the single material that weights were trained for, from metadata["material"].

    Parameters
    ----------
    field
        The field.
    where
        Source named in messages.

    Returns
    -------
    LibraryMaterial
        With name, mechanics and token.

    Raises
    ------
    WeightsError
        If the weights were trained for many materials, or name none.
    """
    try:
        record = json.loads(field.metadata["material"])
        token = np.asarray(record["token"], dtype=np.float32)
        if token.shape != (TOKEN_DIM,) or not (np.abs(token) <= LARGEST_VALUE).all():
            raise ValueError("its token is damaged")
        mechanics = Mechanics(**record.get("mechanics", {}))
        problem = describe_limit_violation(mechanics)
        if problem:
            raise ValueError(problem.rstrip("."))
        return LibraryMaterial(str(record["name"]), "", (), Appearance(), mechanics, token)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise WeightsError(
            f"these weights do not belong to one material ({error}).",
            where=where,
            remedy="Use --material NAME, or weights written by `hnf train field --material`.",
        ) from error


@lru_cache(maxsize=1)
def _load(path: Path) -> Field:
    """Read a field from a file, once per path."""
    return _read_field(path)


def _read_field(path: Path) -> Field:
    return _build_field(read_weights(path, _KIND))


def _build_field(file: WeightsFile) -> Field:
    """Validate a weights file and build its field."""
    if ENCODER_ID not in read_encoders(file.metadata):
        raise file.make_error(
            f"trained on tokens of encoder {file.metadata.get('encoder')!r}, but tokens here come from {ENCODER_ID!r}."
        )
    config = file.parse_metadata(lambda metadata: _parse_config(json.loads(metadata["architecture"])))
    ranges = file.parse_metadata(lambda metadata: _parse_ranges(metadata, file.tensors))
    bounds = {} if ranges is None else {_TOKEN_LOW: (TOKEN_DIM,), _TOKEN_HIGH: (TOKEN_DIM,)}
    tensors = file.check_parameters({**config.shapes(), **bounds}, np.float32)
    parameters = {name: value for name, value in tensors.items() if name not in bounds}
    return Field(config, parameters, ranges, file.metadata, file.content_id)


def _parse_config(record: Mapping[str, Any]) -> FieldConfig:
    """Build a field's architecture from its JSON record. Raises TypeError or ValueError if that is not valid."""
    carriers = dict(record["carriers"])
    carriers["time_edges_hz"] = tuple(float(edge) for edge in carriers["time_edges_hz"])
    # Types are checked first, because the constructors would fail with Python's own messages.
    _check_types(FieldConfig, record)
    _check_types(Carriers, carriers)
    config = FieldConfig(**{**record, "carriers": Carriers(**carriers)})
    _check_carriers(config.carriers)
    if config.accumulation not in ("past", "heads") or config.emission not in ("log", "linear"):
        raise ValueError(f"unknown accumulation {config.accumulation!r} or emission {config.emission!r}")
    if (
        min(config.hidden, config.layers, config.states) < 1
        or config.layers > MAX_LAYERS
        or config.arc_knots not in (0, *range(2, 1000))
    ):
        raise ValueError(
            f"hidden, layers and states must be positive, layers {MAX_LAYERS} at most, arc_knots 0 or 2 up"
        )
    if not 0 <= config.action_octaves <= MAX_OCTAVES:
        raise ValueError(f"action_octaves must lie between 0 and {MAX_OCTAVES}")
    physical = config.physics and (config.emission, config.accumulation) == ("log", "past")
    if config.line_gains and not (physical and config.carriers.arc_count):
        raise ValueError("line gains need the linear contact, log emission, past states and arc carriers")
    if config.stroke_frame and not config.directed:
        raise ValueError("without directions there is no frame of the stroke")
    return config


_NUMBERS: dict[str, type | tuple[type, ...]] = {"int": int, "float": (int, float), "bool": bool}


def _check_types(made: type[FieldConfig | Carriers], record: Mapping[str, Any]) -> None:
    """Raise TypeError if a number in a JSON record has another type than that attribute of the dataclass `made`."""
    type_names = {item.name: str(item.type) for item in dataclasses.fields(made)}
    for name, value in record.items():
        type_name = type_names.get(name, "")
        if type_name in _NUMBERS and (
            not isinstance(value, _NUMBERS[type_name]) or isinstance(value, bool) != (type_name == "bool")
        ):
            raise TypeError(f"{name} is {value!r:.40}, not of kind {type_name}")


def _check_carriers(carriers: Carriers) -> None:
    """Raise ValueError if no noise can be drawn for the carriers."""
    edges = carriers.time_edges()
    if not ((edges > 0.0) & (edges <= MODEL_RATE_HZ)).all():
        raise ValueError(f"time_edges_hz leave 0 to {MODEL_RATE_HZ:g} Hz")
    find_first_bins(edges * (TIME_BLOCK / MODEL_RATE_HZ), TIME_BLOCK)
    if not 0 <= carriers.arc_octaves <= MAX_OCTAVES:
        raise ValueError(f"arc_octaves must lie between 0 and {MAX_OCTAVES}, not {carriers.arc_octaves}")
    start = carriers.arc_start_per_m
    if not (start >= MIN_WAVENUMBER_PER_M and start * 2.0**carriers.arc_octaves <= MAX_WAVENUMBER_PER_M):
        raise ValueError(
            f"arc carriers must lie between {MIN_WAVENUMBER_PER_M:g} and {MAX_WAVENUMBER_PER_M:g} cycles per meter"
        )


def _serialise_ranges(ranges: TrainingRanges) -> dict[str, Any]:
    """Return training ranges as JSON values, without the token's, which are stored as tensors."""
    record: dict[str, Any] = {"speed_m_s": ranges.speed, "force_n": ranges.force}
    if ranges.hull is not None:
        record["hull_m_s_n"] = ranges.hull.tolist()
    if ranges.sectors is not None:
        record["sectors"] = ranges.sectors
    if ranges.mechanics is not None:
        record["mechanics"] = {
            name: dataclasses.asdict(property_range) for name, property_range in ranges.mechanics.items()
        }
    if ranges.probes is not None:
        record["probes"] = ranges.probes
    return record


def _parse_ranges(metadata: Mapping[str, str], tensors: Mapping[str, NDArray[np.float32]]) -> TrainingRanges | None:
    """Return the training ranges of a file; entries that older files lack are None.

    Raises KeyError, TypeError or ValueError.
    """
    if "ranges" not in metadata:
        return None
    record = json.loads(metadata["ranges"])
    low, high = tensors[_TOKEN_LOW], tensors[_TOKEN_HIGH]
    if low.shape != (TOKEN_DIM,) or high.shape != (TOKEN_DIM,):
        raise ValueError("token ranges of the wrong length")
    hull, sectors, mechanics = record.get("hull_m_s_n"), record.get("sectors"), record.get("mechanics")
    probes = record.get("probes")
    if sectors is not None and (len(sectors) not in (0, SECTORS) or (sectors and not any(sectors))):
        raise ValueError(f"trained directions are not {SECTORS} sectors")
    return TrainingRanges(
        _parse_span(record["speed_m_s"]),
        _parse_span(record["force_n"]),
        low,
        high,
        hull=None if hull is None else _parse_hull(hull),
        sectors=None if sectors is None else tuple(bool(sector) for sector in sectors),
        mechanics=None
        if mechanics is None
        else {name: _parse_property_range(mechanics[name]) for name in LEARNED_MECHANICS},
        probes=None if probes is None else tuple(str(probe) for probe in probes),
    )


def _parse_hull(record: Any) -> NDArray[np.float64]:
    """Return the convex hull (k, 2) of trained (speed, force) pairs. Raises ValueError if it is not valid."""
    hull = np.asarray(record, dtype=np.float64)
    if hull.ndim != 2 or hull.shape[0] < 1 or hull.shape[1] != 2 or not (np.isfinite(hull) & (hull > 0.0)).all():
        raise ValueError("the region of speeds and forces is not a polygon of positive numbers")
    return hull


def _parse_property_range(record: Mapping[str, Any]) -> PropertyRange:
    """Return the trained range of a mechanical property from its JSON record."""
    return PropertyRange(
        None if record["span"] is None else _parse_span(record["span"], zero=True), bool(record["unknown"])
    )


def _parse_span(record: Any, *, zero: bool = False) -> tuple[float, float]:
    """Return a range (low, high). Raises ValueError unless 0 < low ≤ high; with `zero`, low may be 0."""
    low, high = (float(value) for value in record)
    if not 0.0 <= low <= high < float("inf") or (low == 0.0 and not zero):
        raise ValueError(f"{low:g} to {high:g} is not a range")
    return low, high


CACHED_FIELDS = 16
"""Parsed fields in the cache: those of the learned materials of a scene."""


def build_learned_material(weights: bytes, where: str) -> MaterialFile:
    """Build the material that weights were trained for, with the weights in it.

    Its token is marked as known if training knew one; otherwise library defaults describe it wherever the field is not
    used.

    Parameters
    ----------
    weights
        Bytes of serialise_field.
    where
        Source named in messages.

    Returns
    -------
    MaterialFile
        Content of a `.hnf` file.

    Raises
    ------
    WeightsError
        If the weights are damaged or of more than one material.
    """
    from ..material.hnf_file import MAX_NAME_BYTES, MaterialFile

    field = parse_field(weights, where)
    trained = read_trained_material(field, where)
    token = Token(trained.token, np.full(trained.token.shape, bool(trained.token.any())))
    name = "".join(character if character.isprintable() else " " for character in trained.name).strip() or "learned"
    while len(name.encode()) > MAX_NAME_BYTES:
        name = name[:-1]
    licence = field.metadata.get("licence", "")
    return MaterialFile(name, token, trained.mechanics, words=(name.lower(),), licence=licence, field=weights)


def load_material_field(material: MaterialFile) -> Field | None:
    """Return the field that a material contains, parsed once; None if it contains none.

    Raises WeightsError if it is damaged or of more than one material.
    """
    return _parse_material_field(material.field, material.name) if material.field else None


def resolve_material_field(material: MaterialFile, where: str) -> tuple[Field, LibraryMaterial]:
    """Return the field that synthesises a material, its own or a shipped one, and the material as that field knows it.

    where: source named in messages. Raises WeightsError as load_material_field and load_field_for_encoders.
    """
    from ..material.hnf_file import with_library_defaults

    field = load_material_field(material)
    if field is not None:
        return field, read_trained_material(field, where)
    return load_field_for_encoders(split_encoders(material.encoder)), with_library_defaults(material)


def read_material_file(path: Path) -> MaterialFile:
    """Read a material from a `.hnf` file, or from the `.safetensors` weights of a field trained for one material.

    Raises
    ------
    FileError
        If the file is missing or damaged.
    WeightsError
        If its field is damaged or of more than one material.
    MaterialError
        If the weights are larger than a material may be.
    """
    from ..material.hnf_file import HNF_SUFFIX, read_hnf

    if path.suffix.lower() == HNF_SUFFIX:
        material = read_hnf(path)
        load_material_field(material)
        return material
    return build_learned_material(serialise_field(load_field(path)), str(path))


@lru_cache(maxsize=CACHED_FIELDS)
def _parse_material_field(weights: bytes, name: str) -> Field:
    """Parse and check the field of a material, once per content."""
    where = f"material '{name}'"
    field = parse_field(weights, where)
    read_trained_material(field, where)
    return field
