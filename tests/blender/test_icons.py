"""Preview icons: every stroke has an image of its own, whatever its name."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hnf_blender.jobs.query_job import QUERY_ICON, to_icon_pixels
from hnf_blender.preview import controller
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.state import interface


@pytest.fixture(autouse=True)
def nothing_shown():
    PREVIEW.clear()
    yield
    PREVIEW.clear()
    interface.release_icons()


def heard(shade: float) -> SimpleNamespace:
    return SimpleNamespace(stamp="", style=None, image=np.full((4, 4, 4), shade, np.float32))


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
