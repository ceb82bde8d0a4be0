"""What panels say: plain functions from cached state to words and icons. Nothing here draws or looks anything up."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ..touch.freshness import Freshness, StrokeStatus
from ..translations import tr
from .session_state import JobStatus, PlanLine, PlanView

CHARACTER_PX = 6.6
"""Mean width of a character of Blender's interface font at resolution scale 1."""
MARGIN_PX = 78
"""What is no text in a line of a boxed label: borders, the icon, the column of tabs."""
ELLIPSIS = "…"
STATUS_LABELS = {
    Freshness.UNKNOWN: ("QUESTION", "Not checked yet"),
    Freshness.UNBAKED: ("RADIOBUT_OFF", "Not baked yet"),
    Freshness.FRESH: ("CHECKMARK", "Up to date"),
    Freshness.FORCE: ("FORCE_FORCE", "Force changed: no bake needed, just play"),
    Freshness.STALE: ("FILE_REFRESH", "Out of date: bake again"),
    Freshness.BROKEN: ("ERROR", "Cannot be used"),
}
"""Icon and words of every state of a stroke's bake."""
PLAYABLE_STATES = (Freshness.FRESH, Freshness.FORCE)
PLAN_LABELS = {
    "needed": ("FILE_REFRESH", "To bake"),
    "fresh": ("CHECKMARK", "Up to date"),
    "skipped": ("RADIOBUT_OFF", "Skipped"),
    "failed": ("ERROR", "Problems"),
    "note": ("INFO", "Notes"),
}
"""Icon and heading of every kind of plan line, in the order they are shown."""
RELIEF_PREFIX = "its relief"
"""How the part of a reason begins that speaks of a relief."""
ROUTE_LABELS = {
    "measured": "seen in the shader's relief",
    "predicted": "estimated from the picture",
    "prior": "taken from the library",
}


class FirstStep(NamedTuple):
    """One of the first steps. icon: done, current or still to come."""

    text: str
    icon: str
    current: bool


def describe_status(status: StrokeStatus | None) -> tuple[str, str]:
    """Icon and sentence of a stroke; a sentence of its own where the status brings one."""
    freshness = Freshness.UNKNOWN if status is None else status.freshness
    icon, text = STATUS_LABELS[freshness]
    return icon, tr(status.why if status is not None and status.why else text)


def list_first_steps(strokes: int, playable: int, has_played: bool) -> tuple[FirstStep, ...]:
    """The way from an empty scene to the first sound; empty once that was heard."""
    if playable and has_played:
        return ()
    at = 2 if playable else 1 if strokes else 0
    texts = (tr("1  Draw a stroke on a surface"), tr("2  Bake"), tr("3  Play"))
    icons = ("CHECKMARK", "TRIA_RIGHT", "BLANK1")
    return tuple(
        FirstStep(text, icons[0] if place < at else icons[1] if place == at else icons[2], place == at)
        for place, text in enumerate(texts)
    )


def format_counts(statuses: Iterable[StrokeStatus | None]) -> str:
    """ "2 up to date, 1 to bake" of the strokes given; "" of none."""
    found = [Freshness.UNKNOWN if status is None else status.freshness for status in statuses]
    parts = [
        (tr("{count} up to date"), sum(each in PLAYABLE_STATES for each in found)),
        (tr("{count} to bake"), sum(each in (Freshness.UNBAKED, Freshness.STALE) for each in found)),
        (tr("{count} not checked"), found.count(Freshness.UNKNOWN)),
        (tr("{count} broken"), found.count(Freshness.BROKEN)),
    ]
    return ", ".join(text.format(count=count) for text, count in parts if count)


def format_duration(seconds: float) -> str:
    """Rounded as people say it: "under 1 s", "12 s", "3 min 20 s", "1 h 5 min"."""
    if seconds < 1.0:
        return tr("under 1 s")
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        minutes, rest = divmod(whole, 60)
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, rest = divmod(round(whole / 60), 60)
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def format_bytes(count: int) -> str:
    """1234 → "1.2 kB"; decimal, as file managers write sizes."""
    if count < 1000:
        return f"{count} B"
    value, units = count / 1e3, ["kB", "MB", "GB", "TB"]
    while value >= 999.5 and len(units) > 1:
        value, units = value / 1e3, units[1:]
    return f"{value:.2g} {units[0]}" if value < 10.0 else f"{value:.0f} {units[0]}"


def format_job(job: JobStatus) -> str:
    """Stage and stroke of the running job: "Stroke 3, close-ups: 3 of 11". Its last step saves, and is no stroke."""
    stage, strokes = job.stage, job.total - 1
    if strokes < 1:
        return stage
    return f"{stage}: {tr('{done} of {total}').format(done=min(job.done + 1, strokes), total=strokes)}"


def format_time_left(job: JobStatus) -> str:
    if job.left_s is None:
        return tr("{time} so far").format(time=format_duration(job.elapsed_s))
    return tr("{time} left").format(time=format_duration(job.left_s))


def compute_progress(job: JobStatus) -> float:
    """0–1, for the progress bar."""
    return min(max(job.done / job.total, 0.0), 1.0) if job.total else 0.0


def format_estimate(plan: PlanView) -> str:
    """What the plan costs; "" where nothing is needed."""
    if not any(line.kind == "needed" for line in plan.lines):
        return ""
    return tr("Takes {time}; keeps {size} in the .blend").format(
        time=format_duration(plan.seconds), size=format_bytes(plan.bytes_after)
    )


def group_plan_lines(plan: PlanView) -> tuple[tuple[str, str, tuple[PlanLine, ...]], ...]:
    """Icon, heading with count, and lines of every kind that the plan holds."""
    groups = []
    for kind, (icon, heading) in PLAN_LABELS.items():
        lines = tuple(line for line in plan.lines if line.kind == kind)
        if lines:
            groups.append((icon, f"{tr(heading)}: {len(lines)}", lines))
    return tuple(groups)


def format_routes(routes: str) -> tuple[str, ...]:
    """ "8–2 mm measured, 1–0.125 mm prior" → one line a group, in words an artist knows."""
    lines = []
    for part in filter(None, routes.split(", ")):
        match = re.fullmatch(r"(.* mm) (\w+)", part)
        if match is None or match[2] not in ROUTE_LABELS:
            lines.append(part)
        else:
            lines.append(f"{match[1]}: {tr(ROUTE_LABELS[match[2]])}")
    return tuple(lines)


def format_reason(reason: str) -> str:
    """ "'oak' in 'Old oak table'; roughness 0.60 fits" → "the name says oak; roughness 0.60 fits"."""
    from hnf_core.material.name_matching import is_image_name  # here: switching on need not compile its patterns

    found = re.findall(r"'([^']+)' in '([^']*)'", reason)
    named = ", ".join(word for word, name in found if not is_image_name(name))
    pictured = ", ".join(word for word, name in found if is_image_name(name))
    parts = reason.split("; ")
    values = [
        part for part in parts if part.endswith((" fits", " does not fit")) and not part.startswith(RELIEF_PREFIX)
    ]
    said = [tr("the name says {words}").format(words=named)] if named else []
    said += [tr("a picture's name says {words}").format(words=pictured)] if pictured else []
    like = [_format_likeness(part) for part in parts if part.startswith(f"{RELIEF_PREFIX} is like ")]
    told = "; ".join(said + values + like)
    if told and any(part.startswith(RELIEF_PREFIX) and part.endswith(" does not fit") for part in parts):
        return tr("{reasons}, though its relief does not fit").format(reasons=told)
    return told or tr(reason)


def format_height(metres: float) -> str:
    """A roughness as people say it: "850 nm", "12 µm", "0.35 mm"."""
    for unit, scale in (("nm", 1e9), ("µm", 1e6), ("mm", 1e3)):
        value = metres * scale
        if value < 999.5 or unit == "mm":
            return f"{value:.0f} {unit}" if value >= 99.5 else f"{value:.2g} {unit}"
    raise AssertionError("the last unit takes what is left")


def format_factor_range(value: float, factor: float, pattern: str) -> str:
    """A spread as a span: 0.3 within a factor 1.2 → "0.25 – 0.36"."""
    return f"{pattern.format(value / factor)} – {pattern.format(value * factor)}"


def format_stiffness(newton_per_metre: float, factor: float) -> str:
    """In N/mm, as springs are sold: "Stiffness: about 60 N/mm (45 – 80)"."""
    value = newton_per_metre / 1e3
    return tr("Stiffness: about {value} N/mm ({range})").format(
        value=f"{value:.3g}", range=format_factor_range(value, factor, "{:.2g}")
    )


def _format_likeness(reason: str) -> str:
    """ "its relief is like denim's" in the interface's language."""
    return tr("its relief is like {name}").format(
        name=reason.removeprefix(f"{RELIEF_PREFIX} is like ").removesuffix("'s")
    )


def format_confidence(confidence: float) -> str:
    """0.64 → "64 % sure"."""
    return tr("{percent} % sure").format(percent=round(100.0 * confidence))


def shorten_text(text: str, max_characters: int) -> str:
    """text in at most `most` characters, its middle left out: both ends of a long name tell it from others."""
    if len(text) <= max_characters:
        return text
    keep = max(max_characters - len(ELLIPSIS), 2)
    return text[: (keep + 1) // 2] + ELLIPSIS + text[len(text) - keep // 2 :]


def wrap_text(text: str, max_characters: int) -> Sequence[str]:
    """Lines of at most `most` characters; a word longer than that (a path) is broken."""
    lines = [
        line
        for part in text.splitlines()
        for line in textwrap.wrap(part, max(max_characters, 8), break_on_hyphens=False) or [""]
    ]
    return lines or [""]
