"""Bad input: one clear line, exit code 1, the other strokes delivered, nothing that was saved harmed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest
from builders import add_mesh, add_plane, bump_material, datablock_names
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, set_keys, touch, touch_without_pictures

from hnf_blender.cli import main
from hnf_core.files import folder_lock

ROOT = Path(__file__).parents[2]
STROKES = 5
"""Of a run that is stopped after the first: the last is seconds away."""


def good_and_bad(tmp_path, spoil, run=touch_without_pictures) -> tuple[int, dict, Path]:
    """A good stroke on the plate beside a spoilt one; spoil makes the second. No stroke that fails has a picture."""
    ridge_plate()
    line_stroke("Good")
    spoil()
    code, report = run(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    return code, report, tmp_path / "out"


def hidden_object():
    add_plane("Veil", 0.1, z=0.5).hide_render = True
    line_stroke("Bad", centre=(0, 0, 0.5), surface=bpy.data.objects["Veil"])


def empty_mesh():
    nothing = add_mesh("Hollow", [(0, 0, 0.5)], [])
    line_stroke("Bad", centre=(0, 0, 0.5), surface=nothing)


def missing_texture():
    plane = add_plane("Photo", 0.1, z=0.5)
    material = bpy.data.materials.new("Printed")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    texture = nodes.new("ShaderNodeTexImage")
    image = bpy.data.images.new("lost", 4, 4)
    image.source, image.filepath = "FILE", "//nowhere/lost.png"
    texture.image = image
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    plane.data.materials.append(material)
    line_stroke("Bad", centre=(0, 0, 0.5), surface=plane)


def touches_nothing():
    line_stroke("Bad", centre=(0, 0, 2.0), surface=bpy.data.objects[PLATE])


def no_force():
    line_stroke("Bad", force=0.0)


def not_a_number():
    stroke = line_stroke("Bad")
    set_keys(stroke, "force", (5.0, 1.0))
    from hnf_blender import compat

    fcurve = next(f for f in compat.fcurves_of(stroke) if f.data_path.endswith("force"))
    fcurve.keyframe_points[2].co[1] = float("nan")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (hidden_object, ("Veil", "hidden", "Show it")),
        (empty_mesh, ("Hollow", "no faces")),
        (missing_texture, ("Photo", "Printed", "lost")),
        (touches_nothing, ("Bad", "touches nothing", PLATE)),
        (no_force, ("Bad", "force is 0")),
        (not_a_number, ("Bad", "not a number", "frame")),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_one_bad_stroke_does_not_lose_the_others(tmp_path, capsys, spoil, words) -> None:
    code, report, out = good_and_bad(tmp_path, spoil)
    assert code == 1
    assert [entry["name"] for entry in report["strokes"]] == ["Good"]
    assert (out / report["strokes"][0]["wav"]).is_file()
    assert [entry["stroke"] for entry in report["failed"]] == ["Bad"]
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hnf:")]
    assert len(errors) == 1
    for word in words:
        assert word in errors[0]


def spoilt(spoil):
    """A stroke over a fine grid that `spoil` ruins; the grid's modifiers have a UV map."""

    def add() -> None:
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=40, y_subdivisions=40, size=0.06, location=(0.0, 0.0, 0.5))
        grid = bpy.context.object
        grid.name = grid.data.name = "Ruin"
        grid.data.materials.append(bpy.data.materials.new("Clay"))
        spoil(grid)
        line_stroke("Bad", centre=(0, 0, 0.5), surface=grid)

    add.__name__ = getattr(spoil, "__name__", "")
    return add


def modified(kind: str, **settings):
    """Give the grid a modifier 'M'."""

    def spoil(grid) -> None:
        modifier = grid.modifiers.new("M", kind)
        for name, value in settings.items():
            setattr(modifier, name, value() if callable(value) else value)

    spoil.__name__ = kind.lower()
    return spoil


def add_cage():
    bpy.ops.mesh.primitive_cube_add(size=0.2, location=(0.0, 0.0, 0.9))
    return bpy.context.object


def add_faces(grid, extra_vertices, faces, first: bool = False) -> None:
    """Join more faces to the grid's own vertices, in front of its faces or behind."""
    own = [tuple(face.vertices) for face in grid.data.polygons]
    points = [tuple(vertex.co) for vertex in grid.data.vertices]
    material = grid.data.materials[0]
    mesh = bpy.data.meshes.new("Ruin")
    mesh.from_pydata([*points, *extra_vertices], [], [*faces, *own] if first else [*own, *faces])
    grid.data = mesh
    mesh.materials.append(material)


def add_fin(grid, column: int = 20, up: float = 0.004, first: bool = False) -> None:
    """A wall on one line of the grid's edges, across x."""
    count = 41
    line = [row * count + column for row in range(count)]
    tops = [(*grid.data.vertices[index].co[:2], up) for index in line]
    start = len(grid.data.vertices)
    walls = [(line[i], line[i + 1], start + i + 1, start + i) for i in range(count - 1)]
    add_faces(grid, tops, walls, first)


def add_inner_wall(grid) -> None:
    add_fin(grid, up=-0.004, first=True)


def double_faces(grid) -> None:
    add_faces(grid, [], [tuple(face.vertices) for face in grid.data.polygons][800:820])


def join_two_shells(grid) -> None:
    """A second sheet that shares the line of edges under the stroke, and nothing else."""
    count = 41
    line = [20 * count + column for column in range(count)]
    sides = [
        [(grid.data.vertices[i].co.x, grid.data.vertices[i].co.y + side, z) for i in line]
        for side, z in ((0.01, -0.01), (-0.01, -0.01))
    ]
    start = len(grid.data.vertices)
    walls = [
        (line[i], line[i + 1], start + side * count + i + 1, start + side * count + i)
        for side in (0, 1)
        for i in range(count - 1)
    ]
    add_faces(grid, [*sides[0], *sides[1]], walls)


def make_nan(grid) -> None:
    grid.data.vertices[5].co.z = float("nan")


def collapse_all(grid) -> None:
    for vertex in grid.data.vertices:
        vertex.co.y = 0.0


def collapse_few(grid) -> None:
    """Faces of the middle row without any width."""
    for vertex in grid.data.vertices:
        if abs(vertex.co.y) < 0.002:
            vertex.co.y = 0.0


def break_height(grid) -> None:
    material = grid.data.materials[0] = bump_material("Old")
    bump = next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBump")
    bump.inputs["Distance"].default_value = float("nan")


def bump_of_a_kilometre(grid) -> None:
    grid.data.materials[0] = bump_material("Old", wavelength=2e-3, height=1e3, distance=1e3)


def crags_of_a_kilometre(grid) -> None:
    modifier = grid.modifiers.new("M", "DISPLACE")
    modifier.texture = bpy.data.textures.new("Crags", "CLOUDS")
    modifier.texture.noise_scale, modifier.strength = 3e-3, 1e3


def nodes_without_a_geometry(grid) -> None:
    modifier = grid.modifiers.new("M", "NODES")
    modifier.node_group = bpy.data.node_groups.new("Empty", "GeometryNodeTree")


def nodes_with_an_error(grid) -> None:
    """A node that reads a file, as scans are brought in, and the file is gone."""
    modifier = grid.modifiers.new("M", "NODES")
    tree = modifier.node_group = bpy.data.node_groups.new("Reads", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    start, end, read, join = (
        tree.nodes.new(kind)
        for kind in ("NodeGroupInput", "NodeGroupOutput", "GeometryNodeImportSTL", "GeometryNodeJoinGeometry")
    )
    read.inputs[0].default_value = "/nowhere/gone.stl"
    tree.links.new(start.outputs[0], join.inputs[0])
    tree.links.new(read.outputs[0], join.inputs[0])
    tree.links.new(join.outputs[0], end.inputs[0])


FAILS = [
    (make_nan, ("'Ruin'", "vertex (number 5) is not a number", "validate()")),
    (modified("DISPLACE", strength=float("nan")), ("'Ruin'", "modifiers ('M')", "not a number", "Repair or remove")),
    (modified("MASK", vertex_group="none"), ("'Ruin'", "modifiers leave no face", "Repair or remove")),
    (nodes_without_a_geometry, ("'Ruin'", "modifiers leave no face", "Repair or remove")),
    (modified("DISPLACE", strength=1e3), ("'Bad'", "'Ruin' stays 500 m away", "Move the curve")),
    (collapse_all, ("'Ruin'", "none of its faces has any area", "Touch another")),
]
NOTED = [
    (add_fin, ("'Ruin'", "edges with more than two faces", "Non Manifold")),
    (add_inner_wall, ("'Ruin'", "edges with more than two faces", "Non Manifold")),
    (double_faces, ("'Ruin'", "edges with more than two faces", "Non Manifold")),
    (join_two_shells, ("'Ruin'", "edges with more than two faces", "Non Manifold")),
    (collapse_few, ("'Ruin'", "without area", "Degenerate Dissolve")),
    (break_height, ("'Old'", "'Ruin'", "height is not a number", "Check the Distance")),
    (bump_of_a_kilometre, ("'Old'", "'Ruin'", "more than any surface is known to have", "Height as Authored")),
    (crags_of_a_kilometre, ("'Ruin'", "m across", "Units")),
    (modified("BOOLEAN"), ("'Ruin'", "'M' fails (its object is missing)", "Repair or remove it")),
    (modified("HOOK"), ("'Ruin'", "'M' fails (its object is missing)", "Repair or remove it")),
    (modified("SURFACE_DEFORM", target=add_cage), ("'Ruin'", "'M' fails (it is not bound)", "Repair or remove it")),
    (modified("MESH_DEFORM", object=add_cage), ("'Ruin'", "'M' fails (it is not bound)", "Repair or remove it")),
    (modified("CORRECTIVE_SMOOTH", rest_source="BIND"), ("'Ruin'", "'M' fails (it is not bound)", "Repair or remove")),
    (modified("LAPLACIANDEFORM"), ("'Ruin'", "'M' fails (it is not bound)", "Repair or remove it")),
    (
        modified("MESH_CACHE", filepath="//gone.mdd"),
        ("'Ruin'", "'M' fails (its file //gone.mdd is", "Repair"),
    ),
    pytest.param(
        nodes_with_an_error,
        ("'Ruin'", "'M' fails (STL Import: Cannot open", "Repair or remove it"),
        marks=pytest.mark.skipif(
            not hasattr(bpy.types, "GeometryNodeImportSTL") or bpy.app.version < (5, 0, 0),
            reason="this Blender does not tell of errors in nodes",
        ),
    ),
]


def lines_about(report, capsys, word: str) -> list[str]:
    told = [line for line in capsys.readouterr().err.splitlines() if line.startswith(("hnf:", "note:"))]
    return [line for line in told if word in line]


@pytest.mark.parametrize(("spoil", "words"), FAILS, ids=lambda value: getattr(value, "__name__", ""))
def test_a_ruined_mesh_is_named_and_the_others_are_felt(tmp_path, capsys, spoil, words) -> None:
    code, report, _ = good_and_bad(tmp_path, spoilt(spoil))
    assert code == 1
    assert [entry["name"] for entry in report["strokes"]] == ["Good"]
    (line,) = lines_about(report, capsys, "'Ruin'")
    for word in words:
        assert word in line


@pytest.mark.parametrize(("spoil", "words"), NOTED, ids=lambda value: getattr(value, "__name__", ""))
def test_what_is_odd_about_a_mesh_is_said_in_one_line(tmp_path, capsys, spoil, words) -> None:
    """And both strokes are delivered, with their pictures."""
    code, report, _ = good_and_bad(tmp_path, spoilt(spoil), touch)
    assert code == 0
    assert {entry["name"] for entry in report["strokes"]} == {"Good", "Bad"}
    assert all(0.05 < entry["rms_m_s2"] < 20.0 for entry in report["strokes"])
    (line,) = lines_about(report, capsys, words[-2])
    for word in words:
        assert word in line


def test_only_bad_edges_under_the_stroke_are_said(tmp_path, capsys) -> None:
    """A fin 25 mm beside the path is no matter of it; strokes that meet it say one line between them."""
    code, report, _ = good_and_bad(tmp_path, spoilt(lambda grid: add_fin(grid, column=39)))
    assert code == 0
    assert not lines_about(report, capsys, "more than two faces")


def test_strokes_over_one_bad_mesh_share_the_line(tmp_path, capsys) -> None:
    spoilt(add_fin)()
    line_stroke("Other", centre=(0, 0.008, 0.5), surface=bpy.data.objects["Ruin"])
    code, report = touch(save_scene(tmp_path / "scene.blend"), tmp_path / "out")
    assert code == 0
    assert len(report["strokes"]) == 2
    assert len(lines_about(report, capsys, "more than two faces")) == 1


@pytest.mark.parametrize("content", [None, b"", b"not a blend file at all", b"BLENDER-v500 cut short"])
def test_a_scene_that_cannot_be_opened(tmp_path, capsys, content) -> None:
    scene = tmp_path / "broken.blend"
    if content is not None:
        scene.write_bytes(content)
    code, report = touch(scene, tmp_path / "out")
    assert code == 1
    assert report == {}
    assert "broken.blend" in capsys.readouterr().err.splitlines()[-1]


def test_unknown_names_are_answered_with_what_is_there(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    assert touch(scene, tmp_path / "a", "--stroke", "rub-slow", "--on", "Plat")[0] == 1
    assert f"'{PLATE}'" in capsys.readouterr().err
    assert touch(scene, tmp_path / "b", "--stroke", "rub-slow", "--on", f"{PLATE}:7")[0] == 1
    assert "Its slots: 0" in capsys.readouterr().err
    assert touch(scene, tmp_path / "c", "--material", f"{PLATE}=unobtainium")[0] == 1
    assert "unobtainium" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ("--stroke", "rub-slow"),
        ("--on", PLATE),
        ("--stroke", "juggle", "--on", PLATE),
        ("--scale", "-1"),
        ("--material", "x"),
    ],
)
def test_wrong_usage_is_exit_code_2(tmp_path, words) -> None:
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(tmp_path / "out"), *words]) == 2


def test_a_run_without_a_folder_is_asked_for_one(tmp_path, capsys) -> None:
    ridge_plate()
    assert main(["touch", str(save_scene(tmp_path / "scene.blend"))]) == 2
    assert "--out DIR" in capsys.readouterr().err


def test_an_output_folder_below_a_file(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    (tmp_path / "file").write_text("here first")
    assert touch(scene, tmp_path / "file" / "out")[0] == 1
    assert "--out" in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "here first"


def test_a_second_run_on_a_folder_in_use_leaves(tmp_path, capsys) -> None:
    ridge_plate()
    line_stroke("Good")
    scene = save_scene(tmp_path / "scene.blend")
    with folder_lock(tmp_path / "out"):
        assert touch(scene, tmp_path / "out")[0] == 1
    assert "another run" in capsys.readouterr().err
    assert touch(scene, tmp_path / "out")[0] == 0


def test_no_open_file_is_never_the_start_up_scene(tmp_path, capsys) -> None:
    bpy.ops.wm.read_factory_settings()
    assert main(["touch", "--out", str(tmp_path / "out")]) == 1
    assert "no file is open" in capsys.readouterr().err


def test_the_open_file_is_left_as_it_was(tmp_path) -> None:
    ridge_plate()
    line_stroke("Good")
    hidden_object()
    scene = save_scene(tmp_path / "scene.blend")
    bpy.ops.wm.open_mainfile(filepath=str(scene))
    before, saved = datablock_names(), scene.read_bytes()
    assert main(["touch", "--out", str(tmp_path / "out")]) == 1
    assert datablock_names() == before
    assert scene.read_bytes() == saved
    assert bpy.data.filepath == str(scene)


def test_a_failed_run_keeps_the_results_of_the_one_before(tmp_path) -> None:
    ridge_plate()
    line_stroke("Good")
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    _, report = touch(scene, out)
    wav = out / report["strokes"][0]["wav"]
    kept = wav.read_bytes()
    scene.write_bytes(b"damaged")
    assert touch(scene, out)[0] == 1
    assert wav.read_bytes() == kept
    assert touch(scene, out)[1]["strokes"] == report["strokes"]


def finished_in(out: Path) -> list[Path]:
    """WAVs that bear their names already; one in the making is hidden, and pathlib's * would find it."""
    return [path for path in out.glob("*.wav") if not path.name.startswith(".")]


def test_stopping_half_way_keeps_what_is_finished(tmp_path) -> None:
    ridge_plate()
    for number in range(STROKES):
        line_stroke(f"Scrape {number}", centre=(0, -0.04 + 0.01 * number, 0))
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    program = "import sys; from hnf_blender.cli import main; sys.exit(main())"
    run = subprocess.Popen(
        [sys.executable, "-c", program, "touch", str(scene), "--out", str(out), "--no-pictures"],
        cwd=ROOT, stderr=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    deadline = time.monotonic() + 120
    while not finished_in(out) and run.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does
    _, errors = run.communicate(timeout=120)
    assert run.returncode == 1, errors.decode()
    finished = finished_in(out)
    assert 1 <= len(finished) < STROKES
    code, report = touch_without_pictures(scene, out)
    assert code == 0
    assert sum(entry["fresh"] for entry in report["strokes"]) >= len(finished) - 1
    assert len(report["strokes"]) == STROKES
    assert not list(out.glob(".*.wav"))


@pytest.fixture
def small_disk(tmp_path):
    """A folder on a disk of its own, of one megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    made = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(folder)], capture_output=True)
    if made.returncode != 0:
        pytest.skip("may not mount a small disk here")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_full_disk_costs_nothing_that_is_saved(tmp_path, capsys, small_disk) -> None:
    ridge_plate()
    line_stroke("Good")
    scene = save_scene(tmp_path / "scene.blend")
    (small_disk / "good.wav").write_bytes(b"an earlier result")
    (small_disk / "filling").write_bytes(bytes(900 * 1024))
    assert touch(scene, small_disk)[0] == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hnf:")]
    assert errors
    assert "could not be written" in errors[0]
    assert "Free some disk space" in errors[0]
    assert (small_disk / "good.wav").read_bytes() == b"an earlier result"
    (small_disk / "filling").unlink()
    assert not [path for path in small_disk.rglob(".*") if path.name != ".hnf-lock"]


def test_a_file_is_no_folder_for_results(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    (tmp_path / "mine.wav").write_text("here first")
    assert touch(scene, tmp_path / "mine.wav")[0] == 1
    told = capsys.readouterr().err.splitlines()[-1]
    assert "mine.wav: is a file, and the results need a folder. Give --out a folder" in told
    assert (tmp_path / "mine.wav").read_text() == "here first"


def test_a_wrong_scene_is_told_before_blender_starts(tmp_path) -> None:
    (tmp_path / "rub.wav").write_bytes(b"RIFF")
    for name, said in (
        ("rub.wav", "a file of kind '.wav' is no scene. Give a scene: .blend"),
        ("gone.blend", "no such"),
    ):
        words = ["touch", str(tmp_path / name), "--out", str(tmp_path / "out")]
        program = (
            f"import sys; from hnf_blender.cli import main; code = main({words!r}); "
            "print('bpy' in sys.modules); sys.exit(code)"
        )
        run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True)
        assert (run.returncode, run.stdout) == (1, "False\n")
        assert said in run.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [(("--stroke", "rub-slow"), "Say where each stroke goes"), (("--on", PLATE), "Say which stroke goes there")],
)
def test_half_a_placement_is_told_its_other_half(tmp_path, capsys, words, said) -> None:
    assert main(["touch", str(tmp_path / "scene.blend"), "--out", str(tmp_path / "out"), *words]) == 2
    assert said in capsys.readouterr().err


def test_a_stroke_that_loses_its_surface_is_a_partial_failure(stroke_properties, tmp_path, capsys):
    ridge_plate()
    line_stroke("Good")
    line_stroke("Over the edge", centre=(0.068, 0.0, 0.0))
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    for _ in range(2):  # the second time everything is up to date
        code, report = touch(scene, out)
        shares = {stroke["name"]: stroke["off_surface"] for stroke in report["strokes"]}
        assert code == 1
        assert not report["failed"]
        assert shares["Good"] == 0.0
        assert 0.1 < shares["Over the edge"] < 0.6
        (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("hnf: ")]
        assert "'Over the edge'" in line
        assert f"{shares['Over the edge']:.0%}" in line
