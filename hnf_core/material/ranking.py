"""Ranking of library materials by names, shading values and relief (height map) of a surface: naive Bayes.

Prior: the frequency of a category in scenes, within it from usual to special entries. Names (`name_matching.py`): a
word that names a material makes it `WORD_ODDS` times likelier, less if it belongs to several categories or a less
telling name. Shading values: truncated normals around the library's typical value, mixed with a uniform distribution
(artists choose freely) and tempered (values are correlated).

Relief: the likelihood of a tactile map's token (feature vector) under each material against that under any relief. Only
features that do not change when the surface is turned are compared: level, strength of two- and four-fold anisotropy,
peak and offset of every band, skewness and kurtosis. They scatter by `WITHIN_CLASS_SPREAD`, and predicted ones by their
errors too, all levels together by `RELIEF_SCALE_DECADES`, since artists choose a relief's height freely. What a
prediction does not explain of the library's variance is no evidence.

The confidence of a suggestion is its expected aptness: 1 for the right material, `SAME_CATEGORY_APTNESS` for another
one of its category. Mechanics, which no image shows, are estimated as a mean over the ranked materials with its spread.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ..errors import MaterialError
from ..tactile.tactile_map import Route
from .contact_model import MECHANICS_NAMES, Mechanics
from .fuse import BAND_COUNT, WITHIN_CLASS_SPREAD, find_known_bands, find_significant_bands, read_prediction
from .library import Appearance, LibraryMaterial, get_material, load_library
from .name_matching import match_names
from .token import BAND_FEATURES, SHAPE_FEATURES, TOKEN_DIM, Token

Float = NDArray[np.float64]

INVARIANT_KINDS = ("level", "two_fold", "four_fold", "peak", "offset")
RELIEF_SCALE_DECADES = 0.3
"""Standard deviation of an artist's relief height relative to the real one [decades]; a factor of 2."""
UNCALIBRATED_SPREAD_FACTOR = 2.0
"""Factor of that spread for a predicted token whose errors are unknown, as that of a touch image without a calibration.
Chosen by judgement."""
RELIEF_DOUBT = 0.1
"""Probability that a relief is not the material's own: dents, letters, a bump for looks. Generated instances fit best
with the least value tried (0.05), but artists choose freely."""
BORROWED_RELIEF_SHARE = 0.05
"""Probability that another material has this material's relief: wood printed on foil, embossed leatherette. It limits
the evidence of a relief to 14 : 1, so that a name given by the artist prevails. Chosen by judgement: generated
instances never borrow."""
RELIEF_ODDS_STEP = 0.01
"""Step of the log odds of a relief: two patches of one surface differ in digits that tell nothing, and should feel like
one material."""
RELIEF_TEMPER = 0.15
"""Exponent of the likelihood, since the 37 features of a token are correlated: of ten values from 0 to 1, the one that
makes the right class of generated instances likeliest."""
PREDICTED_TEMPER = 0.1
"""The same for tokens that D_φ predicts, whose errors are counted: of ten values from 0 to 1, the one that makes the
right class likeliest on rendered looks of classes that D_φ never met, varied as photographs are (docs/tactile-maps.md).
"""


def relief_log_odds(library: Sequence[LibraryMaterial], token: Token | None, route: Route = Route.MEASURED) -> Float:
    """Compute the log odds of a tactile map's token under each material against any relief.

    Parameters
    ----------
    library : sequence of LibraryMaterial
        The materials.
    token : Token or None
        Token of the map; without one, or of the prior route, all odds are 0.
    route : Route
        Origin of the map. Wavelength bands that `fuse.fuse` would take from the library do not count.

    Returns
    -------
    ndarray, shape (len(library),)
        Log odds.

    Raises
    ------
    MaterialError
        For a token of the wrong size.
    """
    zero = np.zeros(len(library))
    if token is None or route is Route.PRIOR:
        return zero
    if token.values.shape != (TOKEN_DIM,):
        raise MaterialError(f"a token holds {TOKEN_DIM} values, not {token.values.shape}.")
    bands = np.array(find_significant_bands(token) if route is Route.MEASURED else find_known_bands(token))
    if not bands.any():
        return zero
    shape_known = bool(token.known[-len(SHAPE_FEATURES) :].all())
    values, variance = token.values, np.zeros(TOKEN_DIM)
    if route is Route.PREDICTED and token.error is not None:
        values, variance = read_prediction(token)
    observed = compute_invariants(values[None])[0]
    expected = compute_invariants(np.stack([material.token for material in library]))
    chosen = np.concatenate([np.tile(bands, len(INVARIANT_KINDS)), np.full(len(SHAPE_FEATURES), shape_known)])
    within = _get_within_class_spread()
    if route is Route.PREDICTED and token.error is None:
        within = UNCALIBRATED_SPREAD_FACTOR * within
    within = np.hypot(within, np.sqrt(_pick_invariants(variance)))
    chosen &= np.isfinite(within)
    if not chosen.any():
        return zero
    spread = np.sqrt(expected.var(axis=0) + within**2)
    is_level = chosen & (np.arange(len(chosen)) < BAND_COUNT)
    is_other = chosen & ~is_level
    log_material = _log_level_density(observed[is_level] - expected[:, is_level], within[is_level])
    log_any = _log_level_density((observed - expected.mean(axis=0))[None, is_level], spread[is_level])
    log_material = log_material + _log_normal_density(observed[is_other] - expected[:, is_other], within[is_other])
    log_any = log_any + _log_normal_density((observed - expected.mean(axis=0))[None, is_other], spread[is_other])
    temper = RELIEF_TEMPER if token.error is None else PREDICTED_TEMPER
    ratio = np.exp(np.minimum(temper * (log_material - log_any), 300.0))
    odds = np.asarray(
        np.log((1.0 - RELIEF_DOUBT) * ratio + RELIEF_DOUBT)
        - np.log(1.0 - BORROWED_RELIEF_SHARE + BORROWED_RELIEF_SHARE * ratio)
    )
    return np.asarray(RELIEF_ODDS_STEP * np.round(odds / RELIEF_ODDS_STEP))


def compute_invariants(tokens: NDArray[np.float32]) -> Float:
    """Return the rotation-invariant features (n, BAND_COUNT · 5 + 2) of material tokens (n, TOKEN_DIM).

    All bands' levels, then their two-fold strengths, and so on in the order of `INVARIANT_KINDS`; then skewness and log
    kurtosis.
    """
    values = np.asarray(tokens, dtype=np.float64)
    bands = values[:, : BAND_COUNT * len(BAND_FEATURES)].reshape(-1, BAND_COUNT, len(BAND_FEATURES))
    named = {name: bands[:, :, index] for index, name in enumerate(BAND_FEATURES)}
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
    """Return `WITHIN_CLASS_SPREAD` for each feature, (BAND_COUNT · 5 + 2,), in the order of `compute_invariants`."""
    return np.concatenate(
        [
            np.repeat([WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS], BAND_COUNT),
            [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES],
        ]
    )


def _pick_invariants(values: Float) -> Float:
    """Return the values (TOKEN_DIM,) that belong to the features of `compute_invariants`, cosines for strengths."""
    bands = values[: BAND_COUNT * len(BAND_FEATURES)].reshape(BAND_COUNT, len(BAND_FEATURES))
    names = ("level", "cos2", "cos4", "peak", "offset")
    return np.concatenate([*(bands[:, BAND_FEATURES.index(name)] for name in names), values[-len(SHAPE_FEATURES) :]])


def _log_normal_density(residual: Float, spread: Float) -> Float:
    return np.asarray(-0.5 * np.sum((residual / spread) ** 2, axis=1) - np.sum(np.log(spread)))


def _log_level_density(residual: Float, spread: Float) -> Float:
    """Return the log density, up to a constant, of deviations (…, bands) of band levels from a material's.

    Each level scatters by `spread`, and all together by a common factor of the relief's height: a normal of covariance
    diag(spread²) + s² 11ᵀ, s = `RELIEF_SCALE_DECADES` (Sherman & Morrison 1950).
    """
    weight = 1.0 / spread**2
    common_weight = RELIEF_SCALE_DECADES**2 / (1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    square = np.sum(weight * residual**2, axis=1) - common_weight * np.sum(weight * residual, axis=1) ** 2
    return np.asarray(
        -0.5 * square - np.sum(np.log(spread)) - 0.5 * np.log(1.0 + RELIEF_SCALE_DECADES**2 * weight.sum())
    )


WORD_ODDS = 5000.0
"""Factor by which a word that names a material makes it likelier: names of assets as they are met are right in 97 of
100 cases, and then the confidence is (tools/hnf_lab/experiments/suggestions.py)."""
CATEGORY_FREQUENCY = {"plastic": 1.6, "wood": 1.3, "metal": 1.3, "fabric": 1.3, "carpet": 0.7, "foam": 0.5}
"""Frequency of a category in scenes, relative to 1 for the others; decides if there is no evidence."""
PICTURE_ODDS = MappingProxyType({
    "fabric": 3.0, "paper": 3.0, "foam": 2.0, "carpet": 1.4, "plastic": 1.25, "leather": 0.7, "glass": 0.5,
    "rubber": 0.5,
})  # fmt: skip
"""Factor by which a picture as color makes a category likelier, 1 for the others: glass and rubber mostly have none.

Rounded, so that frequencies are those of the kinds of surface that people collect to touch (of HaTT's hundred 30 are
fabrics and 22 papers), and what is felt of an unknown picture is near the mean of such surfaces. Set before any
photograph was judged by them.
"""
DEFAULT_GREY, DEFAULT_ROUGHNESS = 0.8, 0.5
"""Base colour and roughness of a new Principled BSDF."""
APPEARANCE_TEMPER = 0.6
"""Exponent of the likelihood of shading values, since they are correlated."""
UNIFORM_FLOOR = 0.03
"""Probability that is spread evenly over the library."""
SAME_CATEGORY_APTNESS = 0.97
"""Aptness of a material of the right category that is not the right one."""
NO_EVIDENCE = "no clue in the scene"
MAX_REASON_WORDS = 3
MIN_RELIEF_LOG_ODDS = 0.4
"""Log odds of a relief from which it is given as a reason."""
APPEARANCE_SPREAD = {"roughness": 0.18, "metallic": 0.12, "sheen": 0.25, "transmission": 0.2}
"""Standard deviations of shading values within a material."""
APPEARANCE_DOUBT = {"roughness": 0.2, "metallic": 0.1, "sheen": 0.2, "transmission": 0.1}
"""Weight of the uniform distribution: how often a shading value is no evidence."""
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
"""Standard deviations of lightness and chroma by category, in cube roots of linear values."""
DEFAULT_COLOR_SPREAD = (0.35, 0.2)
"""Standard deviations of lightness and chroma for materials that are dyed or painted in any colour."""
PAINTED = "painted"
"""Part of the name of a material whose color is that of its paint, whatever its category."""
OVERALL_CHROMA_SPREAD = 0.25
"""Standard deviation of chroma over all materials, which a material's own is compared with."""
COLOR_DOUBT = 0.3
"""Weight of the uniform distribution for colours."""


@dataclass(frozen=True)
class Suggestion:
    """A ranked library material.

    Attributes
    ----------
    name : str
        Name in the library.
    confidence : float
        Expected aptness, 0 to 1: 1 if it is the right material, less if only its category is right.
    reason : str
        Why it was ranked so, one line for the report.
    probability : float
        Probability that it is this material; all of a ranking sum to 1.
    """

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
    look: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Suggestion, ...]:
    """Rank all library materials by how well they fit a surface, the most apt first.

    Parameters
    ----------
    library : sequence of LibraryMaterial
        The materials; within a category, the usual ones first.
    appearance : Appearance
        Shading values, None = unknown (no evidence).
    names : sequence of str
        Name of the material first ("" if it has none), then of the object, then of collections.
    image_names : sequence of str
        Names of the textures of the shader and of their files.
    token : Token, optional
        Token of the surface's tactile map, as evidence of its relief.
    route : Route
        Origin of that map, measured or predicted.
    look : mapping of str to float
        Factor by which a picture of the surface makes a category likelier; 1 where it is left out.

    Returns
    -------
    tuple of Suggestion
        All materials. Equal input gives equal order; ties keep the library's.

    Raises
    ------
    MaterialError
        For an empty library.
    """
    if not library:
        raise MaterialError("the material library is empty.", remedy="Install the package with its data files.")
    hits = match_names(library, names, image_names)
    appearance = _drop_defaults(appearance)
    appearance_odds = [_appearance_log_odds(material, appearance) for material in library]
    relief = relief_log_odds(library, token, route)
    score = _log_prior(library) + relief
    for i, material in enumerate(library):
        score[i] += APPEARANCE_TEMPER * sum(appearance_odds[i].values())
        score[i] += math.log(look.get(material.category, 1.0))
        score[i] += math.log(WORD_ODDS) * sum(weight for weight, _ in hits[material.name].values())
    probability = np.exp(score - score.max())
    probability = (1.0 - UNIFORM_FLOOR) * probability / probability.sum() + UNIFORM_FLOOR / len(library)
    used_values = dict.fromkeys(field for odds_by_value in appearance_odds for field in odds_by_value)
    median_odds = {
        field: float(np.median([odds_by_value.get(field, 0.0) for odds_by_value in appearance_odds]))
        for field in used_values
    }
    reasons = [
        _format_reason(
            hits[material.name],
            odds_by_value,
            median_odds,
            appearance,
            describe_relief_fit(material, float(relief_odds), float(relief.max())),
        )
        for material, odds_by_value, relief_odds in zip(library, appearance_odds, relief, strict=True)
    ]
    return _order_by_aptness(library, probability, reasons)


def _order_by_aptness(
    library: Sequence[LibraryMaterial], probability: Float, reasons: Sequence[str]
) -> tuple[Suggestion, ...]:
    """Return the materials with their probabilities and reasons, the most apt first."""
    same_category = np.array([[first.category == second.category for second in library] for first in library])
    aptness = (1.0 - SAME_CATEGORY_APTNESS) * probability + SAME_CATEGORY_APTNESS * (same_category @ probability)
    # Within a category aptness differs only by the material's probability, so the order is that of the posterior.
    order = np.argsort(-aptness, kind="stable")
    return tuple(Suggestion(library[i].name, float(aptness[i]), reasons[i], float(probability[i])) for i in order)


def mix_rankings(
    library: Sequence[LibraryMaterial], rankings: Sequence[Sequence[Suggestion]], weights: Sequence[float]
) -> tuple[Suggestion, ...]:
    """Rank the materials of a surface whose parts were ranked one by one: the weighted mean of their probabilities.

    Two materials side by side are then each as probable as its part is large; the mean of their colors may be a third
    one's. `weights` are the sizes of the parts, and each reason is that of the part where the material is likeliest.
    """
    if len(rankings) == 1:
        return tuple(rankings[0])
    by_part = [{suggestion.name: suggestion for suggestion in ranked} for ranked in rankings]
    shares = np.asarray(weights, dtype=np.float64) / np.sum(weights)
    named = [[part[material.name] for part in by_part] for material in library]
    probability = np.array([[suggestion.probability for suggestion in parts] for parts in named]) @ shares
    reasons = [max(parts, key=lambda suggestion: suggestion.probability).reason for parts in named]
    return _order_by_aptness(library, probability, reasons)


def find_material(words: str) -> tuple[LibraryMaterial, Suggestion | None]:
    """Return the library material of a name or, for other words, the best-ranked one with its suggestion.

    Raises MaterialError with close matches if the words are neither a name nor name a material.
    """
    try:
        # Numbers tell pieces of one material apart ("Plastic Mesh 2").
        return get_material(re.sub(r"[\s_-]*\d+$", "", words)), None
    except MaterialError:
        library = load_library()
        best = rank(library, Appearance(), [words])[0]
        if best.reason == NO_EVIDENCE:
            raise
        return next(material for material in library if material.name == best.name), best


def describe_relief_fit(material: LibraryMaterial, log_odds: float, best: float) -> str:
    """Describe how a surface's relief fits a material, from its log odds (`relief_log_odds`); "" if it hardly matters.

    `best` is the highest log odds in the library: a relief that is unlike all materials is no evidence against one of
    them.
    """
    if log_odds > MIN_RELIEF_LOG_ODDS:
        return f"its relief is like {material.name}'s"
    return "its relief does not fit" if log_odds < min(0.0, best) - MIN_RELIEF_LOG_ODDS else ""


def _log_prior(library: Sequence[LibraryMaterial]) -> NDArray[np.float64]:
    """Return the log prior of each material, not normalized: its category's frequency times 1/√k for its k-th entry."""
    counts: dict[str, int] = {}
    weights = []
    for material in library:
        counts[material.category] = counts.get(material.category, 0) + 1
        weights.append(1.0 / math.sqrt(counts[material.category]))
    totals = {c: sum(w for m, w in zip(library, weights, strict=True) if m.category == c) for c in counts}
    return np.array(
        [
            math.log(CATEGORY_FREQUENCY.get(material.category, 1.0) * weight / totals[material.category])
            for material, weight in zip(library, weights, strict=True)
        ]
    )


def _drop_defaults(appearance: Appearance) -> Appearance:
    """Set base color and roughness to unknown if they are the defaults of a new Principled BSDF, which nobody chose."""
    color, roughness = appearance.base_color, appearance.roughness
    if color is not None and all(abs(channel - DEFAULT_GREY) < 1e-3 for channel in color):
        color = None
    if roughness is not None and abs(roughness - DEFAULT_ROUGHNESS) < 1e-3:
        roughness = None
    return replace(appearance, base_color=color, roughness=roughness)


def _appearance_log_odds(material: LibraryMaterial, appearance: Appearance) -> dict[str, float]:
    """Return for each shading value the log of its probability density under the material over the uniform density."""
    odds: dict[str, float] = {}
    for field, spread in APPEARANCE_SPREAD.items():
        value, typical = getattr(appearance, field), getattr(material.appearance, field)
        if value is not None and typical is not None and math.isfinite(value):
            density = _truncated_normal_density(min(max(value, 0.0), 1.0), typical, spread)
            odds[field] = math.log((1.0 - APPEARANCE_DOUBT[field]) * density + APPEARANCE_DOUBT[field])
    color, library_color = appearance.base_color, material.appearance.base_color
    if color is not None and library_color is not None and all(math.isfinite(c) for c in color):
        is_painted = PAINTED in material.name.split("-")
        spread_light, spread_chroma = (
            DEFAULT_COLOR_SPREAD if is_painted else COLOR_SPREAD.get(material.category, DEFAULT_COLOR_SPREAD)
        )
        (light, *chroma), (typical_light, *typical_chroma) = _to_light_chroma(color), _to_light_chroma(library_color)
        density = _truncated_normal_density(light, typical_light, spread_light)
        for value, typical in zip(chroma, typical_chroma, strict=True):
            density *= _normal_density(value, typical, spread_chroma) / _normal_density(
                value, 0.0, OVERALL_CHROMA_SPREAD
            )
        odds["colour"] = math.log((1.0 - COLOR_DOUBT) * density + COLOR_DOUBT)
    return odds


def _to_light_chroma(color: Sequence[float]) -> tuple[float, float, float]:
    """Return lightness and two chroma values of a linear RGB color: mean and two differences of the cube roots.

    Cube roots are near perception; with linear values, all dark colors would be alike.
    """
    red, green, blue = (math.cbrt(min(max(channel, 0.0), 1.0)) for channel in color)
    return (red + green + blue) / 3.0, red - green, green - blue


def _normal_density(value: float, mean: float, spread: float) -> float:
    return math.exp(-0.5 * ((value - mean) / spread) ** 2) / (spread * math.sqrt(2.0 * math.pi))


def _truncated_normal_density(value: float, mean: float, spread: float) -> float:
    """Return the density of a normal truncated to [0, 1]."""
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
    """Format the reason for a rank: matched words, values that fit better than usual, values that clash, the relief."""
    clauses = [f"'{word}' in '{name}'" for word, (_, name) in sorted(hits.items(), key=lambda item: -item[1][0])]
    del clauses[MAX_REASON_WORDS:]
    for verdict, values in (
        ("fits", [field for field, odds in appearance_odds.items() if odds > max(usual[field] + 0.2, 0.0)]),
        ("does not fit", [field for field, odds in appearance_odds.items() if odds < -0.7]),
    ):
        clauses += [f"{_format_value(field, appearance)} {verdict}" for field in values]
    clauses += [relief] if relief else []
    return "; ".join(clauses) or NO_EVIDENCE


def _format_value(field: str, appearance: Appearance) -> str:
    return "colour" if field == "colour" else f"{field} {getattr(appearance, field):.2f}"


@dataclass(frozen=True)
class PropertyEstimate:
    """A mechanical property estimated from the probabilities of the materials.

    Attributes
    ----------
    value : float
        Geometric mean over the materials: stiffnesses of 10³ and 10⁵ N/m give 10⁴.
    factor : float
        One standard deviation as a factor ≥ 1: from the spread between the likely materials and within each.
    """

    value: float
    factor: float


def get_probabilities(library: Sequence[LibraryMaterial], ranked: Sequence[Suggestion]) -> dict[str, float]:
    """Return the probability of every suggestion by material name; raise MaterialError if the library lacks one."""
    known = {material.name for material in library}
    missing = [suggestion.name for suggestion in ranked if suggestion.name not in known]
    if missing:
        raise MaterialError(f"the ranking names materials that the library does not hold: {', '.join(missing)}.")
    return {suggestion.name: suggestion.probability for suggestion in ranked}


def estimate_property(
    library: Sequence[LibraryMaterial], weights: Mapping[str, float], field: str, spread_within: float
) -> PropertyEstimate:
    """Estimate a mechanical property as the geometric mean over the likely materials.

    Parameters
    ----------
    library : sequence of LibraryMaterial
        The materials.
    weights : mapping of str to float
        Probability by name; need not sum to 1.
    field : str
        Name of the property, a field of `Mechanics`.
    spread_within : float
        Standard deviation of the natural logarithm between instances of one material.

    Returns
    -------
    PropertyEstimate
        The estimate; materials without the property, or with a value of 0, do not count.

    Raises
    ------
    MaterialError
        If no material counts.
    """
    values, probabilities = [], []
    for material in library:
        value, probability = getattr(material.mechanics, field), weights.get(material.name, 0.0)
        if value is not None and value > 0.0 and probability > 0.0:
            values.append(float(np.log(value)))
            probabilities.append(probability)
    if not values:
        raise MaterialError(f"no likely material knows its {field}.", remedy="Choose a material of the library.")
    logs, probability = np.array(values), np.array(probabilities) / np.sum(probabilities)
    mean = float(probability @ logs)
    between = float(probability @ (logs - mean) ** 2)
    return PropertyEstimate(float(np.exp(mean)), float(np.exp(np.sqrt(between + spread_within**2))))


ENOUGH_PROBABILITY = 0.5
"""Probability from which a surface is felt as one material alone, with its lines."""
LOG_MECHANICS = frozenset({"stiffness_n_m", "damping_ratio", "friction", "friction_noise_n"})
"""Mechanical properties whose logarithm is averaged."""


def expect_material(library: Sequence[LibraryMaterial], ranked: Sequence[Suggestion]) -> LibraryMaterial:
    """Return what is felt of a surface that may be several materials: its expectation over their probabilities.

    Parameters
    ----------
    library : sequence of LibraryMaterial
        The materials.
    ranked : sequence of Suggestion
        Their ranking (`rank`), the first of which gives the name.

    Returns
    -------
    LibraryMaterial
        The first material if its probability is `ENOUGH_PROBABILITY`. Otherwise one of its name with the mean token
        and mechanics: levels, stiffness, damping, friction and its noise are averaged in decibels, so that the level
        of the vibration is, and lines are left out, which only one of the materials would have.
    """
    by_name = {material.name: material for material in library}
    first = by_name[ranked[0].name]
    if ranked[0].probability >= ENOUGH_PROBABILITY:
        return first
    materials = [by_name[suggestion.name] for suggestion in ranked]
    weights = np.array([suggestion.probability for suggestion in ranked])
    token = np.average([material.token for material in materials], axis=0, weights=weights).astype(np.float32)
    bands = _split_bands(token)
    peak, offset = BAND_FEATURES.index("peak"), BAND_FEATURES.index("offset")
    # Noise has a strongest wave by chance too, in the few waves of a long band above all.
    bands[:, peak] = np.min([_split_bands(material.token)[:, peak] for material in materials], axis=0)
    bands[:, offset] = 0.0
    mechanics = {name: _average_known(materials, weights, name) for name in MECHANICS_NAMES}
    if mechanics["thread_spacing_m"] is not None:
        mechanics["thread_spacing_m"] = 0.0
    return replace(first, token=token, mechanics=Mechanics(**mechanics))


def _split_bands(token: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return a view of a token's bands (BAND_COUNT, features)."""
    return token[: BAND_COUNT * len(BAND_FEATURES)].reshape(BAND_COUNT, len(BAND_FEATURES))


def _average_known(materials: Sequence[LibraryMaterial], weights: Float, name: str) -> float | None:
    """Average a mechanical property over the materials that know it; None if none does."""
    values = np.array([np.nan if (value := getattr(m.mechanics, name)) is None else value for m in materials])
    is_known = np.isfinite(values)
    if not is_known.any():
        return None
    if name in LOG_MECHANICS:
        return float(np.exp(np.average(np.log(np.maximum(values[is_known], 1e-12)), weights=weights[is_known])))
    return float(np.average(values[is_known], weights=weights[is_known]))
