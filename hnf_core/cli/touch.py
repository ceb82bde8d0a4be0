"""`hnf touch`: options of the command that computes strokes on a scene, parsed into a `TouchRequest`.

The request is carried out by hnf_blender.touch.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..action.parse_stroke import parse_stroke
from ..action.primitives import PRIMITIVES
from ..errors import UsageError
from ..touch_request import MaterialChoice, StrokeRequest, TouchRequest, parse_touch_query
from .commands import HELP, parse_seed


def add_parser(verbs: Any) -> argparse.ArgumentParser:
    """Add `hnf touch`."""
    parser: argparse.ArgumentParser = verbs.add_parser(
        "touch",
        help=HELP["touch"],
        description="Open SCENE (.blend .gltf .glb .obj .ply .usd .usda .usdc .usdz .fbx .stl .dae, or the .json of "
        "nerfstudio), find or place strokes, and write one WAV and one picture per stroke, the baked .blend and "
        "report.json to DIR. With no stroke in the scene or on the command line, one default stroke is placed on every "
        "touchable material.",
    )
    parser.add_argument(
        "scene",
        nargs="?",
        type=Path,
        metavar="SCENE",
        help="scene file; may be left out inside Blender, for the open file",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        help="folder for the results; with --plan: of an earlier run, to say what is fresh",
    )
    parser.add_argument(
        "--stroke", action="append", default=[], metavar="WORDS", type=parse_stroke, dest="strokes",
        help=f"place a stroke: {', '.join(PRIMITIVES)}; or in words: 'scrape right to left, 1.5 N, 80 mm/s', "
        "'tap twice, then rub slowly in circles'. Needs --on. Strokes drawn in the scene are computed too",
    )  # fmt: skip
    parser.add_argument(
        "--on", action="append", default=[], metavar="OBJECT[:SLOT]", dest="targets",
        help="where to place the stroke named before it; SLOT is a material's name or its number from 0",
    )  # fmt: skip
    parser.add_argument(
        "--material", action="append", default=[], metavar="OBJECT[:SLOT]=NAME|FILE", dest="materials",
        help="use this material there: of the library (see: hnf materials), of a .hnf file, or of the .safetensors "
        "weights that hnf train field wrote",
    )  # fmt: skip
    parser.add_argument(
        "--at", action="append", default=[], metavar="OBJECT:u,v", type=parse_touch_query, dest="queries",
        help="say what is felt at this place of the surface: tactile map, roughness, friction, nearest materials; "
        "without --stroke nothing else is done. Or OBJECT:x,y,z in the object's own coordinates",
    )  # fmt: skip
    parser.add_argument("--probe", type=_refuse_former_query, help=argparse.SUPPRESS)
    parser.add_argument(
        "--encoder", default="", metavar="NAME|FILE",
        help="the encoder that describes tactile maps: band-descriptor-1, alexnet-bands-1, or a file written by "
        "hnf train encoder; default: band-descriptor-1",
    )  # fmt: skip
    parser.add_argument(
        "--sensor", choices=("gelsight", "digit"), default="gelsight",
        help="the touch sensor that tactile maps are images of (default gelsight)",
    )  # fmt: skip
    parser.add_argument(
        "--tactile-map", default="", metavar="NETWORK",
        help="the network that predicts tactile maps from pictures: regression (default), diffusion, or a file written "
        "by hnf train tactile-map",
    )  # fmt: skip
    parser.add_argument(
        "--height-as-authored", action="store_true",
        help="keep every relief's height, also where no surface is known to be so high; else its shape gets the height "
        "of the material",
    )  # fmt: skip
    parser.add_argument(
        "--no-pictures", action="store_false", dest="pictures",
        help="draw no pictures of the strokes: sound, report and .blend alone, sooner",
    )  # fmt: skip
    parser.add_argument("--scale", type=float, metavar="METERS_PER_UNIT", help="length of one scene unit in meters")
    parser.add_argument("--seed", type=parse_seed, metavar="N", help="seed of all strokes; default: each stroke's own")
    parser.add_argument("--plan", action="store_true", help="say what would be done, skipped and why; write nothing")
    parser.add_argument("--json", action="store_true", help="print the report (or the plan) as JSON")
    return parser


def make_touch_request(arguments: argparse.Namespace) -> TouchRequest:
    """Convert parsed options to a request. Raises UsageError if they contradict each other."""
    if len(arguments.strokes) != len(arguments.targets):
        raise UsageError(
            f"{len(arguments.strokes)} --stroke but {len(arguments.targets)} --on.",
            remedy="Say where each stroke goes: --stroke WORDS --on OBJECT[:SLOT]. The names there are: --plan"
            if len(arguments.strokes) > len(arguments.targets)
            else "Say which stroke goes there: --stroke WORDS --on OBJECT[:SLOT], for example --stroke rub-slow",
        )
    if arguments.scale is not None and not 0.0 < arguments.scale < float("inf"):
        raise UsageError("--scale must be a positive number of meters per unit.", remedy="Example: --scale 0.01")
    request = TouchRequest(
        scene=arguments.scene,
        out=arguments.out,
        strokes=tuple(StrokeRequest(p, t) for p, t in zip(arguments.strokes, arguments.targets, strict=True)),
        choices=tuple(_parse_material_choice(text) for text in arguments.materials),
        metres_per_unit=arguments.scale,
        seed=arguments.seed,
        plan_only=arguments.plan,
        as_json=arguments.json,
        queries=tuple(arguments.queries),
        encoder=arguments.encoder,
        height_as_authored=arguments.height_as_authored,
        sensor=arguments.sensor,
        tactile_map=arguments.tactile_map,
        pictures=arguments.pictures,
    )
    if not request.plan_only:
        request.folder  # raises before Blender starts if it is invalid  # noqa: B018
    return request


def _refuse_former_query(text: str) -> None:
    """Raise a UsageError for the former meaning of --probe, which names its replacement --at."""
    raise UsageError(
        "--probe names the tip that touches, and a scene's strokes have their own.",
        remedy=f"To ask about one place: --at {text if ':' in text else 'OBJECT:u,v'}",
    )


def _parse_material_choice(text: str) -> MaterialChoice:
    target, equals, material = text.rpartition("=")
    if not equals or not target or not material:
        raise UsageError(
            f"--material {text!r} is not OBJECT[:SLOT]=NAME|FILE.", remedy="Example: --material Cup=oak-wood"
        )
    return MaterialChoice(target, material)
