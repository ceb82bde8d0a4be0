"""A patch is described beside the casting of the next one, and never while Blender is asked for something."""

from __future__ import annotations

import threading

import bpy
import numpy as np
import pytest
from touch_scene import PLATE, line_stroke, ridge_plate

from hnf_blender.bridge.render import closeup
from hnf_blender.touch import bake_patches
from hnf_blender.touch.report import Counts
from hnf_blender.touch.session import gather_jobs, make_scene_session
from hnf_blender.touch.synthesise import bake_stroke_steps
from hnf_core.errors import MaterialError

LONG_S = 30.0


def baked(folder, counts):
    session = make_scene_session(bpy.context.scene, bpy.context.view_layer, folder)
    (job,) = gather_jobs(session).jobs
    steps = bake_stroke_steps(
        job.stroke, session.get_touched_object(bpy.data.objects[PLATE]), {}, folder / "cache", counts, session.predictor
    )
    shares = []
    while True:
        try:
            shares.append(next(steps))
        except StopIteration as finished:
            return finished.value, shares


def test_patches_are_described_beside_rays_and_never_beside_a_render(tmp_path, monkeypatch) -> None:
    ridge_plate()
    line_stroke("Along")
    plain, _ = baked(tmp_path / "plain", Counts())
    patches = len(plain.patches)
    assert patches > 1
    busy, cast_began, described, beside, renders = threading.Event(), threading.Semaphore(0), [], [], []
    record, cast, render = bake_patches._make_record, closeup.cast_view, closeup.render_passes

    def slow_record(*args):
        busy.set()
        described.append(len(described) == patches - 1 or cast_began.acquire(timeout=LONG_S))
        found = record(*args)
        busy.clear()
        return found

    def watched_cast(*args):
        if beside:
            beside.append(busy.wait(LONG_S))
            cast_began.release()
        else:  # nobody is before the first
            beside.append(busy.is_set())
        return cast(*args)

    def watched_render(*args):
        renders.append(busy.is_set())
        return render(*args)

    monkeypatch.setattr(bake_patches, "_make_record", slow_record)
    monkeypatch.setattr(closeup, "cast_view", watched_cast)
    monkeypatch.setattr(closeup, "render_passes", watched_render)
    counts = Counts()
    stroke, shares = baked(tmp_path, counts)
    assert described == [True] * patches
    assert beside == [False] + [True] * (patches - 1)
    assert renders == [False] * patches
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert counts.tokens == counts.close_ups == patches
    for one, other in zip(plain.records, stroke.records, strict=True):
        assert np.array_equal(one.token, other.token)


def test_what_goes_wrong_in_a_description_is_told_and_nothing_is_left_running(tmp_path, monkeypatch) -> None:
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
