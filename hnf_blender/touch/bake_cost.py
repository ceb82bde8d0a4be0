"""Estimated time of a bake: measured times of its parts, and how fast this machine is now."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hnf_core.action.contacts import Contacts, find_contacts, plan_patches
from hnf_core.errors import HnfError
from hnf_core.scene.camera import Patch
from hnf_core.threads import available_cpus

from ..bridge.scene.scene_names import find_object
from .session import Session, StrokeJob

REFERENCE_SECONDS = 20e-3
"""Time that the computation of `measure_slowness` took where the times below were measured [s]."""
PATTERN_CLOSEUP_SECONDS, IMAGE_CLOSEUP_SECONDS, PLAIN_CLOSEUP_SECONDS = 0.5, 0.07, 0.03
"""Processor time of a close-up with all pixels, of one whose first pass nearly suffices, and of one without detail."""
PREDICTION_SECONDS = 0.33
"""Processor time of a relief that D_φ predicts."""
PLACEMENT_SECONDS, SYNTHESIS_SECONDS = 0.7, 0.12
"""Processor time of placing a stroke, and of synthesizing one of a second or two."""
VIEW_SECONDS, LIT_VIEW_SECONDS = 1.25, 2.7
"""Processor time of a rendered view under the neutral dome, and under lights of the scene."""
FIGURE_SECONDS, FIRST_FIGURE_SECONDS = 0.58, 3.5
"""Processor time of the figure over a view, and of loading matplotlib and the denoiser before the first."""
START_SECONDS = 2.0
"""Processor time of the start of `hnf touch`: Blender, the scene, the field."""
SPREAD_SHARE = 0.6
"""Share of the processor time of close-ups and views that all cores work on."""
TRIES = 5
"""Number of times that the computation is timed; the median counts."""


@dataclass(frozen=True)
class Work:
    """Processor time of a part of a bake on the reference machine.

    Attributes
    ----------
    rendering_s : float
        Close-ups, predictions and views, of which all cores do a share [s].
    single_s : float
        What one core does [s].
    """

    rendering_s: float = 0.0
    single_s: float = 0.0

    def __add__(self, other: Work) -> Work:
        return Work(self.rendering_s + other.rendering_s, self.single_s + other.single_s)

    def estimate_seconds(self, slowness: float) -> float:
        """Return the time on the clock here [s] where nothing else is at work; `slowness` is `measure_slowness()`."""
        share = 1.0 - SPREAD_SHARE + SPREAD_SHARE / available_cpus()
        return slowness * (self.rendering_s * share + self.single_s)


NO_WORK = Work()
"""Nothing to do."""


def estimate_pictures(pictures: int, views: int, *, is_lit: bool) -> Work:
    """Estimate the work of drawing pictures over a number of views; `is_lit`: the scene has lights."""
    if not pictures:
        return NO_WORK
    return Work(
        views * (LIT_VIEW_SECONDS if is_lit else VIEW_SECONDS), pictures * FIGURE_SECONDS + FIRST_FIGURE_SECONDS
    )


@cache
def measure_slowness() -> float:
    """Measure, once in a process, how much longer a computation takes here than on the reference machine."""
    image, times = np.random.default_rng(0).standard_normal((512, 512)), []
    for _ in range(TRIES):
        started = time.thread_time()
        np.fft.irfft2(np.exp(-np.abs(np.fft.rfft2(image))))
        times.append(time.thread_time() - started)
    return float(np.median(times)) / REFERENCE_SECONDS


@dataclass(frozen=True)
class TouchedPart:
    """An object that a stroke may touch, the stroke's contacts in its frame, and the patches that cover them."""

    obj: Any
    contacts: Contacts
    patches: tuple[Patch, ...]


def find_touched_parts(session: Session, job: StrokeJob) -> list[TouchedPart]:
    """Return the parts of a job's stroke; none if it is still to be placed, or cannot be read."""
    if job.stroke is None:
        return []
    obj, samples = find_object(session.scene, job.object_name), job.stroke.samples
    try:
        found = [(obj, find_contacts(samples, job.stroke.get_surface(session.get_surface(obj).mesh)))]
        for crossed in job.stroke.crossed:
            other = find_object(session.scene, crossed.name)
            found.append((other, find_contacts(crossed.move_samples(samples), session.get_surface(other).mesh)))
    except HnfError:  # the bake will say so
        return []
    return [TouchedPart(each, contacts, plan_patches(contacts)[0]) for each, contacts in found]
