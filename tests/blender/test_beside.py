"""Concurrent description of patches: in parallel with ray casting, never with a call into Blender."""

from __future__ import annotations

import threading

import bpy
import numpy as np
import pytest
from touch_scene import PLATE, line_stroke, ridge_plate

from hnf_blender.bridge import closeup
from hnf_blender.touch import bake_patches
from hnf_blender.touch.report import Counts
from hnf_blender.touch.session import gather_jobs, make_scene_session
from hnf_blender.touch.synthesise import bake_stroke
from hnf_core.errors import MaterialError
from hnf_core.progress import Cancelled, Progress

LONG_S = 30.0


def baked(folder, counts, cancel_at=None, shares=None):
    """The bake of the only stroke, and the shares of it that were told, which are added to a list that is given."""
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
    (job,) = gather_jobs(session).jobs
    touched, shares = session.get_touched_object(bpy.data.objects[PLATE]), [] if shares is None else shares

    def show(progress: Progress) -> None:
        shares.append(progress.fraction)
        if len(shares) == cancel_at:
            raise Cancelled

    stroke = bake_stroke(job.stroke, touched, {}, folder / "cache", counts, session.predictor, show)
    return stroke, shares


def test_patches_are_described_during_ray_casts_but_not_renders(tmp_path, monkeypatch) -> None:
    ridge_plate()
    line_stroke("Along")
    plain, _ = baked(tmp_path / "plain", Counts())
    patches = len(plain.patches)
    assert patches > 1
    busy, cast_began, described, beside, renders = threading.Event(), threading.Semaphore(0), [], [], []
    shares: list[float] = []
    record, cast, render = bake_patches._make_record, closeup.cast_view, closeup.render_passes

    def slow_record(*args):
        busy.set()
        described.append(len(described) == patches - 1 or cast_began.acquire(timeout=LONG_S))
        found = record(*args)
        busy.clear()
        return found

    def watched_cast(*args):
        if shares:
            beside.append(busy.wait(LONG_S))
            cast_began.release()
        else:  # before a share is told, nothing has been given to be described
            beside.append(busy.is_set())
        return cast(*args)

    def watched_render(*args):
        renders.append(busy.is_set())
        return render(*args)

    monkeypatch.setattr(bake_patches, "_make_record", slow_record)
    monkeypatch.setattr(closeup, "cast_view", watched_cast)
    monkeypatch.setattr(closeup, "render_passes", watched_render)
    counts = Counts()
    stroke, _ = baked(tmp_path, counts, shares=shares)
    assert described == [True] * patches
    # The small view that chooses the sampling of a procedural relief comes first, and alone.
    assert beside == [False] * (len(beside) - patches + 1) + [True] * (patches - 1)
    assert renders == [False] * len(beside)
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert counts.tokens == counts.close_ups == patches
    for one, other in zip(plain.records, stroke.records, strict=True):
        assert np.array_equal(one.token, other.token)


def test_a_description_error_is_raised_and_no_thread_is_left(tmp_path, monkeypatch) -> None:
    ridge_plate()
    line_stroke("Along")
    before, record, count = set(threading.enumerate()), bake_patches._make_record, iter(range(100))

    def failing(*args):
        if next(count) == 1:
            raise MaterialError("no such relief.")
        return record(*args)

    monkeypatch.setattr(bake_patches, "_make_record", failing)
    with pytest.raises(MaterialError, match="no such relief"):
        baked(tmp_path, Counts())
    assert set(threading.enumerate()) <= before
    monkeypatch.setattr(bake_patches, "_make_record", record)
    again = Counts()
    stroke, _ = baked(tmp_path, again)
    assert again.close_ups == len(stroke.patches) - 1  # the first one was stored
    assert all(np.isfinite(each.token).all() for each in stroke.records)


def test_a_cancelled_bake_leaves_stored_patches_only(tmp_path) -> None:
    ridge_plate()
    line_stroke("Along")
    threads, data = set(threading.enumerate()), len(list(bpy.data.user_map()))
    with pytest.raises(Cancelled):
        baked(tmp_path, Counts(), cancel_at=2)
    assert set(threading.enumerate()) <= threads
    assert len(list(bpy.data.user_map())) == data
    assert len(list((tmp_path / "cache").glob("*.npz"))) == 1
    again = Counts()
    stroke, _ = baked(tmp_path, again)
    assert again.close_ups == len(stroke.patches) - 1
