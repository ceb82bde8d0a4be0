"""What this run needs, what is fresh, what is left out, and why: made before anything is rendered or cast."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

from hnf_core.counted import pluralize
from hnf_core.tactile.tactile_map import Route

from .earlier import RerunReason
from .options import add_option_hint
from .report import Failed, Skipped
from .view import MAX_STROKE_VIEWS

RENDERS_PER_CLOSEUP = 2
"""Renders of a close-up at most: see closeup.iter_closeups."""
PROCEDURAL_CLOSEUP_SECONDS, IMAGE_CLOSEUP_SECONDS = 0.7, 0.2
"""Of a close-up with all pixels, and of one that a first look nearly suffices for."""
PREDICTION_SECONDS, PLOT_SECONDS, SYNTHESIS_SECONDS = 0.1, 1.8, 0.4
"""Rough cost on two cores, for the estimate only."""
TYPICAL_PATH_M, PATCH_PITCH_M = 60e-3, 10e-3

RERUN_MESSAGES = {
    RerunReason.UNFINISHED: "The baked .blend is not there, or the earlier run did not finish it",
    RerunReason.CHANGED: "The scene's file has changed since",
    RerunReason.STROKES: "The earlier run had other strokes",
}


def estimate_max_patches(length_m: float) -> int:
    """Upper bound of the close-ups that a stroke of this length takes."""
    return int(length_m / PATCH_PITCH_M) + 1


@dataclass(frozen=True)
class SlotPlan:
    """How the relief of a slot will come to be known. material: the Blender material's name. seconds: of one close-up,
    roughly. unless: what, seen in the close-up, makes it prior after all; "" = nothing."""

    material: str
    route: Route
    why: str
    seconds: float = PROCEDURAL_CLOSEUP_SECONDS
    unless: str = ""


def estimate_closeup_seconds(slots: Iterable[SlotPlan]) -> float:
    """Of one close-up on any of these slots."""
    return max((slot.seconds for slot in slots), default=PROCEDURAL_CLOSEUP_SECONDS)


@dataclass(frozen=True)
class PlannedBake:
    """One stroke to be made. patches: upper bound of the close-ups it takes. why: what is not fresh. slots: what it may
    touch."""

    stroke: str
    object: str
    material: str
    patches: int
    why: str
    slots: tuple[SlotPlan, ...] = ()

    @property
    def predictions(self) -> int:
        """Upper bound of the patches whose relief is estimated from their picture."""
        return self.patches if any(slot.route is Route.PREDICTED for slot in self.slots) else 0


@dataclass(frozen=True)
class UpToDate:
    """One stroke whose signal is there and still true."""

    stroke: str
    object: str
    wav: str


@dataclass(frozen=True)
class PlannedQuery:
    """One place to be looked at. close_ups: 1, or 0 where the store knows the place. slot: how its relief will come to
    be known, None where its object has no slots."""

    name: str
    object: str
    material: str
    close_ups: int
    slot: SlotPlan | None = None

    @property
    def predictions(self) -> int:
        """Upper bound, as of a stroke."""
        return int(self.slot is not None and self.slot.route is Route.PREDICTED)


@dataclass(frozen=True)
class Plan:
    """pictures: upper bound of those that fresh strokes get anew. again: why the .blend of an earlier run, which has
    fresh ones, is written anew."""

    needed: tuple[PlannedBake, ...]
    fresh: tuple[UpToDate, ...]
    skipped: tuple[Skipped, ...]
    failed: tuple[Failed, ...]
    notes: tuple[str, ...]
    probes: tuple[PlannedQuery, ...] = ()
    pictures: int = 0
    again: RerunReason = RerunReason.NOTHING

    @property
    def renders(self) -> int:
        """Upper bound: a close-up a patch, and one a probe, in two looks at most; for the pictures one view by the
        scene's camera, and each stroke's own past what stands before it."""
        drawn = len(self.needed) + self.pictures
        return RENDERS_PER_CLOSEUP * self.close_ups + MAX_STROKE_VIEWS * drawn + min(1, drawn)

    @property
    def close_ups(self) -> int:
        """Upper bound."""
        return sum(entry.patches for entry in self.needed) + sum(entry.close_ups for entry in self.probes)

    @property
    def predictions(self) -> int:
        """Upper bound: one a patch."""
        return sum(entry.predictions for entry in self.needed) + sum(entry.predictions for entry in self.probes)

    @property
    def seconds(self) -> float:
        stroke = PLOT_SECONDS + SYNTHESIS_SECONDS
        looks = sum(entry.patches * estimate_closeup_seconds(entry.slots) for entry in self.needed)
        looks += sum(
            each.close_ups * estimate_closeup_seconds(() if each.slot is None else (each.slot,)) for each in self.probes
        )
        strokes = len(self.needed) * stroke + self.pictures * PLOT_SECONDS
        return looks + self.predictions * PREDICTION_SECONDS + strokes

    def as_json(self) -> str:
        estimate = {
            "renders_at_most": self.renders,
            "predictions_at_most": self.predictions,
            "seconds": round(self.seconds, 1),
        }
        record = {**asdict(self), "estimate": estimate}
        return json.dumps(record, indent=1, ensure_ascii=False)

    def _format_cost(self) -> str:
        """Upper bounds, in what the lines above count."""
        parts = [pluralize(self.close_ups, "close-up"), pluralize(len(self.needed) + self.pictures, "picture")]
        if self.predictions:
            parts.append(f"{pluralize(self.predictions, 'relief')} estimated from pictures")
        return f"at most {', '.join(parts[:-1])} and {parts[-1]}, about {self.seconds:.0f} s"

    def _format_plot_count(self) -> str:
        if not self.pictures:
            return ""
        return f", and at most {pluralize(self.pictures, 'picture')}, where what it shows is not what it showed"

    def as_text(self) -> str:
        lines = []
        if self.needed:
            lines.append("To bake:")
            for entry in self.needed:
                lines.append(
                    f"  {entry.stroke}: on {entry.object}, {entry.material or 'no material'}; "
                    f"at most {pluralize(entry.patches, 'close-up')} ({entry.why})"
                )
                lines += [_format_route(slot, entry.predictions) for slot in entry.slots]
            lines.append(f"  In all {self._format_cost()}.")
        if self.probes:
            lines.append("Probes:")
            for probe in self.probes:
                cost = "1 close-up" if probe.close_ups else "examined before, nothing to render"
                lines.append(f"  {probe.name}: on {probe.object}, {probe.material or 'no material'}; {cost}")
                lines += [_format_route(probe.slot, probe.predictions)] if probe.slot is not None else []
        lines += ["Up to date:", *(f"  {entry.stroke}: {entry.wav}" for entry in self.fresh)] if self.fresh else []
        if self.again:
            lines.append(
                f"  {RERUN_MESSAGES[self.again]}: the baked .blend is written anew{self._format_plot_count()}."
            )
        lines += ["Skipped:", *_format_skipped(self.skipped)] if self.skipped else []
        lines += ["Problems:", *(f"  {entry.why}" for entry in self.failed)] if self.failed else []
        lines += ["Notes:", *(f"  {add_option_hint(note)}" for note in self.notes)] if self.notes else []
        return "\n".join(lines) or "Nothing to do."


def _format_route(slot: SlotPlan, predictions: int) -> str:
    said = ""
    if slot.route is Route.PREDICTED:
        said = f", at most {pluralize(predictions, 'close-up')}, {predictions * PREDICTION_SECONDS:.1f} s"
    unless = f"; prior if {slot.unless}" if slot.unless else ""
    return f"    {slot.material or 'no material'}: {slot.route.value} ({slot.why}{unless}){said}"


def _format_skipped(skipped: Sequence[Skipped]) -> list[str]:
    return [f"  {entry.what}: {entry.why}" for entry in skipped]
