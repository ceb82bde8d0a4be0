"""Compare the available token encoders E and print the tables of docs/encoder.md.

  Usage: python -m hnf_lab.experiments.encoders [--pairs DIR] [--encoder NAME|FILE …] [--seed N] [--json FILE]

Needs the pairs of tools/make_tactile_pairs.py (splits held-out-instances and held-out-classes).
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.datasets.tactile_pairs import (
    HELD_OUT_CLASSES,
    HELD_OUT_INSTANCES,
    UNSEEN_CLASSES,
    Pairs,
    decode_rgb,
    load_pairs,
)
from hnf_core.field.weights import load_field
from hnf_core.files import write_text
from hnf_core.material.band_descriptor import describe
from hnf_core.material.encoder_registry import Encoder, describe_views, get_encoder
from hnf_core.material.token import BAND_WAVELENGTHS_M, ENCODER_NAMES, Token
from hnf_core.simulation.material_classes import list_classes
from hnf_core.tactile.diffusion import predict_tactile_maps
from hnf_core.tactile.unet import MapWeights, load_map_weights
from hnf_core.tactile.views import AppearanceView
from hnf_lab import ROOT

from ..encoder.evaluate import (
    NEAR_VIEWS,
    NOISE_LEVELS,
    SensorView,
    SurfaceSample,
    TokenErrors,
    compute_neighbour_distance,
    compute_signal_distances_db,
    compute_stability,
    compute_token_errors,
    describe_samples,
    evaluate_encoder,
    make_sample,
    make_view_map,
    render_maps,
)

INSTANCE_SEED = 900
"""Seed of the instances measured here; the pairs use other seeds."""
SHIFTS_PX = (1, 2, 4)
LAMP_SEEDS = (1, 2)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=Path, default=ROOT / "build" / "tactile-pairs")
    parser.add_argument("--encoder", nargs="+", default=list(ENCODER_NAMES), metavar="NAME|FILE")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--maps", type=Path, metavar="FILE", help="weights of D_φ: describe what it predicts, too")
    parser.add_argument("--predicted", type=int, default=48, metavar="N", help="tiles of each split to predict")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="one of N views and classes only")
    arguments = parser.parse_args()
    encoders = [get_encoder(name) for name in arguments.encoder]
    figures: dict[str, Any] = {}
    for split in (HELD_OUT_INSTANCES, HELD_OUT_CLASSES):
        pairs = load_pairs(arguments.pairs, split)
        figures[split] = {each.name: measure_views(each, pairs, arguments.every) for each in encoders}
        if arguments.maps:
            predicted = measure_predicted(encoders, load_map_weights(arguments.maps), pairs, arguments.predicted)
            for name, found in predicted.items():
                figures[split][name]["predicted, widest and finest"] = found
        print(format_views(split, figures[split]), flush=True)
    pieces = [make_sample(name, INSTANCE_SEED) for name in list_classes()[:: arguments.every]]
    figures["steadiness"] = {encoder.name: measure_stability(encoder, pieces) for encoder in encoders}
    print(format_stability(figures["steadiness"]), flush=True)
    figures["signal"] = measure_signals(encoders, pieces, arguments.seed)
    print(format_signals(figures["signal"]), flush=True)
    if arguments.json:
        write_text(arguments.json, json.dumps(figures, indent=1, default=np.ndarray.tolist) + "\n")
    return 0


def measure_views(encoder: Encoder, pairs: Pairs, every: int) -> dict[str, Any]:
    """Measure errors of single views under both sensors, and of a tile's merged views."""
    # A random choice, since views of one pitch are at equal intervals.
    rows = np.sort(np.random.default_rng(0).permutation(len(pairs))[: len(pairs) // every])
    tiles = np.unique(pairs.tile_index)[::every]
    merged = [
        describe_views(
            encoder, [make_view_map(pairs, int(row), "gelsight") for row in np.flatnonzero(pairs.tile_index == tile)]
        )
        for tile in tiles
    ]
    merged_errors = compute_token_errors(
        np.array([token.values for token in merged], dtype=np.float64),
        np.array([token.known for token in merged]),
        pairs.token[tiles].astype(np.float64),
    )
    return {
        "one view, GelSight": asdict(evaluate_encoder(encoder, pairs, list(rows), "gelsight")),
        "one view, DIGIT": asdict(evaluate_encoder(encoder, pairs, list(rows), "digit")),
        "four views merged": asdict(merged_errors),
    }


def measure_predicted(encoders: list[Encoder], weights: MapWeights, pairs: Pairs, count: int) -> dict[str, Any]:
    """Measure errors of tokens from maps that D_φ predicts: a tile's widest and finest views, merged."""
    tiles = np.unique(pairs.tile_index)
    tiles = tiles[:: max(1, len(tiles) // count)][:count]
    tokens: dict[str, list[Token]] = {encoder.name: [] for encoder in encoders}
    for tile in tiles:
        rows = [int(row) for row in np.flatnonzero(pairs.tile_index == tile) if pairs.pitch_index[row] in (0, 3)]
        views = [
            AppearanceView(
                decode_rgb(pairs.rgb[row]),
                pairs.depth[row].astype(np.float32) * np.float32(pairs.pitch_m[row]),
                True,
                float(pairs.pitch_m[row]),
            )
            for row in rows
        ]
        maps = predict_tactile_maps(weights, views, "gelsight", seed=int(tile))
        for encoder in encoders:
            tokens[encoder.name].append(describe_views(encoder, maps))
    expected = pairs.token[tiles].astype(np.float64)
    return {
        name: asdict(
            compute_token_errors(
                np.array([t.values for t in tokens_of_encoder], np.float64),
                np.array([t.known for t in tokens_of_encoder]),
                expected,
            )
        )
        for name, tokens_of_encoder in tokens.items()
    }


def format_views(split: str, figures: dict[str, dict[str, Any]]) -> str:
    heads = [f"{wavelength * 1e3:g} mm" for wavelength in BAND_WAVELENGTHS_M]
    lines = [
        f"### Against the whole tile: {split}",
        "",
        "| " + " | ".join(("seen", "make", *heads, "all", "median", "two-fold", "four-fold", "peak", "offset")) + " |",
        "|---" * (len(heads) + 8) + "|",
    ]
    for views in next(iter(figures.values())):
        for name, by_views in figures.items():
            errors = TokenErrors(**by_views[views])
            cells = [f"{value:.2f}" for value in errors.level_db]
            cells += [f"{errors.compute_overall_db():.2f}", f"{errors.median_level_db:.2f}"]
            cells += [
                f"{np.sqrt(np.nanmean(np.square(getattr(errors, key)))):.3f}"
                for key in ("two_fold", "four_fold", "peak", "offset")
            ]
            lines.append("| " + " | ".join((views, name, *cells)) + " |")
    return "\n".join(lines) + "\n"


def measure_stability(encoder: Encoder, samples: list[SurfaceSample]) -> dict[str, Any]:
    figures: dict[str, Any] = {}
    for near_views, label in ((0, "whole map"), (NEAR_VIEWS, f"1 + {NEAR_VIEWS} views")):
        base = SensorView(near_views=near_views)
        first = describe_samples(encoder, samples, base)
        figures[label] = {"nearest other material": [compute_neighbour_distance(first, samples), float("nan")]}
        for change, perturbations in make_perturbations(base).items():
            stabilities = [
                compute_stability(first, describe_samples(encoder, samples, perturbed)) for perturbed in perturbations
            ]
            figures[label][change] = [
                float(np.mean([f.token for f in stabilities])),
                float(np.mean([f.level_db for f in stabilities])),
            ]
    return figures


def make_perturbations(base: SensorView) -> dict[str, list[SensorView]]:
    # A pixel of the widest view covers eight pixels of the tile, a pixel of the finest view one.
    return {
        **{f"moved by {shift} px (0.{39 * shift:03d} mm)": [replace(base, shift_px=shift)] for shift in SHIFTS_PX},
        "other lamps": [replace(base, lamps=seed) for seed in LAMP_SEEDS],
        **{f"noise {noise:g}": [replace(base, noise=noise)] for noise in NOISE_LEVELS},
        "DIGIT for GelSight": [replace(base, sensor="digit")],
    }


def format_stability(figures: dict[str, dict[str, Any]]) -> str:
    lines = ["### How far a token moves", "", "| seen | change | " + " | ".join(figures) + " |"]
    lines.append("|---" * (2 + len(figures)) + "|")
    first = next(iter(figures.values()))
    for label, rows in first.items():
        for change in rows:
            cells = []
            for by_label in figures.values():
                token, level = by_label[label][change]
                cells.append(f"{token:.3f}" + ("" if np.isnan(level) else f" ({level:.2f} dB)"))
            lines.append("| " + " | ".join((label, change, *cells)) + " |")
    return "\n".join(lines) + "\n"


def measure_signals(encoders: list[Encoder], samples: list[SurfaceSample], seed: int) -> dict[str, Any]:
    field, action = load_field(), make_random_smooth_action(4.0, seed, speed_m_s=(0.05, 0.25), force_n=(0.5, 2.0))
    truth: dict[str, Token] = {sample.name: describe(render_maps(sample, SensorView())[0]) for sample in samples}
    names = {each.name: each.class_name for each in samples}
    figures: dict[str, Any] = {"unseen": [names[each.name] in UNSEEN_CLASSES for each in samples]}

    def add(words: str, token: Any) -> None:
        figures[words] = list(compute_signal_distances_db(field, action, samples, lambda each: truth[each.name], token))

    for encoder in encoders:
        for near, what in ((0, "whole map"), (NEAR_VIEWS, f"1 + {NEAR_VIEWS} views")):
            add(
                f"{encoder.name}, {what}",
                lambda each, e=encoder, n=near: describe_views(e, render_maps(each, SensorView(near_views=n))),
            )
    add(
        "another tile of the piece",
        lambda each: describe(render_maps(make_sample(each.class_name, INSTANCE_SEED, 1), SensorView())[0]),
    )
    add(
        "another piece of the class",
        lambda each: describe(render_maps(make_sample(each.class_name, INSTANCE_SEED + 1), SensorView())[0]),
    )
    return figures


def format_signals(figures: dict[str, Any]) -> str:
    unseen = np.array(figures["unseen"])
    lines = [
        "### What the signal makes of it",
        "",
        "| token from | median [dB] | 90 % below | worst | median, unseen classes |",
        "|---|---|---|---|---|",
    ]
    for label, values in figures.items():
        if label != "unseen":
            distances = np.array(values)
            cells = (np.median(distances), np.percentile(distances, 90), distances.max(), np.median(distances[unseen]))
            lines.append("| " + " | ".join((label, *(f"{value:.2f}" for value in cells))) + " |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
