"""A reconstruction in the window: dropped, looked at, given a length, stroked and felt."""

import bpy
import numpy as np
from drive.addon import baked, freshness
from drive.scenery import empty_room, look_at, stroke_on

SCREEN = "1280x800"
METRES = 0.125
HALF = np.array([0.24, 0.12, 0.04])
"""Of a slab in units of METRES: 60 × 30 × 10 mm."""
SIGMA = 0.008


def write_slab(path):
    """A box of flat Gaussians, striped along x."""
    centres, sizes = [], []
    for axis in range(3):
        others = [each for each in range(3) if each != axis]
        steps = [np.arange(-HALF[each] + SIGMA / 2, HALF[each], SIGMA) for each in others]
        grid = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
        for sign in (-1.0, 1.0):
            side = np.zeros((len(grid), 3))
            side[:, others], side[:, axis] = grid, sign * HALF[axis]
            size = np.full((len(grid), 3), SIGMA)
            size[:, axis] = SIGMA / 20.0
            centres.append(side)
            sizes.append(size)
    means = np.concatenate(centres)
    light = 0.5 + 0.3 * np.sign(np.sin(2.0 * np.pi * means[:, 0] / 0.1))
    colour = (light[:, None] * [1.0, 0.8, 0.5] - 0.5) / 0.28209479177387814
    turned = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    logit = np.full((len(means), 1), np.log(0.97 / 0.03))
    rows = np.hstack([means, np.zeros_like(means), colour, logit, np.log(np.concatenate(sizes)), turned])
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3)), "opacity"]
    names += [*(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    lines = ["ply", "format binary_little_endian 1.0", "comment Vertical Axis: z", f"element vertex {len(rows)}"]
    lines += [*(f"property float {name}" for name in names), "end_header", ""]
    path.write_bytes("\n".join(lines).encode() + rows.astype("<f4").tobytes())


def check_a_drop_asks_and_makes_a_surface(stage):
    empty_room()
    yield 0.5
    path = stage.folder / "slab.ply"
    write_slab(path)
    yield from stage.move(stage.middle())
    with stage.over():
        bpy.ops.wm.drop_import_file("INVOKE_DEFAULT", directory=str(path.parent), files=[{"name": path.name}])
    yield 0.6
    yield from stage.picture("which-of-two")
    yield from stage.key("G")
    yield from stage.until("the surface is there", lambda: "slab" in bpy.data.objects, 200.0)
    yield from look_at(stage, bpy.data.objects["slab"], top=False)
    stage.expect("with its splats", len(bpy.data.objects["slab splats"].data.vertices) > 1000)
    stage.expect("and faces", len(bpy.data.objects["slab"].data.polygons) > 1000)
    stage.area().spaces.active.shading.type = "MATERIAL"
    yield 2.0
    yield from stage.show_tab()
    yield from stage.picture("ellipsoids")


def check_two_points_and_a_length_make_it_metric(stage):
    """Two clicks on the surface itself; the dialog then holds the length."""
    surface = bpy.data.objects["slab"]
    yield from look_at(stage, surface)
    bpy.context.view_layer.objects.active = surface
    ends = [stage.seen_at((sign * 0.5 * HALF[0], 0.0, HALF[2])) for sign in (-1.0, 1.0)]
    with stage.over():
        bpy.ops.hnf.set_real_length("INVOKE_DEFAULT", length_m=HALF[0] * METRES)
    yield from stage.click(ends[0])
    yield from stage.move(ends[1])
    yield from stage.picture("second-point")
    yield from stage.click(ends[1])
    yield 0.5
    yield from stage.picture("real-length")
    yield from stage.key("RET", ends[1])
    yield 0.3
    found = bpy.context.scene.hnf.metres_per_unit
    stage.expect("one unit is so many metres", abs(found / METRES - 1.0) < 0.03, found)
    bpy.context.scene.hnf.metres_per_unit = METRES


def check_a_stroke_on_it_is_felt(stage):
    surface = bpy.data.objects["slab"]
    yield from look_at(stage, surface)
    stroke = stroke_on(surface, "On splats", length_m=0.2)
    for point in stroke.data.splines[0].points:
        point.co.z = HALF[2]
    bpy.context.view_layer.objects.active = stroke
    bpy.ops.ed.undo_push(message="prepared")
    yield from baked(stage)
    stage.expect("it is fresh", freshness("On splats") == "fresh", freshness("On splats"))
    tokens = bpy.data.objects["slab splats"].data.attributes.get("hnf_token")
    stage.require("splats have tokens", tokens is not None)
    values = np.zeros(len(tokens.data), dtype=np.int32)
    tokens.data.foreach_get("value", values)
    stage.expect("those that were touched, and no others", 0.0 < (values >= 0).mean() < 1.0, (values >= 0).mean())
    yield from stage.show_tab()
    yield from stage.picture("felt")
