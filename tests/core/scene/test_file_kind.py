"""What a file is, by its bytes: whatever its name says, and with a remedy where it cannot be opened."""

from __future__ import annotations

import json
import struct

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hnf_core.errors import FileError, HnfError
from hnf_core.scene.file_kind import HEAD_BYTES, identify
from hnf_core.scene.gltf_document import (
    UNREADABLE_EXTENSIONS,
    check_gltf,
    describe_unread,
    is_splat_document,
    read_gltf_document,
)

LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12\n"
SAMPLES = {
    "Git LFS pointer": LFS,
    "web page": b"\n <!DOCTYPE HTML><html>404</html>",
    "UTF-16 text": "v 0 0 0\n".encode("utf-16"),
    "KTX2 texture": b"\xabKTX 20\xbb\r\n\x1a\n" + bytes(64),
    "glTF 1.0": struct.pack("<4sII", b"glTF", 1, 20) + bytes(8),
    "PNG picture": b"\x89PNG\r\n",
    "STEP file": b"ISO-10303-21;\n",
    "MaterialX document": b'<?xml version="1.0"?>\n<materialx version="1.38">',
}
SCENES = {
    ".glb": struct.pack("<4sII", b"glTF", 2, 20) + bytes(8),
    ".gltf": b'\xef\xbb\xbf {"asset": {"version": "2.0"}}',
    ".dae": b'<?xml version="1.0"?><COLLADA xmlns="x">',
    ".stl": b"solid cube\nfacet normal 0 0 1\n",
    ".blend": b"BLENDER-v402",
}


@pytest.mark.parametrize("name", SAMPLES)
def test_what_cannot_be_opened_is_named_with_a_remedy(name):
    kind = identify(SAMPLES[name])
    assert kind is not None
    assert not kind.suffix
    assert name in kind.what
    assert kind.remedy.endswith(".")


@pytest.mark.parametrize("suffix", SCENES)
def test_scenes_are_told_by_their_content(suffix):
    kind = identify(SCENES[suffix])
    assert kind is not None
    assert kind.suffix == suffix


@given(st.binary(max_size=HEAD_BYTES))
def test_any_bytes_have_a_kind_or_none(head):
    kind = identify(head)
    assert kind is None or kind.what


def write_gltf(path, **content):
    path.write_text(json.dumps({"asset": {"version": "2.0"}, **content}))
    return path


def write_glb(path, **content):
    text = json.dumps({"asset": {"version": "2.0"}, **content}).encode()
    text += b" " * (-len(text) % 4)
    path.write_bytes(struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON") + text)
    return path


@pytest.mark.parametrize("write", [write_gltf, write_glb])
def test_both_forms_give_the_same_document(tmp_path, write):
    content = {"meshes": [{"primitives": [{"attributes": {}}]}], "extensionsRequired": ["KHR_mesh_quantization"]}
    assert check_gltf(write(tmp_path / "a", **content)) == {"asset": {"version": "2.0"}, **content}


@pytest.mark.parametrize("write", [write_gltf, write_glb])
@pytest.mark.parametrize("extension", UNREADABLE_EXTENSIONS)
def test_extensions_that_blender_lacks_have_a_remedy(tmp_path, write, extension):
    path = write(tmp_path / "a", extensionsRequired=[extension])
    with pytest.raises(FileError, match=extension) as caught:
        check_gltf(path)
    assert caught.value.remedy == UNREADABLE_EXTENSIONS[extension]
    check_gltf(path, frozenset({extension}))
    (note,) = describe_unread(check_gltf(write(tmp_path / "b", extensionsUsed=[extension])))  # needed by none
    assert extension in note
    assert UNREADABLE_EXTENSIONS[extension] in note


def test_gltf_1_is_named_in_either_form(tmp_path):
    for version in ("1.0", "1.1"):
        path = write_gltf(tmp_path / "a.gltf", asset={"version": version})
        with pytest.raises(FileError, match=r"glTF 1\.0.*gltf-pipeline"):
            read_gltf_document(path)
    (tmp_path / "b.gltf").write_text(json.dumps({"asset": {}, "buffers": {"b": {"uri": "b.bin"}}}))
    with pytest.raises(FileError, match=r"glTF 1\.0"):
        read_gltf_document(tmp_path / "b.gltf")


def test_data_that_is_missing_or_stands_for_itself_is_named(tmp_path):
    path = write_gltf(tmp_path / "a.gltf", buffers=[{"uri": "data%20one.bin", "byteLength": 4}])
    with pytest.raises(FileError, match=r"data file 'data one\.bin' is missing"):
        check_gltf(path)
    (tmp_path / "data one.bin").write_bytes(LFS)
    with pytest.raises(FileError, match=r"data file 'data one.bin' is a Git LFS pointer.*git lfs pull"):
        check_gltf(path)
    (tmp_path / "data one.bin").write_bytes(bytes(4))
    check_gltf(path)


def test_clouds_of_splats_are_told_from_points(tmp_path):
    primitive = {"attributes": {}, "mode": 0}
    assert not is_splat_document(check_gltf(write_gltf(tmp_path / "points.gltf", meshes=[{"primitives": [primitive]}])))
    splats = {**primitive, "extensions": {"KHR_gaussian_splatting": {}}}
    for content in ({"meshes": [{"primitives": [splats]}]}, {"extensionsRequired": ["KHR_gaussian_splatting"]}):
        assert is_splat_document(check_gltf(write_gltf(tmp_path / "splats.gltf", **content)))


JSON = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(
        ["asset", "version", "buffers", "uri", "meshes", "primitives", "extensions", "extensionsRequired"]), inner),
    max_leaves=12,
)  # fmt: skip


@given(JSON)
@example({"extensionsRequired": [[]]})
@example({"asset": {"version": "2.0"}, "meshes": [{"primitives": [{"extensions": True}]}]})
def test_any_document_is_read_or_refused(tmp_path_factory, document):
    path = tmp_path_factory.getbasetemp() / "any.gltf"
    path.write_text(json.dumps(document))
    refused = None
    try:
        check_gltf(path)
    except HnfError as error:
        refused = str(error)
    assert refused is None or (str(path) in refused and "\n" not in refused)
