"""What a stroke's signal follows from, as hashes apart from each other, so that what changed has a name."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields

from hnf_core.files import content_hash

TOUCH_FIELD, PATH_FIELD = "touch", "path"
CHANGE_DESCRIPTIONS = {
    "made_by": "the add-on, its library or its field",
    "scale": "the scene's unit scale",
    "shape": "the shape of the surface",
    "shading": "the materials of the surface",
    "sight": "the networks that estimate relief from pictures",
    "choices": "a material choice",
    PATH_FIELD: "path, timing or surface name",
    TOUCH_FIELD: "force, seed or probe",
}
PATH_ON_SAME_SURFACE = "path or timing"
"""What is left of PATH where the surface is called as it was."""


@dataclass(frozen=True)
class InputHashes:
    """Hashes of: made_by: software, library, field. scale: metres per unit. shape: the surface's geometry.
    shading: its shaders, their pixels, and the names that a material is guessed from. sight: the networks that read its
    pictures, "" where none is to be read. choices: library materials that the artist named. path: where the hand is and
    when, on which object. touch: force, seed, probe."""

    made_by: str
    scale: str
    shape: str
    shading: str
    sight: str
    choices: str
    path: str
    touch: str

    @property
    def key(self) -> str:
        """Equal keys, equal signals."""
        return content_hash(*(asdict(self)[field.name] for field in fields(self)))

    @property
    def path_key(self) -> str:
        """Of everything but force, seed and probe: while it is equal, the signal follows without a render."""
        return content_hash(*self._iter_without(TOUCH_FIELD))

    @property
    def surface_key(self) -> str:
        """Of everything that the tokens on the mesh follow from, whatever strokes led there."""
        return content_hash(*self._iter_without(TOUCH_FIELD, PATH_FIELD))

    def describe_changes(self, previous: InputHashes, *, same_surface: bool = False) -> tuple[str, ...]:
        """What differs from earlier, in words. same_surface: it is known that the surface is called as it was."""
        words = CHANGE_DESCRIPTIONS | {PATH_FIELD: PATH_ON_SAME_SURFACE} if same_surface else CHANGE_DESCRIPTIONS
        return tuple(word for name, word in words.items() if getattr(self, name) != getattr(previous, name))

    def to_text(self) -> str:
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_text(cls, text: object) -> InputHashes | None:
        """What to_text wrote; None for anything else."""
        try:
            record = json.loads(str(text))
            return cls(**{field.name: str(record[field.name]) for field in fields(cls)})
        except (ValueError, KeyError, TypeError):
            return None

    def _iter_without(self, *names: str) -> Iterator[str]:
        return (getattr(self, field.name) for field in fields(self) if field.name not in names)
