"""Messages, orders and results survive being written down; what is damaged is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_blender.bridge.scene.stored_data import FaceTokens
from hnf_blender.jobs import child_job
from hnf_blender.jobs.child_job import MESSAGE_PREFIX, Failed, Finished, Started, Step, decode_message, encode_message
from hnf_blender.jobs.request import (
    BakedFile,
    JobRequest,
    JobResult,
    Rejection,
    TokenFile,
    pack_tokens,
    read_request,
    read_result,
    unpack_tokens,
    write_request,
    write_result,
)
from hnf_blender.touch.session import InputHashes
from hnf_core.errors import FileError
from hnf_core.material.library import load_library
from hnf_core.material.palette import build_palette

COUNTS = st.integers(0, 10**9)
SHARES = st.floats(0.0, 1.0)
MESSAGES = st.one_of(
    st.builds(Started, COUNTS, COUNTS),
    st.builds(Step, st.text(), COUNTS, COUNTS, SHARES),
    st.builds(Finished),
    st.builds(Failed, st.text()),
)
INPUTS = InputHashes("made", "scale", "shape", "shading", "sight", "choices", "path", "touch")


@given(MESSAGES)
def test_every_message_is_one_line_and_comes_back(message) -> None:
    line = encode_message(message)
    assert len(line.splitlines()) == 1
    assert line.isascii()
    assert decode_message(line) == message


@given(st.text())
def test_what_blender_prints_is_no_message(text) -> None:
    if not text.startswith(MESSAGE_PREFIX):
        assert decode_message(text) is None


DAMAGED = (
    "Step",
    "Step {",
    'Step {"stage":"x"}',
    "Jump {}",
    'Started {"strokes":"two","fresh":0}',
    'Started {"strokes":true,"fresh":0}',
    'Finished {"more":1}',
    "Finished []",
)


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_message_is_refused(text) -> None:
    with pytest.raises(FileError):
        decode_message(MESSAGE_PREFIX + text)


def test_orders_and_results_come_back(tmp_path) -> None:
    order = JobRequest("Szene ✓", "View Layer", ("a", "b\n"), "/c", "bl_ext.user_default.hnf", "/p", ("/x", "/y"), True)
    write_request(tmp_path, order)
    assert read_request(tmp_path) == order
    result = JobResult(
        strokes=(BakedFile("a", "0000.bake", INPUTS),),
        meshes=(TokenFile("Plate", "key", ("a",), "0000.tokens"),),
        failed=(Rejection("b", "why"),),
        warnings=("note",),
        fresh=3,
        close_ups=12,
    )
    write_result(tmp_path, result)
    assert read_result(tmp_path) == result
    (tmp_path / "result.json").write_text("{}")
    with pytest.raises(FileError):
        read_result(tmp_path)


def test_tokens_come_back_and_damage_is_refused() -> None:
    library = load_library()[:2]
    palette, _ = build_palette(
        [each.token for each in library], [each.mechanics for each in library], [each.name for each in library]
    )
    tokens = FaceTokens(
        palette, np.array([0, -1, 1], np.int32), np.ones(3, np.float32), np.zeros(3, np.float32), "source"
    )
    data = pack_tokens(tokens)
    assert pack_tokens(unpack_tokens(data)) == data
    for damaged in (data[:-40], data[:20], b""):
        with pytest.raises(FileError):
            unpack_tokens(damaged)


def test_what_changed_has_a_name_and_keys_follow_it() -> None:
    """Force, seed and probe change the key alone; the path changes path_key too; nothing of a stroke the surface's."""
    assert INPUTS.describe_changes(INPUTS) == ()
    keys = {INPUTS.key}
    for name in ("made_by", "scale", "shape", "shading", "sight", "choices", "path", "touch"):
        other = replace(INPUTS, **{name: "other"})
        assert len(other.describe_changes(INPUTS)) == 1
        keys.add(other.key)
        assert (other.path_key == INPUTS.path_key) == (name == "touch")
        assert (other.surface_key == INPUTS.surface_key) == (name in ("touch", "path"))
    assert len(keys) == 9
    renamed = replace(INPUTS, names="other")  # a bake that was made with other names still holds
    assert renamed.describe_changes(INPUTS) == ()
    assert renamed.key not in keys
    assert (renamed.path_key, renamed.surface_key) == (INPUTS.path_key, INPUTS.surface_key)
    assert InputHashes.from_text(INPUTS.to_text()) == INPUTS
    assert InputHashes.from_text("[]") is None
    assert InputHashes.from_text(None) is None


def test_without_a_temporary_folder_it_is_said_in_words(monkeypatch) -> None:
    """As tempfile does it where every disk is full."""

    def none() -> None:
        raise FileNotFoundError(2, "No usable temporary directory found")

    monkeypatch.setattr(child_job, "get_job_root", none)
    with pytest.raises(FileError, match="no temporary folder can be made"):
        child_job.make_job_folder()


def test_only_folders_of_the_dead_are_abandoned(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(child_job, "get_job_root", lambda: tmp_path)
    mine = child_job.make_job_folder()
    (mine / "scene.blend").write_bytes(b"x")
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    left = tmp_path / f"{child_job.JOB_FOLDER_PREFIX}{ended.pid}-left"
    left.mkdir()
    (left / "scene.blend").write_bytes(b"x")
    foreign = tmp_path / f"{child_job.JOB_FOLDER_PREFIX}notes"
    foreign.mkdir()
    assert child_job.is_process_alive(os.getpid())
    assert child_job.remove_abandoned_folders() == [left]
    assert mine.is_dir()
    assert foreign.is_dir()
    assert not left.exists()
