"""EXR files of every Blender: one part or many, passes by name, and files that are none."""

from __future__ import annotations

import numpy as np
import pytest

from hnf_core.errors import FileError
from hnf_core.scene.rgbd_view import group_channels, read_exr

OpenEXR = pytest.importorskip("OpenEXR", reason="OpenEXR is not installed here")


def channels(seed=0):
    random = np.random.default_rng(seed)
    names = ["L.Combined.R", "L.Combined.G", "L.Combined.B", "L.Combined.A", "L.Depth.Z", "L.hnf0_1.X"]
    names += ["L.Normal.X", "L.Normal.Y", "L.Normal.Z"]
    return {name: random.standard_normal((4, 6)).astype(np.float32) for name in names}


def write(path, parts):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File([OpenEXR.Part(dict(header), part, f"part{n}") for n, part in enumerate(parts)]).write(str(path))


@pytest.mark.parametrize("multipart", [False, True])
def test_passes_come_back_by_name_and_component(tmp_path, multipart):
    data = channels()
    path = tmp_path / "passes.exr"
    groups = {}
    for name, pixels in data.items():
        groups.setdefault(name.rpartition(".")[0] if multipart else "all", {})[name] = pixels
    write(path, list(groups.values()))
    passes = read_exr(path)
    assert set(passes) == {"Combined", "Depth", "hnf0_1", "Normal"}
    np.testing.assert_array_equal(passes["Depth"], data["L.Depth.Z"])
    np.testing.assert_array_equal(passes["hnf0_1"], data["L.hnf0_1.X"])
    for name, letters in (("Combined", "RGBA"), ("Normal", "XYZ")):
        expected = np.stack([data[f"L.{name}.{letter}"] for letter in letters], axis=-1)
        np.testing.assert_array_equal(passes[name], expected)


def test_a_pass_without_a_layer_keeps_its_name():
    assert set(group_channels({"Combined.R": np.zeros((1, 1), np.float32)})) == {"Combined"}


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileError, match=r"nothing\.exr"):
        read_exr(tmp_path / "nothing.exr")


@pytest.mark.parametrize("content", [b"", b"not an image", b"\x76\x2f\x31\x01" + bytes(40)])
def test_a_damaged_file_is_named(tmp_path, content):
    path = tmp_path / "damaged.exr"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"damaged\.exr"):
        read_exr(path)


def test_a_truncated_file_is_named(tmp_path):
    path = tmp_path / "whole.exr"
    write(path, [channels()])
    cut = tmp_path / "cut.exr"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(FileError, match=r"cut\.exr"):
        read_exr(cut)
