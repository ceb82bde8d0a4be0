"""A bake that is cancelled, at every stage."""

from __future__ import annotations

import tempfile

import bpy
import pytest
from job_scene import NOTHING, STAGES, is_gone, kept, my_folders, reach, small_scene, start

from hnf_blender.jobs import manager
from hnf_blender.state.session_state import STATE


@pytest.mark.parametrize("stage", STAGES)
def test_a_cancelled_bake_leaves_neither_process_nor_folder(stage, warm_bake, tmp_path, monkeypatch) -> None:
    """Not even what a second Blender keeps for itself, which is killed."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.setenv("TMPDIR", str(temporary))
    small_scene()
    pid = start().pid
    assert reach(stage)
    assert len(my_folders()) == 1
    assert bpy.ops.hnf.bake_cancel() == {"FINISHED"}
    assert my_folders() == []
    assert list(temporary.iterdir()) == []
    assert is_gone(pid)
    assert STATE.job is None
    assert STATE.last_job.is_cancelled
    assert "canceled" in STATE.last_job.message
    assert kept() == NOTHING
    assert manager.tick() is None
