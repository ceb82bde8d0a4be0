"""`hnf eval tactile-map`: compare predicted tactile maps with true ones and with simple baselines."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from hnf_core.errors import UsageError
from hnf_core.progress import Progress, ProgressBar

PAIRS = Path("build/tactile-pairs")


def add_parser(subjects: Any) -> None:
    parser = subjects.add_parser(
        "tactile-map",
        help="predicted tactile maps, as pictures and by the vibration that follows",
        description="Predict the tactile maps of pieces and of whole classes that D_φ was not trained on, and compare "
        "pictures, slopes and expected vibration with those of the true maps, beside simpler guesses. Takes a quarter "
        "of an hour on two cores; --quick takes a minute, proves that it runs and nothing else.",
    )
    parser.add_argument(
        "--data", type=Path, metavar="DIR",
        help=f"training pairs for the simpler guesses (default {PAIRS} where it is; else a few are made)",
    )  # fmt: skip
    parser.add_argument("--weights", type=Path, metavar="FILE", help="of D_φ (default: the shipped ones)")
    parser.add_argument(
        "--beside", type=Path, metavar="FILE", help="of another D_φ to compare it with, see hnf train tactile-map"
    )
    parser.add_argument(
        "--touch", type=Path, nargs="+", metavar="FILE",
        help="instead: touch these scenes and photographs by hnf touch with --weights (default: regression) and with "
        "--beside (default: diffusion), and compare what is felt; needs bpy",
    )  # fmt: skip
    parser.add_argument(
        "--width", type=float, default=68.3, metavar="MM", help="of what photographs of --touch show (default 68.3)"
    )
    parser.add_argument("--quick", action="store_true", help="a handful of tiles made on the fly, few steps")
    parser.add_argument("--tiles", type=int, metavar="N", help="of new pieces, and of new classes")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="keep tiles and predictions here for the next run")
    parser.add_argument("--pictures", type=Path, metavar="DIR", help="folder to draw pictures into")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of noise and intervals, and of the pairs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises HnfError; returns the exit code."""
    if arguments.seed < 0 or (arguments.tiles is not None and arguments.tiles < 2):
        raise UsageError("--seed must be at least 0, --tiles 2.")
    if arguments.touch is not None:
        return _run_touch(arguments)
    from dataclasses import replace

    from hnf_core.tactile.unet import load_map_weights

    from ..evaluation.tactile_map.report import format_map_report, report_to_json, write_plots
    from ..evaluation.tactile_map.run import QUICK_SIZES, MapSetup, MapSizes, measure_maps

    weights = load_map_weights(arguments.weights)
    beside = None if arguments.beside is None else load_map_weights(arguments.beside)
    data = arguments.data
    if data is None and not arguments.quick and PAIRS.is_dir():
        data = PAIRS
    sizes = QUICK_SIZES if arguments.quick else MapSizes()
    if arguments.tiles is not None:
        fewer = {name: min(getattr(sizes, name), arguments.tiles) for name in ("varied", "all_pitches", "curve")}
        sizes = replace(sizes, instances=arguments.tiles, classes=arguments.tiles, **fewer)
    setup = MapSetup(weights, beside, data, sizes, arguments.seed, arguments.cache)
    bar = ProgressBar()
    try:
        measured = measure_maps(setup, lambda what, done, total: bar.show(Progress(what, done, total)))
    finally:
        bar.close()
    if arguments.pictures is not None:
        write_plots(arguments.pictures, setup, measured)
    print(
        json.dumps(report_to_json(setup, measured), indent=1) if arguments.json else format_map_report(setup, measured)
    )
    return 0


def _run_touch(arguments: argparse.Namespace) -> int:
    if not 1.0 <= arguments.width <= 10_000.0:
        raise UsageError(f"--width {arguments.width:g}.", remedy="Give 1 to 10000 millimeters.")
    from hnf_core.tactile.unet import DIFFUSION, REGRESSION
    from hnf_core.units import mm_to_m

    from ..evaluation.tactile_map.end_to_end import compare_networks, format_networks, networks_to_json

    networks = [str(arguments.weights or REGRESSION), str(arguments.beside or DIFFUSION)]
    bar = ProgressBar()
    try:
        rows = compare_networks(arguments.touch, networks, side_m=mm_to_m(arguments.width), progress=bar.show)
    finally:
        bar.close()
    print(json.dumps(networks_to_json(rows), indent=1) if arguments.json else format_networks(rows))
    return 0
