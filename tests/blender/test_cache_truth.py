"""Validity of caches: every input of a close-up invalidates it, and nothing else does.

Each change goes through the job that a window's bake is (bake_blocking), in an open file. Work is counted.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import pytest
from changes import UNFELT, add_picture, node, plate, write_picture
from closeup_builders import look
from shader_changes import FELT
from touch_scene import line_stroke, place_data, ridge_plate, save_scene, touch

from hnf_blender.bridge.stroke.read_stroke import list_strokes
from hnf_blender.compat import version
from hnf_blender.jobs import bake_job, job_runner
from hnf_blender.touch import bake_patches
from hnf_blender.touch import session as jobs
from hnf_blender.touch.bake_storage import hash_surface_source
from hnf_blender.touch.report import Counts
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY
from hnf_core.errors import SceneError
from hnf_core.progress import count_work

NOTHING = {"close_ups": 0, "renders": 0, "rays": 0, "network_calls": 0, "tokens": 0, "diffusion_calls": 0}
PIXELS = 64
worked_through = pytest.mark.skipif(
    version() < (5, 0, 0), reason="keys are compared on every Blender; that the work follows them, on one"
)


@dataclass(frozen=True)
class Work:
    """What a bake did. strokes: made anew."""

    strokes: tuple[str, ...]
    counts: Counts


@pytest.fixture(autouse=True)
def small_closeups(monkeypatch):
    """Close-ups of a few pixels: what they show is not asked here."""
    for module in (bake_patches, jobs):
        monkeypatch.setattr(module, "PATCH_PIXELS", PIXELS)


@pytest.fixture(scope="module")
def stored(stroke_properties, tmp_path_factory):
    """A folder: the scene as it is arranged first, baked, and its close-ups under "hnf"."""
    folder = tmp_path_factory.mktemp("stored")
    with pytest.MonkeyPatch.context() as patch:
        for module in (bake_patches, jobs):
            patch.setattr(module, "PATCH_PIXELS", PIXELS)
        place_data(patch, folder)
        bpy.ops.wm.read_factory_settings(use_empty=True)
        two_plates()
        bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    save_scene(folder / "scene.blend")
    return folder


@pytest.fixture
def job(stored, tmp_path, monkeypatch):
    """Opens the baked scene. Bakes what is open, and returns the Work that was done."""
    shutil.copytree(stored / "hnf", tmp_path / "hnf")
    bpy.ops.wm.open_mainfile(filepath=str(stored / "scene.blend"))
    place_data(monkeypatch, tmp_path)

    def run() -> Work:
        before = bakes()
        bpy.context.view_layer.update()
        with count_work() as work:
            ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
        assert ended.ok, ended
        after, counts = bakes(), Counts(**{kind: work.total(kind) for kind in NOTHING})
        return Work(tuple(sorted(name for name in after if after[name] != before.get(name))), counts)

    return run


def two_plates() -> None:
    surface, aside = ridge_plate(), ridge_plate(height=40e-6, name="Aside")
    aside.location.x = 1.0
    line_stroke("Along", surface=surface, length=0.008)
    line_stroke("Beside", surface=aside, length=0.008, centre=(1.0, 0.0, 0.0))


def bakes() -> dict[str, bytes]:
    return {obj.name: bytes(obj[BAKE_PROPERTY]) for obj in bpy.data.objects if BAKE_PROPERTY in obj}


def keys() -> dict[str, tuple[str, str]]:
    """Stroke → the key of its signal, and the name of what its tokens are measured from."""
    bpy.context.view_layer.update()
    session = job_runner.make_scene_session(bpy.context.scene, bpy.context.view_layer, Path())
    found = [session.make_curve_job(curve) for curve in list_strokes(bpy.context.scene)]
    surfaces = [session.get_facts(bpy.data.objects[each.object_name]) for each in found]
    return {each.name: (each.key, hash_surface_source(facts)) for each, facts in zip(found, surfaces, strict=True)}


@pytest.mark.parametrize("change", FELT.values(), ids=FELT)
def test_what_is_felt_is_in_the_key(tmp_path, change) -> None:
    two_plates()
    steps = change(tmp_path)
    next(steps)
    before = keys()
    assert list(steps) == []
    after = keys()
    assert after["Beside"] == before["Beside"]
    assert [new != old for new, old in zip(after["Along"], before["Along"], strict=True)] == [True, True]


@pytest.mark.parametrize("change", UNFELT.values(), ids=UNFELT)
def test_what_is_not_felt_is_in_no_key(tmp_path, change) -> None:
    two_plates()
    steps = change(tmp_path)
    next(steps)
    before = keys()
    assert list(steps) == []
    assert keys() == before


@worked_through
@pytest.mark.parametrize("change", FELT.values(), ids=FELT)
def test_what_is_felt_is_made_anew_and_nothing_else(job, tmp_path, change) -> None:
    steps = change(tmp_path)
    next(steps)
    job()
    assert list(steps) == []
    done = job()
    assert done.strokes == ("Along",)
    assert done.counts.close_ups == done.counts.tokens == done.counts.network_calls == 1
    assert done.counts.renders == 2  # one is the small view that chooses the sampling
    assert job() == Work((), Counts())


@worked_through
@pytest.mark.parametrize("change", UNFELT.values(), ids=UNFELT)
def test_what_is_not_felt_costs_nothing(job, tmp_path, change) -> None:
    steps = change(tmp_path)
    next(steps)
    job()
    assert list(steps) == []
    assert job() == Work((), Counts())


def heights(*changes) -> list[np.ndarray]:
    """The plate's height in a close-up, first as it is, then after each change."""
    found = [look(plate()).height]
    for change in changes:
        change()
        found.append(look(plate()).height)
    return found


@pytest.mark.parametrize("name", ["colour_of_the_object", "property_of_the_object", "property_of_the_scene"])
def test_what_a_shader_reads_of_its_object_reaches_the_close_up(tmp_path, name) -> None:
    """Where the shader looks at the world too, and where it does not."""
    ridge_plate()
    steps = FELT[name](tmp_path)
    next(steps)
    reader = node("ShaderNodeAttribute") if "property" in name else node("ShaderNodeObjectInfo")
    ridges = node("ShaderNodeBump").inputs["Height"].links[0].from_node
    scaled = plate().data.materials[0].node_tree.nodes.new("ShaderNodeMath")
    scaled.operation = "MULTIPLY"
    links = scaled.id_data.links
    links.new(ridges.inputs[0].links[0].from_socket, scaled.inputs[0])
    links.new(reader.outputs["Fac" if "property" in name else "Color"], scaled.inputs[1])
    links.new(scaled.outputs[0], ridges.inputs[0])
    before, after = heights(lambda: list(steps))
    assert np.ptp(before) > 0.0
    factor = {"colour_of_the_object": 0.5, "property_of_the_object": 1.2, "property_of_the_scene": 1.2}[name]
    assert np.ptp(after) == pytest.approx(factor * np.ptp(before), rel=0.02)


def test_a_sequence_is_seen_at_the_scenes_frame(tmp_path) -> None:
    """As Blender itself counts: the frame's own file, and no other, changes what is seen."""
    ridge_plate()
    for number in (1, 2, 3):
        write_picture(tmp_path / f"worn_{number:04d}.bmp", 0.2 * number)
    first = add_picture(tmp_path / "worn_0001.bmp", "SEQUENCE", frame_duration=3, frame_offset=1, use_auto_refresh=True)
    bpy.context.scene.frame_set(2)
    shown, other, same = heights(
        lambda: write_picture(tmp_path / "worn_0003.bmp", 0.9), lambda: write_picture(tmp_path / "worn_0002.bmp", 0.9)
    )
    assert first.image.source == "SEQUENCE"
    assert not np.array_equal(shown, other)
    assert np.array_equal(other, same)


def test_an_animated_relief_is_seen_at_the_scenes_frame(tmp_path) -> None:
    ridge_plate()
    bump = node("ShaderNodeBump").inputs["Strength"]
    for frame in (1, 11):
        bump.default_value = 0.1 * (frame - 1)
        bump.keyframe_insert("default_value", frame=frame)
    bpy.context.scene.frame_set(11)
    whole, none = heights(lambda: bpy.context.scene.frame_set(1))
    assert np.ptp(whole) == pytest.approx(60e-6, rel=0.05)
    assert none is None


def test_the_unit_scale_is_noticed_on_every_surface(job) -> None:
    bpy.context.scene.unit_settings.scale_length = 0.5
    done = job()
    assert done.strokes == ("Along", "Beside")
    assert (done.counts.close_ups, done.counts.renders) == (2, 4)


@worked_through
def test_the_working_space_is_noticed_on_every_surface(job) -> None:
    """What grey a colour is, and what a picture's values become, depends on it."""
    set_space = bpy.ops.wm.set_working_color_space
    bump, links = node("ShaderNodeBump"), node("ShaderNodeBump").id_data.links
    checks, grey = links.id_data.nodes.new("ShaderNodeTexChecker"), links.id_data.nodes.new("ShaderNodeRGBToBW")
    checks.inputs["Color1"].default_value = (0.9, 0.1, 0.1, 1.0)
    links.new(node("ShaderNodeUVMap").outputs[0], checks.inputs["Vector"])
    links.new(checks.outputs["Color"], grey.inputs[0])
    links.new(grey.outputs[0], bump.inputs["Height"])
    job()
    before = look(plate()).height
    set_space(working_space="Linear Rec.2020", convert_colors=False)
    done = job()
    assert done.strokes == ("Along", "Beside")
    assert (done.counts.close_ups, done.counts.renders) == (2, 4)
    assert not np.array_equal(look(plate()).height, before)
    set_space(working_space="Linear Rec.709", convert_colors=False)
    assert job().counts.renders == 0


def test_equal_surfaces_share_a_close_up(job) -> None:
    """The store knows content, not objects."""
    node("ShaderNodeBump").inputs["Distance"].default_value = 2e-3
    bpy.data.objects["Aside"].data.materials[0] = plate().data.materials[0]
    done = job()
    assert done.strokes == ("Along", "Beside")
    assert (done.counts.close_ups, done.counts.renders, done.counts.tokens) == (1, 2, 1)


def test_notes_say_the_names_of_now(job, tmp_path) -> None:
    """A picture of slopes that is not marked as data is noted by its name. A rename alone asks for no new bake."""
    made = plate().data.materials[0].node_tree.nodes.new("ShaderNodeNormalMap")
    picture = add_picture(write_picture(tmp_path / "worn.bmp", 0.2))
    links, shader = made.id_data.links, made.id_data.nodes["Principled BSDF"]
    links.new(picture.outputs[0], made.inputs["Color"])
    links.new(made.outputs[0], shader.inputs["Normal"])
    picture.image.colorspace_settings.name = "sRGB"
    for roughness, name in ((0.4, "old name"), (0.6, "new name")):
        shader.inputs["Roughness"].default_value, picture.image.name = roughness, name
        ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
        assert [f"'{name}'" in each for each in ended.details if "tagged sRGB" in each] == [True]


def test_a_texture_that_is_not_saved_is_refused_by_name(job, tmp_path) -> None:
    """A render would read the file, and Blender would forget the painting."""
    image = add_picture(write_picture(tmp_path / "worn.bmp", 0.2)).image
    job()
    image.pixels[0] = 0.9
    kept = bakes()
    ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    assert not ended.ok
    assert "'worn.bmp' was painted and is not saved" in ended.message
    assert image.is_dirty
    assert image.pixels[0] == pytest.approx(0.9, abs=0.01)
    assert bakes() == kept


@pytest.mark.parametrize("packed", [False, True])
def test_a_window_says_at_once_that_a_texture_is_not_saved(job, tmp_path, packed) -> None:
    """Its child works on a copy of the file, and no copy holds what was painted."""
    image = add_picture(write_picture(tmp_path / "worn.bmp", 0.2)).image
    if packed:
        image.pack()
    bpy.data.objects["Along"].hnf_stroke.surface = plate()
    image.pixels[0] = 0.9
    with pytest.raises(SceneError, match=r"worn\.bmp.*painted"):
        bake_job.BakeJob(bpy.context.scene, bpy.context.view_layer)


def test_a_changed_library_is_noticed_when_the_file_is_opened(job, tmp_path) -> None:
    for name in ("Along", "Beside", "Aside"):
        bpy.data.objects.remove(bpy.data.objects[name])
    library = save_scene(tmp_path / "library.blend")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, wanted):
        wanted.objects = ["Plate"]
    bpy.context.scene.collection.objects.link(wanted.objects[0])
    line_stroke("Along", surface=wanted.objects[0], length=0.008)
    scene = save_scene(tmp_path / "scene.blend")
    first = touched_patches(scene, tmp_path / "out")
    assert touched_patches(scene, tmp_path / "out") == NOTHING
    bpy.ops.wm.open_mainfile(filepath=str(library))
    node("ShaderNodeBump").inputs["Strength"].default_value = 0.5
    save_scene(library)
    assert touched_patches(scene, tmp_path / "out") == first


def touched_patches(scene: Path, out: Path) -> dict:
    """Counts of a look at one place, by the command line."""
    code, report = touch(scene, out, "--at", "Plate:0.001,0.001")
    assert code == 0
    return report["counts"]


ANOTHER_PROCESS = """
import sys
sys.path[:0] = [{root!r}, {tests!r}]
import bpy
from hnf_blender import props
props.register()
from hnf_blender.jobs import bake_job
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY
from hnf_blender.touch import bake_patches, session
from hnf_core.progress import count_work
bake_patches.PATCH_PIXELS = session.PATCH_PIXELS = {pixels}
bpy.ops.wm.open_mainfile(filepath={scene!r})
for lost in (False, True):
    if lost:
        for name in ("Along", "Beside"):
            del bpy.data.objects[name][BAKE_PROPERTY]
    with count_work() as work:
        ended = bake_job.bake_blocking(bpy.context.scene, bpy.context.view_layer)
    print("RESULT", ended.ok, ended.written > 0, work.total("renders"), work.total("network_calls"), flush=True)
"""


@worked_through
def test_another_process_or_file_name_keeps_the_cache_valid(job, stored, tmp_path) -> None:
    """What is baked is found in the file; and where the file has lost it, its close-ups are found in the store."""
    scene = shutil.copy(stored / "scene.blend", tmp_path / "renamed.blend")
    root = Path(bake_job.__file__).parents[2]
    code = ANOTHER_PROCESS.format(root=str(root), tests=str(Path(__file__).parent), pixels=PIXELS, scene=str(scene))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True)
    results = [line for line in done.stdout.splitlines() if line.startswith("RESULT")]
    assert results == ["RESULT True False 0 0", "RESULT True True 0 2"]
