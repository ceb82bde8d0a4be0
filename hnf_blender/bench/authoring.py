"""How long Blender waits for us when a stroke is made: drawn by hand, or a ready one placed."""

from __future__ import annotations

from functools import partial

import numpy as np

from hnf_core.action.pen_stroke import PenSamples, PenStyle
from hnf_core.action.primitives import PRIMITIVES
from hnf_core.bench.frame import BenchOptions, Row, Times

from .needs import require_bpy
from .stage import PLATE_CUTS, QUICK_PLATE_CUTS, add_plate_with_strokes, open_test_file

AUTHORING_NAME = "authoring"
SCRIBBLE_S, QUICK_SCRIBBLE_S = 10.0, 1.0
EVENTS_HZ = 100.0
PIXEL_M = 0.3e-3
"""What a hand draws comes in steps of the screen."""
PRIMITIVE = next(iter(PRIMITIVES))


def measure_authoring(options: BenchOptions) -> list[Row]:
    """One row for each way to make a stroke. Raises HnfError without bpy. Empties the file that is open."""
    require_bpy(AUTHORING_NAME)
    from ..bridge.drawn_stroke import create_drawn_stroke
    from ..bridge.placement import place_primitive

    seconds = QUICK_SCRIBBLE_S if options.quick else SCRIBBLE_S
    samples, drawn, placed, knots = make_scribble(seconds), Times(), Times(), 0
    with open_test_file() as (scene, layer):
        plate = add_plate_with_strokes(QUICK_PLATE_CUTS if options.quick else PLATE_CUTS)
        for repeat in range(options.repeats):
            options.watch(f"{AUTHORING_NAME}: {repeat + 1} of {options.repeats}")
            depsgraph = layer.depsgraph
            draw = partial(create_drawn_stroke, scene, depsgraph, plate, samples, PenStyle())
            made = drawn.measure(partial(draw, start_frame=1.0, probe="pen", metres_per_unit=1.0))
            knots = len(made.pen_stroke.path.knot)
            placed.measure(partial(place_primitive, scene, plate, None, PRIMITIVE, 1.0, depsgraph))
            layer.update()
    return [
        Row(
            AUTHORING_NAME,
            f"draw {seconds:g} s",
            drawn.seconds,
            drawn.cpu,
            note=f"{len(samples.time)} samples → {knots} knots",
        ),
        Row(AUTHORING_NAME, f"place {PRIMITIVE}", placed.seconds, placed.cpu),
    ]


def make_scribble(seconds: float) -> PenSamples:
    """A hand's loops over 6 cm of the plane z = 0, as a pen tells of them."""
    time = np.arange(round(seconds * EVENTS_HZ)) / EVENTS_HZ
    turn = 2.0 * np.pi * time
    x = 0.02 * np.sin(0.7 * turn) + 0.01 * np.sin(1.3 * turn + 1.0)
    point = np.stack([x, 0.02 * np.cos(0.9 * turn), np.zeros_like(time)], axis=1)
    pressure = 0.5 + 0.2 * np.sin(0.5 * turn)
    return PenSamples(time, np.round(point / PIXEL_M) * PIXEL_M, pressure, np.ones(len(time), dtype=bool))
