"""Splats as people have them: .splat, .spz, .ksplat, SOG and glTF, written plainly, cut, damaged, and read."""

from __future__ import annotations

import gzip
import json
import struct
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from splat_files import C0, angles_between, random_splats

from hnf_core.errors import FileError, HnfError, SceneError
from hnf_core.scene.file_kind import HEAD_BYTES, identify
from hnf_core.scene.splats import splat_file
from hnf_core.scene.splats.gaussians import Splats, evaluate_sh_colours
from hnf_core.scene.splats.splat_file import open_splat_file, read_splats, read_validated_splats
from reference.splat_layouts import WRITERS, get_suffix, write_gltf, write_ksplat, write_sog, write_splat, write_spz

pytest.importorskip("PIL")
pytest.importorskip("zstandard")
LAYOUTS = [*WRITERS]
FIELDS = ("means", "scales", "rotations", "opacities", "harmonics")
EXACT = 1e-6
CUTS, CHANGES = 150, 200
"""Tried of each layout; all cuts and 2,000 changes were tried once."""
HALF = 2.0**-11
"""Relative error of float16."""


def cloud(count: int, degree: int = 0, seed: int = 0) -> Splats:
    """Colours within 0 … 1 and higher harmonics within ±1, which every layout can hold."""
    splats = random_splats(count, degree, seed)
    harmonics = splats.harmonics / 2.0
    harmonics[:, 0] *= 1.7
    return replace(splats, harmonics=harmonics)


def write(layout: str, folder: Path, splats: Splats) -> Path:
    return WRITERS[layout](folder / f"cloud{get_suffix(layout)}", splats)


LOSS = {
    # layout: centre, relative scale, angle, opacity, constant harmonic, higher ones; of the layout's own steps
    "splat": (0.0, EXACT, 0.033, 0.51 / 255, 0.51 / 255 / C0, 0.0),
    "spz2": (0.51 / 4096, 0.032, 0.35, 0.51 / 255, 0.51 / 255 / 0.15, 0.51 / 128 + 1.0 / 128),
    "spz3": (0.51 / 4096, 0.032, 0.01, 0.51 / 255, 0.51 / 255 / 0.15, 0.51 / 128 + 1.0 / 128),
    "ksplat0": (EXACT, EXACT, 1e-5, 0.51 / 255, 0.51 / 255 / C0, EXACT),
    "ksplat1": (5e-5, HALF, 2e-3, 0.51 / 255, 0.51 / 255 / C0, HALF),
    "ksplat2": (5e-5, HALF, 2e-3, 0.51 / 255, 0.51 / 255 / C0, 3.01 / 255),
    "sog1": (5e-5, 0.009, 0.025, 0.02, 0.51 * 3.4 / 255, 0.51 * 2 / 255),
    "sog2": (5e-5, 0.009, 0.025, 0.51 / 255, 0.51 * 3.4 / 255, 0.51 * 2 / 255),
    "glb": (0.0, EXACT, 1e-5, 0.0, EXACT, EXACT),
    "glb-small": (0.0, EXACT, 2e-4, 0.51 / 255, EXACT, EXACT),
}
LOSS["spz4"] = LOSS["spz3"]


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(count=st.integers(1, 40), degree=st.integers(0, 3), seed=st.integers(0, 10_000), block=st.integers(1, 50))
def test_what_is_written_is_read_within_the_layouts_steps(
    layout: str, tmp_path: Path, count: int, degree: int, seed: int, block: int
) -> None:
    splats = cloud(max(count, 2) if layout.startswith("sog") else count, degree, seed)
    path = write(layout, tmp_path, splats)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splat_file, "ROWS_PER_BLOCK", block)
        found = read_validated_splats(path)
    assert (found.total, sum(found.dropped.values()), found.thickened) == (len(splats), 0, 0)
    assert found.splats.degree == (0 if layout == "splat" else degree)
    centre, scale, angle, opacity, constant, higher = LOSS[layout]
    read = found.splats
    np.testing.assert_allclose(read.means, splats.means, atol=centre + 1e-7, rtol=0)
    np.testing.assert_allclose(read.scales, splats.scales, rtol=scale + 1e-6)
    assert angles_between(read, splats).max() <= angle
    np.testing.assert_allclose(read.opacities, splats.opacities, atol=opacity + 1e-7, rtol=0)
    np.testing.assert_allclose(read.harmonics[:, 0], splats.harmonics[:, 0], atol=constant + 1e-6, rtol=0)
    if layout != "splat":
        np.testing.assert_allclose(read.harmonics[:, 1:], splats.harmonics[:, 1:], atol=higher + 1e-6, rtol=0)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_bytes_tell_the_layout_whatever_the_name_says(layout: str, tmp_path: Path) -> None:
    path = write(layout, tmp_path, cloud(40))
    kind = identify(path.read_bytes()[:HEAD_BYTES])
    assert kind is not None
    assert kind.suffix == get_suffix(layout)
    expected = read_splats(path)
    for name in ("cloud", "cloud.ply", "cloud.zip", "cloud.spz", "cloud.splat"):
        found = read_splats(path.rename(path.with_name(name)))
        path = path.with_name(name)
        for field in FIELDS:
            np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


def test_each_layout_says_what_is_up(tmp_path: Path) -> None:
    ups = {layout: open_splat_file(write(layout, tmp_path, cloud(9))).up.axis for layout in LAYOUTS}
    assert {layout for layout, axis in ups.items() if axis == "y"} == {"spz2", "spz3", "spz4", "glb", "glb-small"}
    assert set(ups.values()) == {"y", "-y"}


def refused_or_sound(path: Path) -> bool:
    """True if it was read; a refusal is one line with the file and a remedy."""
    refusal = None
    try:
        splats = read_splats(path)
    except HnfError as error:
        refusal = error
    if refusal is not None:
        assert str(path) in str(refusal)
        assert "\n" not in str(refusal)
        assert refusal.remedy.endswith(".")
        return False
    assert len(splats)
    assert all(np.isfinite(getattr(splats, name)).all() for name in FIELDS)
    assert (splats.scales > 0.0).all()
    assert ((splats.opacities >= 0.0) & (splats.opacities <= 1.0)).all()
    return True


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_cut_is_refused(layout: str, tmp_path: Path) -> None:
    """Of .splat, which has no header, a whole number of splats is a smaller cloud. CUTS of them, the ends with all."""
    path = write(layout, tmp_path, cloud(9, 1))
    data = path.read_bytes()
    step = max(1, len(data) // CUTS)
    for cut in sorted({*range(0, len(data), step), *range(64), *range(len(data) - 64, len(data))}):
        path.write_bytes(data[:cut])
        assert refused_or_sound(path) == (layout == "splat" and cut % 32 == 0 and cut > 0), cut


@pytest.mark.parametrize("layout", LAYOUTS)
def test_changed_bytes_give_a_refusal_or_a_sound_cloud(layout: str, tmp_path: Path) -> None:
    """In .ksplat mostly where it is not empty."""
    path = write(layout, tmp_path, cloud(9, 1))
    data = path.read_bytes()
    random = np.random.default_rng(7)
    full = np.flatnonzero(np.frombuffer(data, dtype=np.uint8))
    places = full if layout.startswith("ksplat") else np.arange(len(data))
    read = 0
    for _ in range(CHANGES):
        changed = bytearray(data)
        for _ in range(random.integers(1, 5)):
            at = int(random.choice(places)) if random.random() < 0.9 else int(random.integers(len(data)))
            changed[at] = random.choice([0, 1, 255, int(random.integers(256))])
        path.write_bytes(changed)
        read += refused_or_sound(path)
    assert read < CHANGES or layout == "splat"


def test_a_count_that_lies_takes_no_room(tmp_path: Path) -> None:
    many = struct.pack("<I", 0xFFFFFFF0)
    spz = bytearray(gzip.decompress(write_spz(tmp_path / "a.spz", cloud(9)).read_bytes()))
    spz[8:12] = many
    files = {"a.spz": gzip.compress(bytes(spz)), "raw.spz": bytes(spz)}
    ksplat = bytearray(write_ksplat(tmp_path / "a.ksplat", cloud(9)).read_bytes())
    ksplat[4096:4104] = ksplat[16:20] + many
    files["a.ksplat"] = bytes(ksplat)
    glb = write_gltf(tmp_path / "a.glb", cloud(9)).read_bytes()
    files["a.glb"] = glb.replace(b'"count": 9', b'"count":99999999')
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        tracemalloc.start()
        assert not refused_or_sound(tmp_path / name)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 2e6, name


@pytest.mark.parametrize(("layout", "share"), [("splat", 0.3), ("ksplat1", 0.3), ("spz3", 1.3), ("glb", 0.3)])
def test_memory_beside_the_result_follows_the_block(layout: str, share: float, tmp_path: Path) -> None:
    """Of 60,000 splats made of 60 many times; .spz, whose attributes follow each other, is held unpacked."""
    few = cloud(60)
    splats = Splats(*(np.tile(getattr(few, name), (1000, *[1] * (getattr(few, name).ndim - 1))) for name in FIELDS))
    path = tmp_path / f"big{get_suffix(layout)}"
    if layout == "splat":
        path.write_bytes(1000 * write(layout, tmp_path, few).read_bytes())
        size = path.stat().st_size
    elif layout == "spz3":
        data = gzip.decompress(write(layout, tmp_path, few).read_bytes())
        parts, at = [], 16
        for width in (9, 1, 3, 3, 4):
            parts.append(1000 * data[at : at + 60 * width])
            at += 60 * width
        path.write_bytes(gzip.compress(data[:8] + struct.pack("<I", 60_000) + data[12:16] + b"".join(parts)))
        size = 20 * 60_000
    elif layout == "glb":
        size = write_gltf(path, splats).stat().st_size
    else:
        size = write_ksplat(path, Splats(*(getattr(splats, name)[:6000] for name in FIELDS))).stat().st_size
    source = open_splat_file(path)
    tracemalloc.start()
    blocks = sum(len(raw.means) for raw in source.iter_raw(1000))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert blocks == source.count
    assert peak < share * size + 600_000


def test_a_meta_json_reads_the_pictures_beside_it(tmp_path: Path) -> None:
    path = write_sog(tmp_path / "meta.json", cloud(30, 1))
    packed = write_sog(tmp_path / "a.sog", cloud(30, 1))
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(read_splats(path), field), getattr(read_splats(packed), field))
    (tmp_path / "quats.webp").unlink()
    with pytest.raises(FileError, match=r"picture 'quats\.webp' is missing"):
        read_splats(path)
    meta = json.loads(path.read_text())
    for name in ("../quats.webp", "/etc/passwd", "C:\\quats.webp", "a/../../b", 7, None):
        meta["quats"]["files"] = [name]
        path.write_text(json.dumps(meta))
        with pytest.raises(FileError, match="names no 1 pictures of 'quats'"):
            read_splats(path)


def test_an_archive_may_keep_its_files_in_a_folder(tmp_path: Path) -> None:
    import zipfile

    path = write_sog(tmp_path / "a.sog", cloud(30))
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(tmp_path / "b.sog", "w") as other:
        for name in archive.namelist():
            other.writestr(f"scene/{name}", archive.read(name))
    np.testing.assert_array_equal(read_splats(tmp_path / "b.sog").means, read_splats(path).means)


@pytest.mark.parametrize(("layout", "module", "said"), [("sog2", "PIL", "Blender"), ("spz4", "zstandard", "zstandard")])
def test_a_decoder_that_is_missing_is_named(layout: str, module: str, said: str, tmp_path: Path, monkeypatch) -> None:
    path = write(layout, tmp_path, cloud(9))
    for name in [each for each in sys.modules if each.split(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(FileError, match=said) as caught:
        read_splats(path)
    assert caught.value.remedy
    assert str(path) in str(caught.value)


def test_versions_to_come_are_refused_by_their_number(tmp_path: Path) -> None:
    spz = bytearray(gzip.decompress(write_spz(tmp_path / "a.spz", cloud(9)).read_bytes()))
    for version in (1, 5):
        spz[4] = version
        (tmp_path / "a.spz").write_bytes(gzip.compress(bytes(spz)))
        with pytest.raises(FileError, match=rf"version {version}; versions 2, 3, 4 are read"):
            read_splats(tmp_path / "a.spz")
    path = write_sog(tmp_path / "meta.json", cloud(9))
    path.write_text(path.read_text().replace('"version": 2', '"version": 3'))
    with pytest.raises(FileError, match=r"SOG of version 3; versions 1 and 2"):
        read_splats(path)


# --- glTF


def node(**parts) -> list:
    """The splats' node under one that moves, turns and scales it."""
    return [{"children": [1], **parts}, {"mesh": 0, "translation": [0.5, 0.0, 0.0]}]


def test_a_node_moves_turns_and_scales_its_splats(tmp_path: Path) -> None:
    """Colour in a turned direction is that of the untouched splats in the direction before."""
    splats = cloud(20, 3)
    turn = np.array([0.18257419, 0.36514837, 0.54772256, 0.73029674])  # w x y z
    w, x, y, z = turn
    path = write_gltf(
        tmp_path / "a.gltf", splats, nodes=node(rotation=[x, y, z, w], scale=[2.0] * 3, translation=[0.0, 1.0, 0.0])
    )
    found = read_splats(path)

    def rotate(vectors: np.ndarray) -> np.ndarray:
        cross = 2.0 * np.cross(turn[1:], vectors)
        return vectors + w * cross + np.cross(turn[1:], cross)

    np.testing.assert_allclose(
        found.means, 2.0 * rotate(splats.means + np.array([0.5, 0.0, 0.0])) + [0.0, 1.0, 0.0], atol=1e-5
    )
    np.testing.assert_allclose(found.scales, 2.0 * splats.scales, rtol=1e-5)
    directions = np.random.default_rng(3).normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = evaluate_sh_colours(splats.harmonics.astype(np.float64), directions)
    after = evaluate_sh_colours(found.harmonics.astype(np.float64), rotate(directions))
    np.testing.assert_allclose(after, before, atol=1e-5)

    def axes(one: Splats) -> np.ndarray:
        q = one.rotations.astype(np.float64)
        cross = 2.0 * np.cross(q[:, 1:], [1.0, 0.0, 0.0])
        return np.array([1.0, 0.0, 0.0]) + q[:, :1] * cross + np.cross(q[:, 1:], cross)

    np.testing.assert_allclose(axes(found), rotate(axes(splats)), atol=1e-5)


def test_a_matrix_is_the_same_as_its_parts(tmp_path: Path) -> None:
    splats = cloud(5, 1)
    half = 2.0**-0.5
    parts = write_gltf(
        tmp_path / "a.glb", splats, nodes=node(rotation=[half, 0.0, 0.0, half], translation=[1.0, 2.0, 3.0])
    )
    matrix = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 2.0, 3.0, 1.0]
    whole = write_gltf(tmp_path / "b.glb", splats, nodes=node(matrix=matrix))
    for field in FIELDS:
        np.testing.assert_allclose(
            np.abs(getattr(read_splats(parts), field)), np.abs(getattr(read_splats(whole), field)), atol=1e-6
        )


def test_linear_colours_become_srgb(tmp_path: Path) -> None:
    splats = cloud(3)
    linear = np.array([[0.0, 0.002, 0.214], [0.5, 1.0, 0.05], [0.8, 0.3, 0.01]])
    splats.harmonics[:, 0] = (linear - 0.5) / C0
    path = write_gltf(tmp_path / "a.glb", splats, extension={"kernel": "ellipse", "colorSpace": "lin_rec709_display"})
    expected = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    np.testing.assert_allclose(0.5 + C0 * read_splats(path).harmonics[:, 0], expected, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"nodes": node(scale=[1.0, 2.0, 1.0])}, "stretches or mirrors"),
        ({"nodes": node(scale=[-1.0, 1.0, 1.0])}, "stretches or mirrors"),
        ({"nodes": [{"children": [0], "mesh": 0}]}, "do not fit together"),
        ({"nodes": [{"mesh": 3}]}, "do not fit together"),
        ({"nodes": [{"name": "nothing"}]}, "no splats that a node shows"),
        ({"extension": {"kernel": "blob", "colorSpace": "srgb_rec709_display"}}, "the kernel 'blob'"),
        ({"extension": {"kernel": "ellipse", "colorSpace": "rec2020"}}, "color space 'rec2020'"),
        ({"extension": {"extensions": {"KHR_gaussian_splatting_compression_spz_2": {}}}}, "compression_spz_2"),
    ],
)
def test_gltf_that_cannot_be_read_says_why(tmp_path: Path, change: dict, said: str) -> None:
    with pytest.raises((FileError, SceneError), match=said) as caught:
        read_splats(write_gltf(tmp_path / "a.glb", cloud(5), **change))
    assert caught.value.remedy


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_draco_mesh_compression"])
def test_compressed_splats_are_sent_to_no_mesh_tool(tmp_path: Path, name: str) -> None:
    path = write_gltf(tmp_path / "a.gltf", cloud(5))
    path.write_text(path.read_text().replace('Required": [', f'Required": ["{name}", '))
    with pytest.raises(FileError, match=name) as caught:
        read_splats(path)
    assert "gltfpack" not in caught.value.remedy


def test_meshes_beside_splats_and_drafts_are_refused(tmp_path: Path) -> None:
    path = write_gltf(tmp_path / "a.gltf", cloud(5))
    document = json.loads(path.read_text())
    document["meshes"][0]["primitives"].append({"attributes": {"POSITION": 0}})
    path.write_text(json.dumps(document))
    with pytest.raises(SceneError, match="both meshes and Gaussian splats"):
        read_splats(path)
    path.write_text(path.read_text().replace("KHR_gaussian_splatting:ROTATION", "_ROTATION"))
    document["meshes"][0]["primitives"].pop()
    del document["meshes"][0]["primitives"][0]["attributes"]["KHR_gaussian_splatting:OPACITY"]
    path.write_text(json.dumps(document))
    with pytest.raises(FileError, match=r"no attribute 'KHR_gaussian_splatting:OPACITY'.*draft"):
        read_splats(path)


def test_buffers_may_be_written_in_the_document(tmp_path: Path) -> None:
    import base64

    path = write_gltf(tmp_path / "a.gltf", cloud(5, 1))
    expected = read_splats(path)
    data = base64.b64encode((tmp_path / "splats.bin").read_bytes()).decode()
    path.write_text(path.read_text().replace("splats.bin", f"data:application/octet-stream;base64,{data}"))
    (tmp_path / "splats.bin").unlink()
    np.testing.assert_array_equal(read_splats(path).harmonics, expected.harmonics)
    path.write_text(path.read_text().replace("base64,", "base64,!"))
    with pytest.raises(FileError, match="do not fit together"):
        read_splats(path)


def test_values_that_mean_nothing_are_dropped(tmp_path: Path) -> None:
    splats = cloud(40)
    splats.scales[0, 1], splats.scales[1, 2], splats.means[2, 0] = -1.0, 0.0, np.nan
    splats.opacities[3] = 1.5
    found = read_validated_splats(write_gltf(tmp_path / "a.glb", splats))
    assert (found.dropped["not finite"], found.thickened, len(found.splats)) == (3, 1, 37)
    found = read_validated_splats(write_splat(tmp_path / "a.splat", replace(splats, opacities=np.ones(40))))
    assert (found.dropped["not finite"], found.thickened) == (2, 1)
