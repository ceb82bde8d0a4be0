"""Preview icons: every stroke has an image of its own, whatever its name."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_blender.jobs.query_job import QUERY_ICON, to_icon_pixels
from hnf_blender.ops.preview_ops import compute_fraction, compute_frame
from hnf_blender.preview import controller
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.stroke_image import SIZE_PX, ImageStyle
from hnf_blender.state import interface


@pytest.fixture(autouse=True)
def nothing_shown():
    PREVIEW.clear()
    yield
    PREVIEW.clear()
    interface.release_icons()


def heard(shade: float) -> SimpleNamespace:
    return SimpleNamespace(stamp="", style=ImageStyle(), image=np.full((4, 4, 4), shade, np.float32))


def test_a_stroke_named_like_the_query_icon_has_its_own_icon() -> None:
    interface.set_icon(QUERY_ICON, to_icon_pixels(np.full((4, 4, 3), 51, np.uint8)))
    probe = interface._previews[QUERY_ICON]
    controller.store_result(QUERY_ICON, heard(1.0))
    assert interface._previews[QUERY_ICON] is probe
    assert probe.image_pixels_float[0] == pytest.approx(0.2)
    assert len(interface._previews) == 2


def test_a_and_b_of_a_stroke_change_one_picture() -> None:
    controller.store_result("Scrape", heard(0.25))
    PREVIEW.references["Scrape"] = heard(0.75)
    (picture,) = interface._previews.values()
    for shade in (0.75, 0.25):  # kept as bytes
        assert controller.toggle_ab("Scrape")
        assert picture.image_pixels_float[0] == pytest.approx(shade, abs=0.01)


@given(st.floats(-50.0, 50.0), st.sampled_from([24.0, 25.0, 60.0]), st.booleans(), st.floats(0.05, 20.0), st.data())
@settings(max_examples=50, deadline=None)
def test_a_press_goes_to_the_frame_whose_playhead_is_there(start, fps, subframes, seconds, data) -> None:
    """Within half a frame, or within a pixel where the scene shows subframes; twice the same frame draws nothing."""
    fraction = data.draw(st.floats(0.0, 1.0))
    stroke = SimpleNamespace(name="Scrape", hnf_stroke=SimpleNamespace(start=start))
    render = SimpleNamespace(fps=fps, fps_base=1.0)
    scene = SimpleNamespace(render=render, show_subframe=subframes, frame_current_final=-1e6)
    scene.frame_current_final = compute_frame(scene, stroke, fraction * seconds)
    PREVIEW.clear()
    shown = SimpleNamespace(stamp="", style=ImageStyle(), image=np.zeros((SIZE_PX, SIZE_PX, 4), np.float32))
    shown.signal = SimpleNamespace(duration_s=seconds)
    controller.store_result("Scrape", shown)
    controller.update_playhead(stroke, scene)
    assert not controller.update_playhead(stroke, scene)
    stands = PREVIEW.playheads.get("Scrape")
    allowed = 1e-6 if subframes else 0.5 / fps / seconds + 1e-6
    if stands is None:
        assert not subframes
        assert min(fraction, 1.0 - fraction) <= allowed
    else:
        assert stands == pytest.approx(fraction, abs=allowed)


def test_the_ends_of_the_picture_are_the_ends_of_the_stroke() -> None:
    assert [compute_fraction(x, 52, 218) for x in (0, 52, 135, 218, 900)] == [0.0, 0.0, 0.5, 1.0, 1.0]
