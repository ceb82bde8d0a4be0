"""docs/shared-field.md from what tools/evaluate_shared_field.py has measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.field.config import FieldConfig
from hnf_core.training.recipe import SHARED_CONFIG
from hnf_core.training.references import PATCHES, SECONDS, STARTS
from hnf_core.training.shared_bars import bootstrap_mean, make_single_material_config

GAP_TARGETS_DB = (0.5, 1.5, 0.2)
RATIO_TARGET_DB = 1.0
ANISOTROPIC_DB = 6.0
MARGIN_TARGET_DB = 1.0


TESTED_SECTION = """## A field, not a noise table

On the shipped weights, in `tests/core/test_shared_field.py`: another material's token under the same mechanics, no
density σ, and one component of d reversed on a twill each change the spectrum by more than 1 dB; d and −d are the same,
mirrored strokes on isotropic surfaces nearly so. The tone of a described grating follows v/λ within 2 % from 30 to
250 mm/s, for pitches of 0.5, 1 and 2 mm."""


def format_page(
    context: Any, results: dict[str, dict[str, Any]], hidden: int, size: Callable[[FieldConfig], int]
) -> str:
    names = context.gathered.names
    parts = [_format_head(context), _format_gap(results["own"], context, hidden), _format_long(results["long"], results["own"], names),
             _format_storage(results["own"], context, hidden),
             _format_curve(results["curve"], results["own"], context, size), _format_direction(results["direction"]),
             _format_unseen(results["unseen"])]  # fmt: skip
    return "\n\n".join([*parts, TESTED_SECTION])


def _format_head(context: Any) -> str:
    plan, gathered, references = context.plan, context.gathered, context.references
    seconds = PATCHES * STARTS * SECONDS
    per = len(gathered.only(gathered.material_of_strokes() == 0).strokes)
    return f"""# The shared field

One field for {len(gathered.names)} materials of {len(set(gathered.classes))} classes: every library material and
{plan.sizes.instances} more instance of every class, {plan.sizes.patches} patches each, {per} steady strokes of \
{plan.sizes.seconds:g} s per material
({per * plan.sizes.seconds:.0f} s), and {plan.sizes.random} surfaces of no material. Seed {context.seed}. Written by

    python tools/train_default_field.py && python tools/evaluate_shared_field.py > docs/shared-field.md

*Distance* is the average-spectrum distance: RMS over 10 Hz bins in 10–1000 Hz within 30 dB of the reference's peak.
*References* are long runs of the simulator, {seconds:.0f} s per condition ({PATCHES} patches never trained on, \
{STARTS} places each), under
{len(references.conditions)} conditions (50–200 mm/s, 0.5–2 N, six directions; pen, the material's own mechanics, \
known to the field). They
scatter by {float(np.median(references.scatter_db)):.2f} dB per bin themselves (median; worst \
{float(references.scatter_db.max()):.2f} dB), which is inside every distance below. Tokens
are those of the references' patches unless training tokens are named. A distance is the mean over conditions and
patches."""


def _format_gap(single: dict[str, Any], context: Any, hidden: int) -> str:
    alone, shared, seen = (np.array(single[key]) for key in ("own", "shared", "seen"))
    new_gap, seen_gap = shared - alone, seen - alone
    names = context.gathered.names
    worst = np.argsort(-new_gap)[:5]
    rows = [
        ("field of its own", alone, None),
        ("shared, tokens of new patches", shared, new_gap),
        ("shared, training tokens", seen, seen_gap),
    ]
    lines = [
        f"| {label} | {np.median(d):.2f} | {np.percentile(d, 90):.2f} | {d.max():.2f} | "
        + ("– | – |" if gap is None else f"{np.median(gap):+.2f} | {gap.max():+.2f} |")
        for label, d, gap in rows
    ]
    widest = ", ".join(f"{names[m]} {new_gap[m]:+.2f} (own {alone[m]:.2f}, shared {shared[m]:.2f})" for m in worst)
    over = int(np.sum(new_gap > GAP_TARGETS_DB[1]))
    return f"""## Beside per-material fields

A per-material field has the same carriers and linear contact, two layers of {hidden}, and the strokes of its material
alone ({len(alone)} fields, the same seconds per material as the shared one).

| field | median dB | 90 % | worst | median gap | worst gap |
|---|---|---|---|---|---|
{chr(10).join(lines)}

Bars: median gap ≤ {GAP_TARGETS_DB[0]} dB: **{_format_result(np.median(new_gap) <= GAP_TARGETS_DB[0])}**; worst ≤ {GAP_TARGETS_DB[1]} dB: \
**{_format_result(over == 0)}**{f" ({over} above)" if over else ""}; with training tokens, median ≤ {GAP_TARGETS_DB[2]} dB: \
**{_format_result(np.median(seen_gap) <= GAP_TARGETS_DB[2])}**.
Where the gap is widest: {widest}.
Farthest off in absolute terms: {", ".join(f"{names[m]} {shared[m]:.2f}" for m in np.argsort(-shared)[:5])}."""


def _format_long(long: dict[str, Any], single: dict[str, Any], names: Sequence[str]) -> str:
    some, alone = np.array(long["some"]), np.array(long["own"])
    shared, same = (np.array(single[key])[some] for key in ("shared", "own"))
    gap = shared - alone
    fair, hard = slice(0, len(some) - long["hard"]), slice(len(some) - long["hard"], None)
    each = ", ".join(
        f"{names[m]} {g:+.2f} (own {a:.2f}, shared {s:.2f})"
        for m, g, a, s in zip(some[hard], gap[hard], alone[hard], shared[hard], strict=True)
    )
    return f"""### From {long["seconds"]:.0f} s each

As much as one material may be given, all under its own mechanics. On every {some[1] - some[0]}th material \
({len(alone[fair])}): own fields come to a median of
{np.median(alone[fair]):.2f} dB, worst {alone[fair].max():.2f} (from the shared field's seconds \
{np.median(same[fair]):.2f} and {same[fair].max():.2f}); the shared field to {np.median(shared[fair]):.2f} and \
{shared[fair].max():.2f}. Gap: median
{np.median(gap[fair]):+.2f} dB (**{_format_result(np.median(gap[fair]) <= GAP_TARGETS_DB[0])}**), worst {gap[fair].max():+.2f} dB \
(**{_format_result(gap[fair].max() <= GAP_TARGETS_DB[1])}**). On the {long["hard"]} others from which the shared field is farthest:
{each}. Worst: **{_format_result(gap.max() <= GAP_TARGETS_DB[1])}**."""


def _format_storage(single: dict[str, Any], context: Any, hidden: int) -> str:
    some = single["some"]
    shared = np.array(single["shared"])[some]
    table = {
        **{int(key): np.array(value) for key, value in single["smaller"].items()},
        hidden: np.array(single["own"])[some],
    }
    count, file = len(context.gathered.names), Path(context.weights).stat().st_size
    rows = [
        f"| {count} × own, 2 × {width} | {np.median(values):.2f} | {values.max():.2f} | "
        f"{count * single['bytes'][str(width)] / 1e6:.2f} MB |"
        for width, values in sorted(table.items())
    ]
    return f"""## Storage

On every {some[1] - some[0]}th material ({len(some)}):

| fields | median dB | worst | storage of all {count} |
|---|---|---|---|
{chr(10).join(rows)}
| one shared | {np.median(shared):.2f} | {shared.max():.2f} | {file / 1e6:.2f} MB |"""


def _format_curve(
    curve: dict[str, Any], single: dict[str, Any], context: Any, size: Callable[[FieldConfig], int]
) -> str:
    shared, alone = np.array(single["shared"]), np.array(single["own"])
    rows = [f"| 1 each | {np.median(alone):.2f} | {alone.max():.2f} | – | "
            f"{len(alone) * size(make_single_material_config(64)) / 1e6:.2f} MB for all |"]  # fmt: skip
    for point in curve["points"]:
        kept, distance = point["materials"], np.array(point["distance"])
        rows.append(
            f"| {len(kept)} | {np.median(distance):.2f} | {distance.max():.2f} | "
            f"{np.median(shared[kept] - distance):+.2f} | {size(SHARED_CONFIG) / 1e6:.2f} MB |"
        )
    rows.append(
        f"| {len(shared)} (shipped) | {np.median(shared):.2f} | {shared.max():.2f} | 0 | {size(SHARED_CONFIG) / 1e6:.2f} MB |"
    )
    return f"""## Number of materials

The same network, schedule and surfaces of no material; fewer materials. The fourth column: what the shipped field loses
on those same materials (median).

| materials | median dB | worst | shipped − this, same materials | storage |
|---|---|---|---|---|
{chr(10).join(rows)}"""


def _format_direction(direction: dict[str, Any]) -> str:
    rows = direction["rows"]
    strong = [row for row in rows if row["anisotropy_db"] >= ANISOTROPIC_DB]
    met = {key: sum(row[key] <= RATIO_TARGET_DB for row in strong) for key in ("ratio_db", "third_db", "power_db")}
    lines = [
        f"| {row['name']} | {row['anisotropy_db']:.1f} | {row['field_anisotropy_db']:.1f} | {row['ratio_db']:.2f} | "
        f"{row['third_db']:.2f} | {row['power_db']:.2f} |"
        for row in rows
    ]
    middle = {key: float(np.median([row[key] for row in strong])) if strong else float("nan") for key in met}
    return f"""## Direction

Eight directions 22.5° apart over half a turn, from 11.25° on, at 100 mm/s and 1 N. Training drew directions at random
from the whole circle, so these lie between trained ones. *Ratio*: level of a direction's spectrum over that of the
loudest direction, field against simulator, RMS over the other seven: per 10 Hz bin, in third octaves, and of the whole
10–1000 Hz. One reference of a direction scatters by {direction["scatter"]:.2f} dB per bin, a ratio of two by \
{direction["scatter"] * np.sqrt(2.0):.2f} dB.

| material | anisotropy dB, simulator | field | ratio per bin dB | third octaves | power |
|---|---|---|---|---|---|
{chr(10).join(lines)}

{len(strong)} of these have ≥ {ANISOTROPIC_DB:.0f} dB of anisotropy. Within {RATIO_TARGET_DB:.0f} dB: \
{met["power_db"]} in power, {met["third_db"]} in third octaves, {met["ratio_db"]} per bin
(medians {middle["power_db"]:.2f}, {middle["third_db"]:.2f}, {middle["ratio_db"]:.2f} dB). Bar (per bin): \
**{_format_result(len(strong) >= 5 and met["ratio_db"] == len(strong))}**.

Surfaces of noise are close; lattices are not. A token keeps one tone per octave and how its power divides between a
direction and the one across it, so that a ribbed surface gets faint tones across its ribs, which the simulator's has
not (ribbed plastic), and a weave with two tones in one octave loses the weaker (silk, carbon fibre). The field turns
such tones up and down, but puts none where the token has none."""


def _format_unseen(unseen: dict[str, Any]) -> str:
    rows = unseen["rows"]
    by_class: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        by_class.setdefault(row["class_name"], []).append(row)
    lines, margins = [], {"category_db": [], "nearest_db": []}  # type: ignore[var-annotated]
    for name, members in by_class.items():
        mean = {key: float(np.mean([m[key] for m in members])) for key in ("field_db", "category_db", "nearest_db")}
        for key, found in margins.items():
            found.append(mean[key] - mean["field_db"])
        nearest = ", ".join(sorted({m["nearest"].partition("/")[0] for m in members}))
        lines.append(
            f"| {name} | {mean['field_db']:.2f} | {mean['category_db']:.2f} | {mean['nearest_db']:.2f} | {nearest} |"
        )
    told = {key: bootstrap_mean(np.array(values), 0) for key, values in margins.items()}
    return f"""## Classes never met

Not the shipped weights: a field trained by the same recipe without the last class of every category in the table \
({len(by_class)} classes, {len(rows)} materials;
the {len(unseen["seen"])} materials that it was trained on: median {np.median(unseen["seen"]):.2f} dB on new patches). \
The rivals are given the simulator's own long-run spectra, at the
same u, of every other material: *category mean* averages the log spectra of the category's other materials, *nearest*
takes the one nearest in token space.

| class | field dB | category mean | nearest | which |
|---|---|---|---|---|
{chr(10).join(lines)}

{_format_margin("category mean", told["category_db"])}
{_format_margin("nearest neighbour", told["nearest_db"])}"""


def _format_margin(name: str, interval: Sequence[float]) -> str:
    mean, low, high = interval
    return (
        f"Margin over {name}: {mean:.2f} dB, 95 % interval {low:.2f} … {high:.2f} (bootstrap over classes); "
        f"bar ≥ {MARGIN_TARGET_DB:.0f} dB, interval above 0: **{_format_result(mean >= MARGIN_TARGET_DB and low > 0.0)}**."
    )


def _format_result(true: bool) -> str:
    return "met" if true else "missed"
