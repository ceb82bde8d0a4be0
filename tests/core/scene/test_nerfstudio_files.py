"""Cameras of a nerfstudio export: what is written is read, and what cannot be is refused by name."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_camera import rotation

from hnf_core.errors import FileError
from hnf_core.scene.camera import Camera, orthographic
from hnf_core.scene.nerfstudio import (
    MODEL_TRANSFORM_FILE,
    NerfstudioFrame,
    read_model_transforms,
    read_transforms,
    write_transforms,
)

finite = st.floats(-50.0, 50.0)
LENS = {"fl_x": 800.0, "fl_y": 790.0, "cx": 321.5, "cy": 240.0, "w": 640, "h": 480}
LOOKING_DOWN_FROM_3 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3.0], [0, 0, 0, 1]]
quick = settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def rigid(draw):
    pose = np.eye(4)
    axis = np.array([draw(finite), draw(finite), draw(st.floats(0.1, 10.0))])
    pose[:3, :3] = rotation(axis, draw(st.floats(-np.pi, np.pi)))
    pose[:3, 3] = [draw(finite), draw(finite), draw(finite)]
    return pose


@st.composite
def frames(draw):
    count, shared = draw(st.integers(1, 4)), draw(st.booleans())
    made = []
    for index in range(count):
        if index == 0 or not shared:
            width, height = draw(st.integers(1, 4000)), draw(st.integers(1, 4000))
            lens = np.diag([draw(st.floats(1.0, 1e4)), draw(st.floats(1.0, 1e4)), 1.0])
            lens[:2, 2] = draw(finite), draw(finite)
        depth = draw(st.sampled_from(["", f"depths/{index}.png"]))
        camera = Camera("perspective", width, height, lens, draw(rigid()))
        made.append(NerfstudioFrame(f"images/frame {index}.png", camera, depth))
    return made


def document(**changes) -> dict:
    frame = {"file_path": "images/a.png", "transform_matrix": LOOKING_DOWN_FROM_3}
    return {"camera_model": "OPENCV", **LENS, "frames": [frame], **changes}


def written(tmp_path, content) -> object:
    path = tmp_path / "transforms.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@quick
@given(frames())
def test_what_is_written_is_read(tmp_path, made) -> None:
    path = tmp_path / "transforms.json"
    write_transforms(path, made)
    for before, after in zip(made, read_transforms(path), strict=True):
        assert (after.file_path, after.depth_file_path) == (before.file_path, before.depth_file_path)
        assert (after.camera.width, after.camera.height) == (before.camera.width, before.camera.height)
        np.testing.assert_array_equal(after.camera.intrinsics, before.camera.intrinsics)
        np.testing.assert_allclose(after.camera.pose, before.camera.pose, atol=1e-12)


def test_a_camera_of_opengl_looks_along_minus_z_with_y_up(tmp_path) -> None:
    (frame,) = read_transforms(written(tmp_path, document()))
    uv, z = frame.camera.project([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(z, [3.0, 3.0, 3.0, 2.0])
    right, up = 0.1 / 3.0 * LENS["fl_x"], 0.1 / 3.0 * LENS["fl_y"]
    np.testing.assert_allclose(uv - [LENS["cx"], LENS["cy"]], [[0, 0], [right, 0], [0, -up], [0, 0]], atol=1e-9)
    assert frame.name == "a"


def test_a_lens_of_its_own_counts_more_than_the_shared_one(tmp_path) -> None:
    own = {"file_path": "b.png", "transform_matrix": LOOKING_DOWN_FROM_3, "fl_x": 100.0, "w": 64}
    both = document()
    both["frames"].append(own)
    first, second = read_transforms(written(tmp_path, both))
    assert (first.camera.intrinsics[0, 0], first.camera.width) == (800.0, 640)
    assert (second.camera.intrinsics[0, 0], second.camera.width) == (100.0, 64)
    assert second.camera.intrinsics[1, 1] == 790.0


@quick
@given(rigid(), rigid(), st.floats(0.01, 100.0), st.lists(finite, min_size=3, max_size=3))
def test_an_exported_point_is_seen_at_the_same_pixel(tmp_path, applied, model, scale, place) -> None:
    """x_model = scale · T x, x_poses = A x: the picture of a point does not know which frame it is told in."""
    path = written(tmp_path, document(applied_transform=applied[:3].tolist()))
    (tmp_path / MODEL_TRANSFORM_FILE).write_text(json.dumps({"transform": model[:3].tolist(), "scale": scale}))
    (told,), (exported,) = read_transforms(path), read_model_transforms(path)
    original = np.array([*place, 1.0])
    in_poses, in_model = (applied @ original)[:3], scale * (model @ original)[:3]
    uv, z = told.camera.project(in_poses)
    if abs(z) > 0.1:
        uv_model, z_model = exported.camera.project(in_model)
        np.testing.assert_allclose(z_model, scale * z, rtol=1e-6, atol=1e-6 * scale)
        np.testing.assert_allclose(uv_model, uv, rtol=1e-6, atol=1e-5)
    (tmp_path / MODEL_TRANSFORM_FILE).unlink()
    np.testing.assert_array_equal(read_model_transforms(path)[0].camera.pose, told.camera.pose)


def without(key: str) -> dict:
    whole = document()
    del whole[key]
    return whole


def frame_with(**changes) -> dict:
    whole = document()
    whole["frames"][0].update(changes)
    return whole


MIRROR = [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "no JSON"),
        ("[" * 100_000, "no JSON"),
        ("3", "no JSON object"),
        ([{"file_path": "a.png", "transform": LOOKING_DOWN_FROM_3[:3]}], "without their lenses"),
        (without("frames"), "no 'frames'"),
        (document(frames=[]), "no 'frames'"),
        (document(frames=[{}]), "frame 0 has no 'file_path'"),
        *((without(key), f"has no '{key}'") for key in LENS),
        (document(fl_x="wide"), "'fl_x' is no number"),
        (document(cx=float("nan")), "'cx' is no number"),
        (document(fl_y=0.0), "must be positive"),
        (document(w=0), "no size of a picture"),
        (document(h=3.5), "no size of a picture"),
        (document(k1=0.02), "its lens distorts (k1 = 0.02)"),
        (frame_with(p2=-1e-4), "its lens distorts (p2 = -0.0001)"),
        (document(camera_model="OPENCV_FISHEYE"), "camera model 'OPENCV_FISHEYE'"),
        (document(camera_model=["OPENCV"]), "camera model"),
        (frame_with(transform_matrix=None), "no matrix"),
        (frame_with(transform_matrix=[[1, 0], [0, 1]]), "no matrix"),
        (frame_with(transform_matrix=MIRROR), "mirrors"),
        (frame_with(transform_matrix=(2.0 * np.eye(4)).tolist()), "0 0 0 1"),
        (frame_with(transform_matrix=np.diag([1.5, 1.5, 1.5, 1.0]).tolist()), "more than turn and move"),
        (frame_with(transform_matrix=np.diag([1e200, 1.0, 1.0, 1.0]).tolist()), "more than turn and move"),
        (frame_with(file_path="../../secret.png"), "leaves its folder"),
        (frame_with(file_path="/etc/passwd"), "leaves its folder"),
        (frame_with(file_path="C:\\pictures\\a.png"), "leaves its folder"),
        (frame_with(file_path="images\\..\\..\\a.png"), "leaves its folder"),
        (frame_with(depth_file_path="../depth.png"), "leaves its folder"),
        (frame_with(depth_file_path=7), "no text"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(tmp_path, content, said) -> None:
    path = written(tmp_path, content)
    with pytest.raises(FileError) as refused:
        read_transforms(path)
    assert said in refused.value.what
    assert refused.value.where == str(path)
    assert refused.value.remedy


def test_distortion_of_zero_is_none(tmp_path) -> None:
    zeros = dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0.0)
    assert len(read_transforms(written(tmp_path, document(**zeros)))) == 1


def test_a_missing_file_is_said_to_be_missing(tmp_path) -> None:
    with pytest.raises(FileError, match="cannot be read"):
        read_transforms(tmp_path / "transforms.json")


def test_a_link_out_of_the_folder_is_not_followed(tmp_path) -> None:
    (tmp_path / "data").mkdir()
    try:
        (tmp_path / "data" / "images").symlink_to(tmp_path)
    except OSError:
        pytest.skip("no links here")
    with pytest.raises(FileError, match="leaves its folder"):
        read_transforms(written(tmp_path / "data", document()))


def test_a_camera_that_cannot_be_told_is_not_written(tmp_path) -> None:
    flat = orthographic([0, 0, 0], [1, 0, 0], [0, 0, 1], 0.02, 64, 0.01)
    with pytest.raises(FileError, match="orthographic"):
        write_transforms(tmp_path / "transforms.json", [NerfstudioFrame("a.png", flat)])
    assert not (tmp_path / "transforms.json").exists()


@pytest.mark.parametrize("changes", [{"scale": 0.0}, {"scale": None}, {"transform": None}])
def test_a_model_frame_that_cannot_be_undone_is_refused(tmp_path, changes) -> None:
    path = written(tmp_path, document())
    whole = {"transform": np.eye(4)[:3].tolist(), "scale": 1.0, **changes}
    (tmp_path / MODEL_TRANSFORM_FILE).write_text(json.dumps(whole))
    with pytest.raises(FileError):
        read_model_transforms(path)
