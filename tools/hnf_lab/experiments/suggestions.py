"""Measure how often the ranking of library materials is right, on generated surfaces and on real asset names.

  Usage: python -m hnf_lab.experiments.suggestions [--calibrate] [--json]

Uses five instances per class from the held-out splits of tools/make_tactile_pairs.py, to which nothing was fitted. The
evidence is the file name of an image (a word of the class, a word of its category, or nothing, a third each), the
appearance (base colour, roughness and metallic drawn by simulation.appearance, sheen and transmission of the library),
the token of the relief with its height scaled by a random factor (log-normal, 2), and all of them. --calibrate prints
the scatter of tokens within a class and the best weights of the relief, from other seeds: the constants of
hnf_core.material.ranking.
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
from hnf_core.simulation.appearance import sample_appearance
from hnf_core.simulation.material_classes import derive_seed, get_category, list_classes, sample_instance
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, height_map
from hnf_core.tactile.height import tactile_map_from_height

CALIBRATION_SEEDS = range(1, 5)
"""Seeds of the instances to which the constants were fitted; seeds of the pairs are far from them."""
CACHE_FOLDER, PAIRS_FOLDER = ROOT / "build" / "suggestions", ROOT / "build" / "tactile-pairs"
SAMPLES_PER_CLASS = 5
"""Instances of each class in the measurement."""
HEIGHT_SCATTER_DECADES = 0.3
"""Standard deviation of the unknown scale of bump heights [decades]."""
COARSE_BANDS = 4
"""Number of bands, 8 to 1 mm, that an image of a few pixels per millimetre resolves."""
TEMPERS = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45, 0.7, 1.0)
DOUBTS = (0.05, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True)
class SurfaceSample:
    """One generated instance with its class, appearance, image name and token."""

    name: str
    appearance: Appearance
    image_name: str
    token: Token


def compute_token(name: str, seed: int) -> np.ndarray:
    """Return the (TOKEN_DIM,) token of an instance's tile."""
    recipe, _ = sample_instance(name, seed)
    pitch = TILE_SIZE_M / TILE_PIXELS
    return describe(tactile_map_from_height(height_map(recipe, seed), None, pitch, 2.0 * pitch)).values


def load_calibration_tokens() -> np.ndarray:
    """Return (classes, seeds, TOKEN_DIM), cached in build/ because a tile takes a third of a second."""
    path = CACHE_FOLDER / f"tokens-{CALIBRATION_SEEDS[0]}-{CALIBRATION_SEEDS[-1]}.npy"
    if not path.is_file():
        tokens = np.stack([[compute_token(name, seed) for seed in CALIBRATION_SEEDS] for name in list_classes()])
        write_atomically(path, lambda temporary: np.save(temporary.open("wb"), tokens))
    return np.load(path)


def load_held_out_tokens() -> dict[str, list[np.ndarray]]:
    """Load tokens of SAMPLES_PER_CLASS instances of each class. Raises FileError if they do not exist."""
    tokens: dict[str, dict[int, np.ndarray]] = {name: {} for name in list_classes()}
    for path in sorted(path for split in SPLITS[1:] for path in (PAIRS_FOLDER / split).glob("*.safetensors")):
        with safe_open(path, "np") as shard:
            names = json.loads(shard.metadata()["class_name"])
            rows = zip(names, *(shard.get_tensor(key) for key in ("instance_seed", "patch", "token")), strict=True)
            for name, seed, patch, token in rows:
                if name and patch == 0 and len(tokens[name]) < SAMPLES_PER_CLASS:
                    tokens[name][int(seed)] = token
    incomplete = [name for name, of_class in tokens.items() if len(of_class) < SAMPLES_PER_CLASS]
    if incomplete:
        raise FileError(
            f"it lacks pieces of {', '.join(incomplete[:5])}.",
            where=str(PAIRS_FOLDER),
            remedy="Run tools/make_tactile_pairs.py.",
        )
    return {name: list(of_class.values()) for name, of_class in tokens.items()}


def make_samples(tokens: Mapping[str, Sequence[np.ndarray]]) -> list[SurfaceSample]:
    """Make samples with these tokens; appearance, name and height scale are drawn from the sample's index."""
    samples = []
    for name, class_tokens in tokens.items():
        for number, values in enumerate(class_tokens):
            rng = np.random.default_rng([derive_seed(name), number, 7])
            scaled = np.array(values)
            scaled[LEVELS] += np.float32(HEIGHT_SCATTER_DECADES * rng.standard_normal())
            token = Token(scaled, np.ones(len(scaled), dtype=bool))
            samples.append(SurfaceSample(name, _draw_appearance(name, rng), _draw_image_name(name, rng), token))
    return samples


def _draw_appearance(name: str, rng: np.random.Generator) -> Appearance:
    typical = get_material(name).appearance
    drawn = sample_appearance(typical, get_category(name), rng)
    return replace(typical, base_color=drawn.base_color, roughness=drawn.roughness, metallic=drawn.metallic)


def _draw_image_name(name: str, rng: np.random.Generator) -> str:
    kind, number = rng.integers(3), rng.integers(1, 99)
    class_words, related = get_material(name).words, CATEGORY_WORDS[get_category(name)].split()
    word = ("", class_words[rng.integers(len(class_words))], related[rng.integers(len(related))])[kind]
    return f"T_{word.title()}_{number:02d}_BaseColor.png"


def select_coarse_bands(token: Token) -> Token:
    """Return the token limited to the first COARSE_BANDS bands."""
    known = np.zeros_like(token.known)
    for band in range(COARSE_BANDS):
        known[band_slice(band)] = True
    return Token(token.values, known)


EVIDENCE = ("words", "look", "relief", "relief, 8–1 mm", "words and look", "all", "all, relief 8–1 mm")


def rank_sample(sample: SurfaceSample, evidence: str) -> tuple[Suggestion, ...]:
    use_all = evidence.startswith("all")
    token = select_coarse_bands(sample.token) if evidence.endswith("mm") else sample.token
    return rank(
        load_library(),
        sample.appearance if use_all or "look" in evidence else Appearance(),
        [""],
        image_names=[sample.image_name] if use_all or "words" in evidence else [],
        token=token if use_all or "relief" in evidence else None,
    )


def compute_hits(samples: Sequence[SurfaceSample], evidence: str) -> dict[str, float]:
    """Return the fractions of samples whose class and category rank first, and among the first three."""
    category = {material.name: material.category for material in load_library()}
    rows = []
    for sample in samples:
        order = [suggestion.name for suggestion in rank_sample(sample, evidence)]
        groups = list(dict.fromkeys(category[name] for name in order))
        true_category = category[sample.name]
        rows.append(
            [order[0] == sample.name, sample.name in order[:3], groups[0] == true_category, true_category in groups[:3]]
        )
    names = ("class@1", "class@3", "category@1", "category@3")
    return dict(zip(names, (float(share) for share in np.mean(rows, axis=0)), strict=True))


def compute_name_hits(names: dict[str, str]) -> dict[str, float]:
    """Return the same fractions of categories, for names alone."""
    category = {material.name: material.category for material in load_library()}
    first, in_first_three = 0, 0
    for name, expected in names.items():
        is_image = is_image_name(name)
        ranked = rank(load_library(), Appearance(), [""] if is_image else [name], image_names=[name] * is_image)
        is_conclusive = ranked[0].confidence - ranked[-1].confidence > 0.05
        groups = list(dict.fromkeys(category[suggestion.name] for suggestion in ranked)) if is_conclusive else []
        first += groups[:1] == [expected]
        in_first_three += expected in groups[:3]
    return {"names": len(names), "category@1": first / len(names), "category@3": in_first_three / len(names)}


def calibrate() -> dict[str, object]:
    """Return the scatter of the invariants within a class, and the best temper and doubt.

    The scatter is about the library's token. The best values maximise the mean log probability of the right class.
    """
    tokens = load_calibration_tokens()
    samples = make_samples(dict(zip(list_classes(), tokens, strict=True)))
    typical = np.stack([get_material(name).token for name in list_classes()])
    gap = ranking.compute_invariants(tokens.reshape(-1, tokens.shape[-1])) - np.repeat(
        ranking.compute_invariants(typical), len(CALIBRATION_SEEDS), axis=0
    )
    kinds = [*np.repeat(ranking.INVARIANT_KINDS, ranking.BAND_COUNT), *ranking.SHAPE_FEATURES]
    spread = {
        kind: float(np.sqrt(np.mean(gap[:, [other == kind for other in kinds]] ** 2))) for kind in dict.fromkeys(kinds)
    }
    ranking.WITHIN_CLASS_SPREAD.update(spread)
    scores = {}
    for ranking.RELIEF_TEMPER in TEMPERS:
        for ranking.RELIEF_DOUBT in DOUBTS:
            log_probabilities = [
                np.log(
                    next(
                        suggestion.probability
                        for suggestion in rank_sample(sample, evidence)
                        if suggestion.name == sample.name
                    )
                )
                for sample in samples
                for evidence in ("relief", "all", "all, relief 8–1 mm")
            ]
            scores[f"temper {ranking.RELIEF_TEMPER} doubt {ranking.RELIEF_DOUBT}"] = float(np.mean(log_probabilities))
    best = sorted(scores.items(), key=lambda item: -item[1])[:6]
    return {"within": spread, "log probability of the right class, best": dict(best)}


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--calibrate", action="store_true")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    if arguments.calibrate:
        print(json.dumps(calibrate(), indent=1))
        return 0
    samples = make_samples(load_held_out_tokens())
    rows = {evidence: compute_hits(samples, evidence) for evidence in EVIDENCE}
    names = {"names, tuned half": compute_name_hits(TUNED), "names, held back": compute_name_hits(HELD_BACK)}
    if arguments.json:
        print(json.dumps({"pieces": len(samples), **rows, **names}, indent=1))
        return 0
    print(f"{len(samples)} pieces of {len(list_classes())} classes; chance: 1/43 of classes, 1/12 of categories")
    for label, shares in rows.items():
        print(f"{label:<20}" + "  ".join(f"{name} {share:6.1%}" for name, share in shares.items()))
    for label, shares in names.items():
        print(f"{label:<20}" + "  ".join(f"{name} {share:6.3g}" for name, share in shares.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
