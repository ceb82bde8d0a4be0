"""What another model's way of synthesis costs on the same stroke: HaTT's piecewise autoregression, sample by sample.

The model is made up, as large as HaTT's own: time does not follow its numbers, and no file of theirs is needed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.autoregressive import HattProcess
from ..datasets.hatt_models import TextureModel

Float = NDArray[np.float64]
Index = NDArray[np.int64]

AR_ORDER = 19
AR_SPEEDS, AR_FORCES = 7, 5
"""Medians of twenty of HaTT's models: order 19, 34 places, 43 triangles. Here 35 and 48."""
MAX_SPEED_M_S, MAX_FORCE_N = 0.22, 4.2
AR_VARIANCE = 0.01
_LSF_STRAY, _LSF_SHIFT_RAD = 0.3, 0.7
"""Of the gap between even LSFs, at most: how far they stray, so that no place sounds like its neighbour. Radians from a
place to the next."""


def synthesise_autoregressive(action: Action, seed: int) -> Float:
    """a(t) at 10 kHz of a made-up texture, by HaTT's rule (datasets.autoregressive)."""
    return HattProcess(make_texture_model()).record([action], seed)[0].samples


def make_texture_model() -> TextureModel:
    """Places on a grid of speed and force; those on the axes are silent, as HaTT's are."""
    speed, force = (
        each.ravel()
        for each in np.meshgrid(
            np.linspace(0.0, MAX_SPEED_M_S, AR_SPEEDS), np.linspace(0.0, MAX_FORCE_N, AR_FORCES), indexing="ij"
        )
    )
    even = np.pi * np.arange(1, AR_ORDER + 1) / (AR_ORDER + 1)
    stray = np.sin(2.0 * np.arange(AR_ORDER) + _LSF_SHIFT_RAD * np.arange(len(speed))[:, None])
    return TextureModel(
        material="made up", source="hnf bench", sample_rate=10_000.0, speeds=speed, forces=force,
        triangles=_make_triangles(), ar_lsf=even + _LSF_STRAY * np.pi / (AR_ORDER + 1) * stray, ma_lsf=np.zeros((len(speed), 0)),
        variances=AR_VARIANCE * (speed * force > 0.0), gains=np.ones(len(speed)), friction=None,
        max_speed=MAX_SPEED_M_S, max_force=MAX_FORCE_N,
    )  # fmt: skip


def _make_triangles() -> Index:
    """Two in each cell of the grid."""
    place = np.arange(AR_SPEEDS * AR_FORCES).reshape(AR_SPEEDS, AR_FORCES)
    a, b, c, d = (each.ravel() for each in (place[:-1, :-1], place[1:, :-1], place[:-1, 1:], place[1:, 1:]))
    return np.concatenate([np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)])
