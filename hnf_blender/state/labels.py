"""Text and icons of the panels: plain functions of cached state, which draw nothing and look nothing up."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Sequence

from ..touch.bake_status import Freshness, StrokeStatus
from ..translations import tr
from .session_state import JobStatus, PlanLine, PlanView

CHARACTER_PX = 6.6
"""Mean character width of Blender's interface font at resolution scale 1 [px]."""
MARGIN_PX = 78
"""Width of a boxed label that holds no text: borders, icon, tabs [px]."""
ELLIPSIS = "…"
STATUS_LABELS = {
    Freshness.UNKNOWN: ("QUESTION", "Not Checked Yet"),
    Freshness.UNBAKED: ("RADIOBUT_OFF", "Not Baked Yet"),
    Freshness.FRESH: ("CHECKMARK", "Up to Date"),
    Freshness.FORCE: ("FORCE_FORCE", "Force Changed: Just Play"),
    Freshness.STALE: ("FILE_REFRESH", "Out of Date: Bake Again"),
    Freshness.BROKEN: ("ERROR", "Cannot Be Used"),
}
"""Icon and text of every freshness of a stroke's bake."""
PLAYABLE_STATES = (Freshness.FRESH, Freshness.FORCE)
"""Freshness of bakes that can be played."""
PLAN_LABELS = {
    "needed": ("FILE_REFRESH", "To Bake"),
    "fresh": ("CHECKMARK", "Up to Date"),
    "skipped": ("RADIOBUT_OFF", "Skipped"),
    "failed": ("ERROR", "Problems"),
    "note": ("INFO", "Notes"),
}
"""Icon and heading of every kind of plan line, in display order."""
RELIEF_PREFIX = "its relief"
"""Beginning of a part of a ranking reason that is about relief."""
ROUTE_LABELS = {
    "measured": "seen in the shader's relief",
    "measured from the mesh": "seen in the mesh's relief",
    "predicted": "estimated from the picture",
    "prior": "taken from the library",
    "learned": "learned from recordings",
}
"""Plain text of the routes of a band."""


def describe_status(status: StrokeStatus | None) -> tuple[str, str]:
    """Return icon and sentence of a stroke's status (whether its bake is valid); its own reason takes precedence."""
    freshness = Freshness.UNKNOWN if status is None else status.freshness
    icon, text = STATUS_LABELS[freshness]
    return icon, tr(status.why if status is not None and status.why else text)


def describe_freshness(status: StrokeStatus | None) -> tuple[str, str]:
    """Return icon and short text of a stroke's status, for one line; the reason is in the details."""
    icon, text = STATUS_LABELS[Freshness.UNKNOWN if status is None else status.freshness]
    return icon, tr(text)


def find_first_step(strokes: int, playable: int, is_done: bool) -> str:
    """Return the current step from an empty scene to the first sound; "" once a stroke was heard."""
    if is_done:
        return ""
    if playable:
        return tr("3 of 3: Play It")
    return tr("2 of 3: Bake It") if strokes else tr("1 of 3: Draw a Stroke")


def format_counts(statuses: Iterable[StrokeStatus | None]) -> str:
    """Format the statuses of strokes as "2 up to date, 1 to bake"; "" for none."""
    freshness = [Freshness.UNKNOWN if status is None else status.freshness for status in statuses]
    counts = [
        (tr("{count} Up to Date"), sum(state in PLAYABLE_STATES for state in freshness)),
        (tr("{count} to Bake"), sum(state in (Freshness.UNBAKED, Freshness.STALE) for state in freshness)),
        (tr("{count} Not Checked"), freshness.count(Freshness.UNKNOWN)),
        (tr("{count} Broken"), freshness.count(Freshness.BROKEN)),
    ]
    return ", ".join(text.format(count=count) for text, count in counts if count)


def format_duration(seconds: float) -> str:
    """Format a duration [s] as "under 1 s", "12 s", "3 min 20 s" or "1 h 5 min"."""
    if seconds < 1.0:
        return tr("under 1 s")
    total = round(seconds)
    if total < 60:
        return f"{total} s"
    if total < 3600:
        minutes, remainder = divmod(total, 60)
        return f"{minutes} min {remainder} s" if remainder else f"{minutes} min"
    hours, remainder = divmod(round(total / 60), 60)
    return f"{hours} h {remainder} min" if remainder else f"{hours} h"


def format_bytes(count: int) -> str:
    """Format a size [bytes] in decimal units: 1234 → "1.2 kB"."""
    if count < 1000:
        return f"{count} B"
    value, units = count / 1e3, ["kB", "MB", "GB", "TB"]
    while value >= 999.5 and len(units) > 1:
        value, units = value / 1e3, units[1:]
    return f"{value:.2g} {units[0]}" if value < 10.0 else f"{value:.0f} {units[0]}"


def format_job(job: JobStatus) -> str:
    """Format stage and stroke of the running job: "Stroke 3, close-ups: 3 of 11".

    The last step saves the results and is not counted as a stroke.
    """
    stage, strokes = job.stage, job.total - 1
    if strokes < 1:
        return stage[:1].upper() + stage[1:]
    return f"{stage}: {tr('{done} of {total}').format(done=min(job.done + 1, strokes), total=strokes)}"


def format_time_left(job: JobStatus) -> str:
    if job.left_s is None:
        return tr("{time} so far").format(time=format_duration(job.elapsed_s))
    return tr("{time} left").format(time=format_duration(job.left_s))


def compute_progress(job: JobStatus) -> float:
    """Return the progress of a job, 0 to 1."""
    return min(max(job.done / job.total, 0.0), 1.0) if job.total else 0.0


def format_estimate(plan: PlanView) -> str:
    """Format the estimated time and size of a planned bake; "" if nothing is needed."""
    if not any(line.kind == "needed" for line in plan.lines):
        return ""
    return tr("Takes {time}; keeps {size} in the .blend").format(
        time=format_duration(plan.seconds), size=format_bytes(plan.bytes_after)
    )


def group_plan_lines(plan: PlanView) -> tuple[tuple[str, str, tuple[PlanLine, ...]], ...]:
    """Return icon, heading with count, and lines for every kind of line (needed, fresh, …) in the plan of a bake."""
    groups = []
    for kind, (icon, heading) in PLAN_LABELS.items():
        lines = tuple(line for line in plan.lines if line.kind == kind)
        if lines:
            groups.append((icon, f"{tr(heading)}: {len(lines)}", lines))
    return tuple(groups)


def format_routes(routes: str) -> tuple[str, ...]:
    """Format "8–2 mm measured, 1–0.125 mm prior" as one line per wavelength band, in the user's words."""
    lines = []
    for band in filter(None, routes.split(", ")):
        match = re.fullmatch(r"(.*? mm) (.+)", band)
        if match is None or match[2] not in ROUTE_LABELS:
            lines.append(band)
        else:
            lines.append(f"{match[1]}: {tr(ROUTE_LABELS[match[2]])}")
    return tuple(lines)


def format_reason(reason: str) -> str:
    """Format the reason of a material's rank, e.g. "'oak' in 'Old oak table'; roughness 0.60 fits".

    The example becomes "the name says oak; roughness 0.60 fits".
    """
    from hnf_core.material.name_matching import is_image_name  # Imported here, since it compiles patterns.

    matches = re.findall(r"'([^']+)' in '([^']*)'", reason)
    from_names = ", ".join(match for match, name in matches if not is_image_name(name))
    from_images = ", ".join(match for match, name in matches if is_image_name(name))
    clauses = reason.split("; ")
    values = [
        clause
        for clause in clauses
        if clause.endswith((" fits", " does not fit")) and not clause.startswith(RELIEF_PREFIX)
    ]
    phrases = [tr("the name says {words}").format(words=from_names)] if from_names else []
    phrases += [tr("a picture's name says {words}").format(words=from_images)] if from_images else []
    likeness = [_format_likeness(clause) for clause in clauses if clause.startswith(f"{RELIEF_PREFIX} is like ")]
    joined = "; ".join(phrases + values + likeness)
    if joined and any(clause.startswith(RELIEF_PREFIX) and clause.endswith(" does not fit") for clause in clauses):
        return tr("{reasons}, though its relief does not fit").format(reasons=joined)
    return joined or tr(reason)


def format_height(metres: float) -> str:
    """Format a height [m] as "850 nm", "12 µm" or "0.35 mm"."""
    for unit, scale in (("nm", 1e9), ("µm", 1e6), ("mm", 1e3)):
        value = metres * scale
        if value < 999.5 or unit == "mm":
            return f"{value:.0f} {unit}" if value >= 99.5 else f"{value:.2g} {unit}"
    raise AssertionError("the last unit takes what is left")


def format_factor_range(value: float, factor: float, pattern: str) -> str:
    """Format the range that a factor spans: 0.3 with factor 1.2 → "0.25 – 0.36"."""
    return f"{pattern.format(value / factor)} – {pattern.format(value * factor)}"


def format_stiffness(newton_per_metre: float, factor: float) -> str:
    """Format a stiffness [N/m] in N/mm: "Stiffness: about 60 N/mm (45 – 80)"."""
    value = newton_per_metre / 1e3
    return tr("Stiffness: about {value} N/mm ({range})").format(
        value=f"{value:.3g}", range=format_factor_range(value, factor, "{:.2g}")
    )


def _format_likeness(reason: str) -> str:
    """Translate a reason of the form "its relief is like denim's"."""
    return tr("its relief is like {name}").format(
        name=reason.removeprefix(f"{RELIEF_PREFIX} is like ").removesuffix("'s")
    )


def format_confidence(confidence: float) -> str:
    """Format a confidence: 0.64 → "64 % sure"."""
    return tr("{percent} % sure").format(percent=round(100.0 * confidence))


def shorten_text(text: str, max_characters: int) -> str:
    """Shorten text to `max_characters` by cutting its end, as Blender does."""
    if len(text) <= max_characters:
        return text
    return text[: max(max_characters - len(ELLIPSIS), 1)] + ELLIPSIS


def put_surface_first(stroke: str, surface: str) -> str:
    """Return a stroke's name for the list, its surface first: "Left right on Cushion" → "Cushion: Left right".

    All surfaces of a stroke across several: "Stroke across Cup, Table" → "Cup, Table: Stroke". A name that does not
    mention the surface stays as it is.
    """
    before, found, after = stroke.partition(f" on {surface}")
    if surface and found and before:
        return f"{surface}: {before}{after}"
    before, _, after = stroke.partition(" across ")
    return f"{after}: {before}" if surface and before and surface in after.split(", ") else stroke


def wrap_text(text: str, max_characters: int) -> Sequence[str]:
    """Wrap text to lines of at most `max_characters`; a longer word (a path) is broken."""
    lines = [
        line
        for paragraph in text.splitlines()
        for line in textwrap.wrap(paragraph, max(max_characters, 8), break_on_hyphens=False) or [""]
    ]
    return lines or [""]
