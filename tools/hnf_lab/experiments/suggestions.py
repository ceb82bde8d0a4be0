"""How often the ranking of library materials is right: on generated pieces of every class, and on names as met.

Usage: python -m hnf_lab.experiments.suggestions [--calibrate] [--json]

Pieces of every class that nothing was fitted to: the held-out splits of tools/make_tactile_pairs.py, five a class,
lying as they come. Evidence: the name of a picture (a word of the class, a word of its category, or nothing, a third
each), the look (base colour, roughness, metallic as simulation.look draws a piece, sheen and transmission as the
library has them), the token of its relief, whose height an artist gave another scale (a factor, log-normal, 2), and all
of them. --calibrate prints the scatter of tokens within a class and the weights of the relief that fit best, from other
seeds: what relief.py has as constants.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hnf_lab import ROOT

sys.path.insert(0, str(ROOT / "tests" / "core"))

from asset_names import HELD_BACK, TUNED
from safetensors import safe_open

from hnf_core.datasets.tactile_pairs import SPLITS
from hnf_core.errors import FileError
from hnf_core.files import write_atomically
from hnf_core.material import ranking
from hnf_core.material.band_descriptor import describe
from hnf_core.material.library import (
    Appearance,
    get_material,
    load_library,
)
from hnf_core.material.name_matching import CATEGORY_WORDS, is_image_name
from hnf_core.material.ranking import Suggestion, rank
from hnf_core.material.token import LEVELS, Token, band_slice
from hnf_core.simulation.appearance.instance import sample_appearance
from hnf_core.simulation.material_classes import derive_seed, get_category, list_classes, sample_instance
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map
from hnf_core.tactile.height import tactile_map_from_height

CALIBRATION_SEEDS = range(1, 5)
"""Seeds of the pieces that the constants were fitted to; those of the pairs lie far from them."""
CACHE_FOLDER, PAIRS_FOLDER = ROOT / "build" / "suggestions", ROOT / "build" / "tactile-pairs"
SAMPLES_PER_CLASS = 5
"""Of each class, for the measurement."""
HEIGHT_SCATTER_DECADES = 0.3
"""Decades, standard deviation: nobody knows how high their bump really is."""
COARSE_BANDS = 4
"""8 to 1 mm: what a picture of a few pixels a millimetre resolves."""
TEMPERS = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)
DOUBTS = (0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class SurfaceSample:
    """One generated piece: its class, what its looks and names say, its token."""

    name: str
    appearance: Appearance
    image_name: str
    token: Token


def compute_token(name: str, seed: int) -> np.ndarray:
    """(TOKEN_DIM,) of a piece's own tile."""
    recipe, _ = sample_instance(name, seed)
    pitch = TILE_SIZE_M / TILE_PIXELS
    return describe(tactile_map_from_height(height_map(recipe, seed), None, pitch, 2.0 * pitch)).values


def load_calibration_tokens() -> np.ndarray:
    """(classes, seeds, TOKEN_DIM); kept in build/, since a tile takes a third of a second."""
    path = CACHE_FOLDER / f"tokens-{CALIBRATION_SEEDS[0]}-{CALIBRATION_SEEDS[-1]}.npy"
    if not path.is_file():
        made = np.stack([[compute_token(name, seed) for seed in CALIBRATION_SEEDS] for name in list_classes()])
        write_atomically(path, lambda temporary: np.save(temporary.open("wb"), made))
    return np.load(path)


def load_held_out_tokens() -> dict[str, list[np.ndarray]]:
    """Tokens of PIECES instances of each class, from the held-out splits. Raises FileError where they are not made."""
    found: dict[str, dict[int, np.ndarray]] = {name: {} for name in list_classes()}
    for path in sorted(path for split in SPLITS[1:] for path in (PAIRS_FOLDER / split).glob("*.safetensors")):
        with safe_open(path, "np") as shard:
            names = json.loads(shard.metadata()["class_name"])
            rows = zip(names, *(shard.get_tensor(each) for each in ("instance_seed", "patch", "token")), strict=True)
            for name, seed, patch, token in rows:
                if name and patch == 0 and len(found[name]) < SAMPLES_PER_CLASS:
                    found[name][int(seed)] = token
    short = [name for name, kept in found.items() if len(kept) < SAMPLES_PER_CLASS]
    if short:
        raise FileError(
            f"it lacks pieces of {', '.join(short[:5])}.",
            where=str(PAIRS_FOLDER),
            remedy="Run tools/make_tactile_pairs.py.",
        )
    return {name: list(kept.values()) for name, kept in found.items()}


def make_samples(tokens: Mapping[str, Sequence[np.ndarray]]) -> list[SurfaceSample]:
    """Pieces with these tokens by class, their looks and names drawn by their place, their heights scaled."""
    found = []
    for name, own in tokens.items():
        for number, values in enumerate(own):
            rng = np.random.default_rng([derive_seed(name), number, 7])
            scaled = np.array(values)
            scaled[LEVELS] += np.float32(HEIGHT_SCATTER_DECADES * rng.standard_normal())
            token = Token(scaled, np.ones(len(scaled), dtype=bool))
            found.append(SurfaceSample(name, _draw_appearance(name, rng), _draw_image_name(name, rng), token))
    return found


def _draw_appearance(name: str, rng: np.random.Generator) -> Appearance:
    typical = get_material(name).appearance
    made = sample_appearance(typical, get_category(name), rng)
    return replace(typical, base_color=made.base_color, roughness=made.roughness, metallic=made.metallic)


def _draw_image_name(name: str, rng: np.random.Generator) -> str:
    kind, number = rng.integers(3), rng.integers(1, 99)
    own, related = get_material(name).words, CATEGORY_WORDS[get_category(name)].split()
    word = ("", own[rng.integers(len(own))], related[rng.integers(len(related))])[kind]
    return f"T_{word.title()}_{number:02d}_BaseColor.png"


def select_coarse_bands(token: Token) -> Token:
    """Only what COARSE_BANDS resolve."""
    known = np.zeros_like(token.known)
    for band in range(COARSE_BANDS):
        known[band_slice(band)] = True
    return Token(token.values, known)


EVIDENCE = ("words", "look", "relief", "relief, 8–1 mm", "words and look", "all", "all, relief 8–1 mm")


def rank_sample(sample: SurfaceSample, evidence: str) -> tuple[Suggestion, ...]:
    everything = evidence.startswith("all")
    seen = select_coarse_bands(sample.token) if evidence.endswith("mm") else sample.token
    return rank(
        load_library(),
        sample.appearance if everything or "look" in evidence else Appearance(),
        [""],
        image_names=[sample.image_name] if everything or "words" in evidence else [],
        token=seen if everything or "relief" in evidence else None,
    )


def compute_hits(samples: Sequence[SurfaceSample], evidence: str) -> dict[str, float]:
    """Shares of pieces whose class and category come first, and among the first three."""
    category = {material.name: material.category for material in load_library()}
    rows = []
    for piece in samples:
        order = [suggestion.name for suggestion in rank_sample(piece, evidence)]
        groups = list(dict.fromkeys(category[name] for name in order))
        own = category[piece.name]
        rows.append([order[0] == piece.name, piece.name in order[:3], groups[0] == own, own in groups[:3]])
    names = ("class@1", "class@3", "category@1", "category@3")
    return dict(zip(names, (float(share) for share in np.mean(rows, axis=0)), strict=True))


def compute_name_hits(names: dict[str, str]) -> dict[str, float]:
    """The same of categories, for names alone."""
    category = {material.name: material.category for material in load_library()}
    first, among = 0, 0
    for name, expected in names.items():
        as_picture = is_image_name(name)
        ranked = rank(load_library(), Appearance(), [""] if as_picture else [name], image_names=[name] * as_picture)
        told = ranked[0].confidence - ranked[-1].confidence > 0.05
        groups = list(dict.fromkeys(category[each.name] for each in ranked)) if told else []
        first += groups[:1] == [expected]
        among += expected in groups[:3]
    return {"names": len(names), "category@1": first / len(names), "category@3": among / len(names)}


def calibrate() -> dict[str, object]:
    """Scatter of the invariants within a class about the library's own token, and the temper and doubt under which
    the right class has the highest mean log probability, from all evidence together."""
    tokens = load_calibration_tokens()
    found = make_samples(dict(zip(list_classes(), tokens, strict=True)))
    typical = np.stack([get_material(name).token for name in list_classes()])
    gap = ranking.compute_invariants(tokens.reshape(-1, tokens.shape[-1])) - np.repeat(
        ranking.compute_invariants(typical), len(CALIBRATION_SEEDS), axis=0
    )
    kinds = [*np.repeat(ranking.INVARIANT_KINDS, ranking.BAND_COUNT), *ranking.SHAPE_FEATURES]
    within = {kind: float(np.sqrt(np.mean(gap[:, [k == kind for k in kinds]] ** 2))) for kind in dict.fromkeys(kinds)}
    ranking.WITHIN_CLASS_SPREAD.update(within)
    scores = {}
    for ranking.RELIEF_TEMPER in TEMPERS:
        for ranking.RELIEF_DOUBT in DOUBTS:
            told = [
                np.log(next(each.probability for each in rank_sample(piece, evidence) if each.name == piece.name))
                for piece in found
                for evidence in ("relief", "all", "all, relief 8–1 mm")
            ]
            scores[f"temper {ranking.RELIEF_TEMPER} doubt {ranking.RELIEF_DOUBT}"] = float(np.mean(told))
    best = sorted(scores.items(), key=lambda item: -item[1])[:6]
    return {"within": within, "log probability of the right class, best": dict(best)}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.calibrate:
        print(json.dumps(calibrate(), indent=1))
        return 0
    found = make_samples(load_held_out_tokens())
    rows = {evidence: compute_hits(found, evidence) for evidence in EVIDENCE}
    names = {"names, tuned half": compute_name_hits(TUNED), "names, held back": compute_name_hits(HELD_BACK)}
    if arguments.json:
        print(json.dumps({"pieces": len(found), **rows, **names}, indent=1))
        return 0
    print(f"{len(found)} pieces of {len(list_classes())} classes; chance: 1/43 of classes, 1/12 of categories")
    for label, shares in rows.items():
        print(f"{label:<20}" + "  ".join(f"{name} {share:6.1%}" for name, share in shares.items()))
    for label, shares in names.items():
        print(f"{label:<20}" + "  ".join(f"{name} {share:6.3g}" for name, share in shares.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
