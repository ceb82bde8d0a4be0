"""A relief as evidence of a material: how well the token of a map fits the library's tokens, whichever way it lies.

Compared are what no turn of the surface changes: of each band its level, the strengths of two- and four-fold
direction, peak and offset; skewness and kurtosis. Under a material they scatter as pieces of one class do
(WITHIN, measured on generated instances by tools/hnf_lab/experiments/suggestions.py), all levels also together by
SCALE, since
artists give a relief any height they like. Against that stands any relief at all: normal around the library's mean.

The prior route: from shading values and names to a ranked list of library materials.

Naive Bayes over the library. Prior: how common a category is in scenes, within it from the usual to the special.
Words (naming.py): a word that names a material makes it WORD_ODDS times likelier, less where the word belongs to
several categories or stands in a less telling name. Shading values: truncated normals around the library's typical
value, mixed with a uniform one (artists do as they like) and tempered (values hang together). Relief (relief.py): how
well the token of a tactile map fits. The confidence of a suggestion is its expected aptness: 1 where it is right, ALIKE
where another material of its category is.

What a ranking of materials says of mechanics, which no picture shows: a mean over the library, with its spread.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .fuse import BAND_COUNT, find_known_bands, find_significant_bands
from .library import Appearance, LibraryMaterial
from .name_matching import match_names
from .token import BAND_FEATURES, SHAPE_FEATURES, TOKEN_DIM, Token

Float = NDArray[np.float64]

INVARIANT_KINDS = ("level", "two_fold", "four_fold", "peak", "offset")
WITHIN_CLASS_SPREAD = {
    "level": 0.105, "two_fold": 0.104, "four_fold": 0.096, "peak": 0.114, "offset": 0.189, "skewness": 0.205,
    "log_kurtosis": 0.072,
}  # fmt: skip
"""Standard deviations between pieces of one class, in the units of a token."""
RELIEF_SCALE_DECADES = 0.3
"""Standard deviation of the decades by which an artist's relief is higher or lower than the real one (a factor 2)."""
ROUTE_SPREAD_FACTORS = {Route.MEASURED: 1.0, Route.PREDICTED: 2.0}
"""By what the scatter grows with how the map came to be known: a network's guess lies further off. A judgement."""
RELIEF_DOUBT = 0.1
"""How often a relief is not the material's own: dents, letters, a bump made for looks. Generated pieces always wear
their own and are fitted best by the least doubt tried (0.05); artists do as they like."""
BORROWED_RELIEF_SHARE = 0.05
"""How often something else wears a material's relief: wood printed on foil, embossed leatherette. It bounds what a
relief can say for a material to 14 : 1, so that a name, which the artist gave, goes before it. A judgement: generated
pieces never borrow."""
RELIEF_TEMPER = 0.15
"""Exponent of the likelihood: the features of a token hang together, and are not 37 independent witnesses. Of ten from
0 to 1, the one under which the right class of generated pieces is likeliest."""


def relief_log_odds(library: Sequence[LibraryMaterial], token: Token | None, route: Route = Route.MEASURED) -> Float:
    """(len(library),) log of how much likelier the token is under each material than under any relief; 0 where
    nothing is known. Bands that fuse.fuse would leave to the prior say nothing, nor does a token of the prior route.

    Raises MaterialError on a token of the wrong size.
    """
    none = np.zeros(len(library))
    if token is None or route is Route.PRIOR:
        return none
    if token.values.shape != (TOKEN_DIM,):
        raise MaterialError(f"a token holds {TOKEN_DIM} values, not {token.values.shape}.")
    bands = np.array(find_significant_bands(token) if route is Route.MEASURED else find_known_bands(token))
    if not bands.any():
        return none
    shape = bool(token.known[-len(SHAPE_FEATURES) :].all())
    seen = compute_invariants(token.values[None])[0]
    typical = compute_invariants(np.stack([material.token for material in library]))
    chosen = np.concatenate([np.tile(bands, len(INVARIANT_KINDS)), np.full(len(SHAPE_FEATURES), shape)])
    within = _get_within_class_spread() * ROUTE_SPREAD_FACTORS[route]
    spread = np.sqrt(typical.var(axis=0) + within**2)
    is_level = chosen & (np.arange(len(chosen)) < BAND_COUNT)
    others = chosen & ~is_level
    log_material = _log_level_density(seen[is_level] - typical[:, is_level], within[is_level])
    log_any = _log_level_density((seen - typical.mean(axis=0))[None, is_level], spread[is_level])
    log_material = log_material + _log_normal_density(seen[others] - typical[:, others], within[others])
    log_any = log_any + _log_normal_density((seen - typical.mean(axis=0))[None, others], spread[others])
    ratio = np.exp(np.minimum(RELIEF_TEMPER * (log_material - log_any), 300.0))
    return np.asarray(
        np.log((1.0 - RELIEF_DOUBT) * ratio + RELIEF_DOUBT)
        - np.log(1.0 - BORROWED_RELIEF_SHARE + BORROWED_RELIEF_SHARE * ratio)
    )


def compute_invariants(tokens: NDArray[np.float32]) -> Float:
    """(n, TOKEN_DIM) → (n, BANDS · 5 + 2): all bands' levels, then two-fold strengths, and so on in the order of KINDS;
    then skewness and log kurtosis. Equal for a surface however it is turned."""
    values = np.asarray(tokens, dtype=np.float64)
    bands = values[:, : BAND_COUNT * len(BAND_FEATURES)].reshape(-1, BAND_COUNT, len(BAND_FEATURES))
    named = {name: bands[:, :, place] for place, name in enumerate(BAND_FEATURES)}
    return np.concatenate(
        [
            named["level"],
            np.hypot(named["cos2"], named["sin2"]),
            np.hypot(named["cos4"], named["sin4"]),
            named["peak"],
            named["offset"],
            values[:, -len(SHAPE_FEATURES) :],
        ],
        axis=1,
    )


def _get_within_class_spread() -> Float:
    """(BANDS · 5 + 2,) WITHIN in the order of invariants."""
    return np.concatenate(
        [
            np.repeat([WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS], BAND_COUNT),
            [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES],
        ]
    )


def _log_normal_density(residual: Float, spread: Float) -> Float:
    return np.asarray(-0.5 * np.sum((residual / spread) ** 2, axis=1) - np.sum(np.log(spread)))


def _log_level_density(residual: Float, spread: Float) -> Float:
    """Log density (up to a constant) of levels that scatter each by spread and all together by SCALE: a normal of
    covariance diag(spread²) + SCALE² 11ᵀ (Sherman & Morrison 1950)."""
    weight = 1.0 / spread**2
    together = RELIEF_SCALE_DECADES**2 / (1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    square = np.sum(weight * residual**2, axis=1) - together * np.sum(weight * residual, axis=1) ** 2
    return np.asarray(
        -0.5 * square - np.sum(np.log(spread)) - 0.5 * np.log(1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    )


WORD_ODDS = 300.0
CATEGORY_FREQUENCY = {"plastic": 1.6, "wood": 1.3, "metal": 1.3, "fabric": 1.3, "carpet": 0.7, "foam": 0.5}
"""How often scenes hold a category, against the others' 1: all that is left where nothing else tells."""
DEFAULT_GREY, DEFAULT_ROUGHNESS = 0.8, 0.5
"""Of a new Principled BSDF."""
APPEARANCE_TEMPER = 0.6
UNIFORM_FLOOR = 0.03
SAME_CATEGORY_APTNESS = 0.85
NO_EVIDENCE = "no clue in the scene"
MAX_REASON_WORDS = 3
MIN_RELIEF_LOG_ODDS = 0.4
"""Log odds of a relief from which it is a reason."""
APPEARANCE_SPREAD = {"roughness": 0.18, "metallic": 0.12, "sheen": 0.25, "transmission": 0.2}
APPEARANCE_DOUBT = {"roughness": 0.2, "metallic": 0.1, "sheen": 0.2, "transmission": 0.1}
"""Share of the uniform part: how often a value says nothing."""
COLOR_SPREAD = {
    "wood": (0.2, 0.06),
    "metal": (0.2, 0.06),
    "stone": (0.2, 0.06),
    "paper": (0.2, 0.08),
    "rubber": (0.15, 0.08),
    "leather": (0.25, 0.1),
    "tile": (0.25, 0.1),
    "glass": (0.3, 0.1),
}
"""Of lightness and of chroma, in cube roots of linear values."""
DEFAULT_COLOR_SPREAD = (0.35, 0.2)
"""Of everything that is dyed or painted at will."""
OVERALL_CHROMA_SPREAD = 0.25
"""Chroma spread of all materials together, which a material's own is held against."""
COLOR_DOUBT = 0.3


@dataclass(frozen=True)
class Suggestion:
    """name: of a library material. confidence: 0–1. reason: for the report, one line. probability: 0–1, that it is this
    very material and no other of the library; all of a ranking sum to 1."""

    name: str
    confidence: float
    reason: str
    probability: float


def rank(
    library: Sequence[LibraryMaterial],
    appearance: Appearance,
    names: Sequence[str],
    *,
    image_names: Sequence[str] = (),
    token: Token | None = None,
    route: Route = Route.MEASURED,
) -> tuple[Suggestion, ...]:
    """All library materials, the most apt first.

    appearance: shading values, None = not known (says nothing). names: the material's name first ("" where it has
    none), then the object's, then those of collections. pictures: names of the textures that feed the shader, and of
    their files. token: of the surface's tactile map, route: how the map came to be known. library: within a category,
    the usual first. Equal input gives equal order; ties keep the library's. Raises MaterialError on an empty library.
    """
    if not library:
        raise MaterialError("the material library is empty.", remedy="Install the package with its data files.")
    hits = match_names(library, names, image_names)
    appearance = _drop_defaults(appearance)
    looks = [_appearance_log_odds(material, appearance) for material in library]
    relief = relief_log_odds(library, token, route)
    score = _log_prior(library) + relief
    for i, material in enumerate(library):
        score[i] += APPEARANCE_TEMPER * sum(looks[i].values())
        score[i] += math.log(WORD_ODDS) * sum(weight for weight, _ in hits[material.name].values())
    probability = np.exp(score - score.max())
    probability = (1.0 - UNIFORM_FLOOR) * probability / probability.sum() + UNIFORM_FLOOR / len(library)
    same = np.array([[a.category == b.category for b in library] for a in library])
    aptness = (1.0 - SAME_CATEGORY_APTNESS) * probability + SAME_CATEGORY_APTNESS * (same @ probability)
    judged = dict.fromkeys(field for look in looks for field in look)
    usual = {field: float(np.median([look.get(field, 0.0) for look in looks])) for field in judged}
    reasons = [
        _format_reason(
            hits[material.name],
            look,
            usual,
            appearance,
            describe_relief_fit(material, float(odds), float(relief.max())),
        )
        for material, look, odds in zip(library, looks, relief, strict=True)
    ]
    # Within a category aptness differs by the material's own probability alone, so the order is the posterior's.
    order = np.argsort(-aptness, kind="stable")
    return tuple(Suggestion(library[i].name, float(aptness[i]), reasons[i], float(probability[i])) for i in order)


def describe_relief_fit(material: LibraryMaterial, log_odds: float, best: float) -> str:
    """What the relief says of a material, in words; "" where it says little. best: the highest log odds of the library:
    a relief that is like no material's speaks against none."""
    if log_odds > MIN_RELIEF_LOG_ODDS:
        return f"its relief is like {material.name}'s"
    return "its relief does not fit" if log_odds < min(0.0, best) - MIN_RELIEF_LOG_ODDS else ""


def _log_prior(library: Sequence[LibraryMaterial]) -> NDArray[np.float64]:
    """Within a category the k-th entry weighs 1/√k: a plain metal before a knurled one. Not normalised."""
    places: dict[str, int] = {}
    weights = []
    for material in library:
        places[material.category] = places.get(material.category, 0) + 1
        weights.append(1.0 / math.sqrt(places[material.category]))
    totals = {c: sum(w for m, w in zip(library, weights, strict=True) if m.category == c) for c in places}
    return np.array(
        [
            math.log(CATEGORY_FREQUENCY.get(material.category, 1.0) * weight / totals[material.category])
            for material, weight in zip(library, weights, strict=True)
        ]
    )


def _drop_defaults(appearance: Appearance) -> Appearance:
    """Less the base colour and roughness that every new material is born with: nobody chose them."""
    color, roughness = appearance.base_color, appearance.roughness
    if color is not None and all(abs(channel - DEFAULT_GREY) < 1e-3 for channel in color):
        color = None
    if roughness is not None and abs(roughness - DEFAULT_ROUGHNESS) < 1e-3:
        roughness = None
    return replace(appearance, base_color=color, roughness=roughness)


def _appearance_log_odds(material: LibraryMaterial, appearance: Appearance) -> dict[str, float]:
    """shading value → log of its density under the material over that of no knowledge (uniform)."""
    odds: dict[str, float] = {}
    for field, spread in APPEARANCE_SPREAD.items():
        value, typical = getattr(appearance, field), getattr(material.appearance, field)
        if value is not None and typical is not None and math.isfinite(value):
            density = _truncated_normal_density(min(max(value, 0.0), 1.0), typical, spread)
            odds[field] = math.log((1.0 - APPEARANCE_DOUBT[field]) * density + APPEARANCE_DOUBT[field])
    color, typical_color = appearance.base_color, material.appearance.base_color
    if color is not None and typical_color is not None and all(math.isfinite(c) for c in color):
        spread_light, spread_chroma = COLOR_SPREAD.get(material.category, DEFAULT_COLOR_SPREAD)
        (light, *chroma), (typical_light, *typical_chroma) = _to_light_chroma(color), _to_light_chroma(typical_color)
        density = _truncated_normal_density(light, typical_light, spread_light)
        for value, typical in zip(chroma, typical_chroma, strict=True):
            density *= _normal_density(value, typical, spread_chroma) / _normal_density(
                value, 0.0, OVERALL_CHROMA_SPREAD
            )
        odds["colour"] = math.log((1.0 - COLOR_DOUBT) * density + COLOR_DOUBT)
    return odds


def _to_light_chroma(color: Sequence[float]) -> tuple[float, float, float]:
    """Mean and two differences of the channels' cube roots: near to what is seen, where linear values would call
    every dark colour alike."""
    red, green, blue = (math.cbrt(min(max(channel, 0.0), 1.0)) for channel in color)
    return (red + green + blue) / 3.0, red - green, green - blue


def _normal_density(value: float, mean: float, spread: float) -> float:
    return math.exp(-0.5 * ((value - mean) / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))


def _truncated_normal_density(value: float, mean: float, spread: float) -> float:
    """Density on [0, 1] of a normal cut to it."""
    root = spread * math.sqrt(2.0)
    inside = 0.5 * (math.erf((1.0 - mean) / root) + math.erf(mean / root))
    return _normal_density(value, mean, spread) / inside


def _format_reason(
    hits: Mapping[str, tuple[float, str]],
    appearance_odds: Mapping[str, float],
    usual: Mapping[str, float],
    appearance: Appearance,
    relief: str,
) -> str:
    """The words found, then the values that fit better than they fit half of the library, and those that clash; then
    the relief."""
    parts = [f"'{word}' in '{name}'" for word, (_, name) in sorted(hits.items(), key=lambda item: -item[1][0])]
    del parts[MAX_REASON_WORDS:]
    for verdict, chosen in (
        ("fits", [field for field, odds in appearance_odds.items() if odds > max(usual[field] + 0.2, 0.0)]),
        ("does not fit", [field for field, odds in appearance_odds.items() if odds < -0.7]),
    ):
        parts += [f"{_format_value(field, appearance)} {verdict}" for field in chosen]
    parts += [relief] if relief else []
    return "; ".join(parts) or NO_EVIDENCE


def _format_value(field: str, appearance: Appearance) -> str:
    return "colour" if field == "colour" else f"{field} {getattr(appearance, field):.2f}"


@dataclass(frozen=True)
class PropertyEstimate:
    """value: geometric mean, so that a stiffness of 10³ and one of 10⁵ N/m meet at 10⁴. factor: one standard deviation,
    as a factor ≥ 1 to either side: how far the likely materials, and pieces of each, lie apart."""

    value: float
    factor: float


def get_probabilities(library: Sequence[LibraryMaterial], ranked: Sequence[Suggestion]) -> dict[str, float]:
    """Name → probability of every material that is ranked. Raises MaterialError where the library lacks one."""
    known = {material.name for material in library}
    missing = [each.name for each in ranked if each.name not in known]
    if missing:
        raise MaterialError(f"the ranking names materials that the library does not hold: {', '.join(missing)}.")
    return {each.name: each.probability for each in ranked}


def estimate_property(
    library: Sequence[LibraryMaterial], weights: Mapping[str, float], field: str, spread_within: float
) -> PropertyEstimate:
    """A mechanical property (a field of Mechanics) over the likely materials.

    weights: name → probability; need not sum to 1. within: standard deviation of the natural logarithm between pieces
    of one material. Materials that do not know the property, or have none of it, do not count: it has no logarithm.
    Raises MaterialError where none is left.
    """
    values, shares = [], []
    for material in library:
        value, share = getattr(material.mechanics, field), weights.get(material.name, 0.0)
        if value is not None and value > 0.0 and share > 0.0:
            values.append(float(np.log(value)))
            shares.append(share)
    if not values:
        raise MaterialError(f"no likely material knows its {field}.", remedy="Choose a material of the library.")
    logs, share = np.array(values), np.array(shares) / np.sum(shares)
    mean = float(share @ logs)
    between = float(share @ (logs - mean) ** 2)
    return PropertyEstimate(float(np.exp(mean)), float(np.exp(np.sqrt(between + spread_within**2))))
