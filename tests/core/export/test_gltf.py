"""GLB: glTF's own rules are kept; geometry, what was baked, and the signal come back as they were."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from glb_rules import check_gltf, chunks, read_accessor
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from touched_surfaces import palette, rough_tone, touched_sheet

from hnf_core.cli.main import main
from hnf_core.errors import FileError, SceneError, UsageError
from hnf_core.export.gltf import (
    build_vertex_table,
    compute_taxel_row_width,
    compute_taxel_uv,
    decode_glb,
    encode_png,
    encode_surface,
    find_distinct_rows,
    find_vertices_on_path,
    get_view_bytes,
    read_glb,
    write_glb,
)
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.export.touched_surface import UNTOUCHED, TouchedSurface
from hnf_core.export.wav import write_wav
from hnf_core.material.token import LEVELS
from hnf_core.scene.mesh import TriangleMesh

Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Blender ← glTF."""


@st.composite
def surfaces(draw) -> TouchedSurface:
    """Any triangles: degenerate, doubled, of any slot, normals of no length, with UVs or without."""
    count, vertices = draw(st.integers(1, 8)), draw(st.integers(3, 9))
    places = hnp.arrays(np.float64, (vertices, 3), elements=st.floats(-5.0, 5.0, width=32))
    corners = hnp.arrays(np.int32, (count, 3), elements=st.integers(0, vertices - 1))
    small = st.sampled_from([0.0, -0.0, 1.0, 0.5])
    mesh = TriangleMesh(
        vertices=draw(places),
        triangles=draw(corners),
        face=np.arange(count, dtype=np.int32),
        slot=draw(hnp.arrays(np.int32, count, elements=st.integers(0, 3))),
        normals=draw(hnp.arrays(np.float64, (count, 3, 3), elements=small)),
        uv=draw(st.none() | hnp.arrays(np.float64, (count, 3, 2), elements=small)),
    )
    entries = draw(st.integers(0, 5))
    shares = hnp.arrays(np.float32, count, elements=st.floats(0.0, 1.0, width=32))
    return TouchedSurface(
        name=draw(st.text(max_size=5)),
        mesh=mesh,
        materials=("a", "b"),
        token=draw(hnp.arrays(np.int32, count, elements=st.integers(UNTOUCHED, entries - 1))),
        roughness=draw(shares),
        confidence=draw(shares),
        palette=palette(entries) if entries else None,
    )


def parts(surface: TouchedSurface) -> tuple[dict, bytes]:
    (kind, text), (other, block) = chunks(encode_surface(surface, build_vertex_table(surface)))
    assert (kind, other) == (0x4E4F534A, 0x004E4942)
    return json.loads(text), block


@settings(deadline=None, max_examples=60)
@given(surface=surfaces())
def test_any_surface_keeps_the_rules_and_comes_back(surface: TouchedSurface) -> None:
    """Triangle by triangle, corner by corner, in Blender's axes again."""
    tree, block = parts(surface)
    check_gltf(tree, block)
    seen = 0
    for primitive, slot in zip(tree["meshes"][0]["primitives"], np.unique(surface.mesh.slot), strict=True):
        own = np.flatnonzero(surface.mesh.slot == slot)
        corner = read_accessor(tree, block, primitive["indices"]).reshape(-1, 3)
        found = {name: read_accessor(tree, block, index)[corner] for name, index in primitive["attributes"].items()}
        positions = surface.mesh.corner_positions()[own]
        np.testing.assert_array_equal(found["POSITION"] @ Z_UP.T, positions.astype(np.float32))
        np.testing.assert_array_equal(found["_HNF_VERTEX"][..., 0], surface.mesh.triangles[own])
        tracks = {"TOKEN": surface.token, "ROUGHNESS": surface.roughness, "CONFIDENCE": surface.confidence}
        for name, values in tracks.items():
            np.testing.assert_array_equal(found[f"_HNF_{name}"][..., 0], np.repeat(values[own, None], 3, axis=1))
        if surface.mesh.uv is not None:
            flipped = np.stack([surface.mesh.uv[own, :, 0], 1.0 - surface.mesh.uv[own, :, 1]], axis=-1)
            np.testing.assert_array_equal(found["TEXCOORD_0"], flipped.astype(np.float32))
        seen += len(own)
    assert seen == len(surface.mesh.triangles)


def test_corners_that_agree_are_one_vertex() -> None:
    """A sheet of one material has its 20 points and no more; a border of two materials doubles them."""
    plain = touched_sheet(baked=False)
    assert len(build_vertex_table(plain).position) == 20
    token = np.where(plain.mesh.face % 4 < 2, 0, UNTOUCHED).astype(np.int32)
    assert len(build_vertex_table(replace(plain, token=token, palette=palette())).position) == 20 + 4


@given(data=st.data())
@settings(deadline=None)
def test_rows_are_distinct_by_their_bits(data) -> None:
    """Also where NaNs, both zeros and denormals stand in them; kinds come in the order of the rows."""
    patterns = st.sampled_from([0, 1, 2, 0x7FC00001, 0x80000000, 0x3F800000]) | st.integers(0, 2**32 - 1)
    shape = (data.draw(st.integers(1, 30)), data.draw(st.integers(1, 9)))
    rows = data.draw(hnp.arrays(np.uint32, shape, elements=patterns)).view(np.float32)
    first, kind = find_distinct_rows(rows)
    assert rows[first][kind].tobytes() == rows.tobytes()
    assert len({row.tobytes() for row in rows}) == len(first)
    assert np.all(np.diff(first) > 0)


def test_equal_surfaces_give_equal_bytes() -> None:
    first, second = touched_sheet(), touched_sheet()
    assert encode_surface(first, build_vertex_table(first)) == encode_surface(second, build_vertex_table(second))


def test_vertices_under_the_stroke_are_those_of_its_triangles() -> None:
    surface = touched_sheet()
    table = build_vertex_table(surface)
    under = find_vertices_on_path(surface, table)
    assert np.all(np.diff(under) > 0)
    assert surface.path is not None
    expected = set(surface.mesh.triangles[np.unique(surface.path.triangle)].ravel().tolist())
    assert set(table.vertex[under].astype(int).tolist()) == expected
    assert len(find_vertices_on_path(touched_sheet(path=False), table)) == 0


@pytest.mark.parametrize("uv", [True, False])
def test_each_face_points_at_the_taxel_of_its_material(uv: bool) -> None:
    """Read as a renderer reads: nearest pixel, times the range; the exact values stand beside."""
    image = pytest.importorskip("PIL.Image", reason="needs Pillow, an independent reader of PNG")
    surface = touched_sheet(uv=uv)
    tree, block = parts(surface)
    check_gltf(tree, block)
    (material,) = tree["extensions"]["MPEG_haptic_material"]["materials"]
    rms = np.sqrt(np.sum(10.0 ** (2.0 * palette().tokens[:, LEVELS].astype(np.float64)), axis=1))
    expected = {"stiffness": [2000.0, None], "friction": [0.3, None], "vibrotactileTexture": rms.tolist()}
    attributes = tree["meshes"][0]["primitives"][0]["attributes"]
    token = read_accessor(tree, block, attributes["_HNF_TOKEN"])[:, 0].astype(int)
    for name, values in expected.items():
        (entry,) = material[name]
        meaning = entry["extras"]["hnf"]
        assert meaning["values"] == pytest.approx(values) if None not in values else meaning["values"] == values
        number = entry["texture"]["texCoord"]
        assert number == int(uv)
        picture = tree["images"][tree["textures"][entry["texture"]["index"]]["source"]]["bufferView"]
        pixels = np.asarray(image.open(io.BytesIO(get_view_bytes(tree, block, picture, Path("x")))))
        at = read_accessor(tree, block, attributes[f"TEXCOORD_{number}"])
        column = np.floor(at[:, 0] * pixels.shape[1]).astype(int)
        assert np.all((at[:, 1] > 0.0) & (at[:, 1] < 1.0))
        read = meaning["minimum"] + pixels[0, column] / 255.0 * (meaning["maximum"] - meaning["minimum"])
        known = np.array([0.0 if value is None else value for value in [*values, 0.0]])  # −1, untouched, is the last
        np.testing.assert_allclose(read, known[token], atol=meaning["maximum"] / 510.0)


@settings(deadline=None)
@given(entries=st.integers(1, 300))
def test_taxels_do_not_meet(entries: int) -> None:
    pixel = compute_taxel_uv(np.arange(-1, entries), entries)[:, 0] * compute_taxel_row_width(entries)
    np.testing.assert_allclose(pixel, np.arange(entries + 1) + 0.5, atol=1e-3)
    assert pixel[-1] < compute_taxel_row_width(entries) < 2 * (entries + 1)


SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)


@given(pixels=hnp.arrays(np.uint8, SHAPES | SHAPES.map(lambda shape: (*shape, 3))))
@settings(deadline=None)
def test_pictures_are_read_by_others(pixels: np.ndarray) -> None:
    image = pytest.importorskip("PIL.Image", reason="needs Pillow, an independent reader of PNG")
    found = image.open(io.BytesIO(encode_png(pixels)))
    assert found.mode == ("L" if pixels.ndim == 2 else "RGB")
    np.testing.assert_array_equal(np.asarray(found), pixels)


def test_the_signal_comes_back_bit_for_bit(tmp_path: Path) -> None:
    signal, path = rough_tone(), tmp_path / "x.glb"
    said = write_glb(path, signal, ExportOptions(surface=touched_sheet()))
    assert said == ("The surface's look: its materials are named, without shaders.",)
    found = read_glb(path, ImportOptions())
    assert found.samples.tobytes() == signal.samples.tobytes()
    assert (found.sample_rate, found.seed, dict(found.provenance)) == (
        signal.sample_rate, signal.seed, dict(signal.provenance),
    )  # fmt: skip


def test_what_no_material_knows_is_left_out() -> None:
    surface = touched_sheet()
    assert surface.palette is not None
    nothing = replace(surface.palette, mechanics=(palette().mechanics[-1],) * 2)
    tree, block = parts(replace(surface, palette=nothing))
    check_gltf(tree, block)
    (material,) = tree["extensions"]["MPEG_haptic_material"]["materials"]
    assert set(material) == {"name", "vibrotactileTexture"}


def test_an_unbaked_surface_is_a_plain_mesh_and_says_so(tmp_path: Path) -> None:
    path = tmp_path / "x.glb"
    said = write_glb(path, rough_tone(), ExportOptions(surface=touched_sheet(baked=False)))
    assert "nothing is baked on object 'Sheet'" in said[0]
    tree, block = decode_glb(path.read_bytes(), path)
    check_gltf(tree, block)
    assert "extensions" not in tree


def test_an_object_stands_where_it_stood() -> None:
    """+z of Blender is +y of glTF; numbers go column by column."""
    placement = np.eye(4)
    placement[:3, 3] = (1.0, 2.0, 3.0)
    placement[:3, :3] = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    tree, _ = parts(replace(touched_sheet(), placement=placement))
    matrix = np.array(tree["nodes"][0]["matrix"]).reshape(4, 4).T
    point = np.array([0.1, 0.2, 0.3])
    there = matrix[:3, :3] @ (Z_UP.T @ point) + matrix[:3, 3]
    np.testing.assert_allclose(Z_UP @ there, placement[:3, :3] @ point + placement[:3, 3], atol=1e-12)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    path, surface = tmp_path / "x.glb", touched_sheet()
    with pytest.raises(UsageError, match="--scene"):
        write_glb(path, rough_tone(), ExportOptions())
    bad = replace(rough_tone(), samples=np.array([np.inf], np.float32))
    with pytest.raises(FileError, match="finite"):
        write_glb(path, bad, ExportOptions(surface=surface))
    assert not path.exists()
    with pytest.raises(SceneError, match="triangles"):
        replace(surface, token=surface.token[1:])
    with pytest.raises(SceneError, match="beyond the 2 baked"):
        replace(surface, token=surface.token + 2)


@settings(deadline=None)
@given(data=st.data())
def test_damage_is_named(data, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Cut anywhere, or with any byte changed: the signal, another signal, or one FileError."""
    surface = touched_sheet()
    good = encode_surface(surface, build_vertex_table(surface), rough_tone(0.01))
    at = data.draw(st.integers(0, len(good) - 1))
    cut = data.draw(st.booleans())
    broken = good[:at] if cut else good[:at] + bytes([good[at] ^ data.draw(st.integers(1, 255))]) + good[at + 1 :]
    path = tmp_path_factory.getbasetemp() / "broken.glb"
    path.write_bytes(broken)
    try:
        found = read_glb(path, ImportOptions())
    except FileError:
        return
    assert not cut
    assert np.isfinite(found.samples).all()


def test_a_scene_without_blender_is_refused_with_a_remedy(tmp_path: Path, capsys) -> None:
    """The core alone opens no .blend."""
    wav = tmp_path / "x.wav"
    write_wav(wav, rough_tone())
    words = ["export", str(wav), "--format", "glb", "--out", str(tmp_path / "x.glb"), "--scene", "baked.blend"]
    assert main(words, lambda arguments: 0) == 2
    said = capsys.readouterr().err
    assert "baked.blend can be opened with Blender alone" in said
    assert "pip install bpy" in said
