"""Method: HaTT's piecewise autoregression, fitted to recordings and played by HaTT's own rule.

Isotropic by construction: it sees speed and force, never direction. See piecewise_ar_fit for how it is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..action.action import Action
from ..datasets.autoregressive import HattProcess
from ..datasets.hatt_models import TextureModel
from .by_duration import render_by_duration
from .method import Form, MaterialRecordings
from .pieces import cut_segments
from .piecewise_ar_fit import GRIDS, MAX_ORDER, fit_best_grid, make_texture_model

Float = NDArray[np.float64]

_SEEDS_PER_CALL = 1000


@dataclass(frozen=True)
class FittedPiecewiseAr:
    """One material. model: in HaTT's own form."""

    model: TextureModel

    def render(self, actions: Sequence[Action], seed: int) -> list[Float]:
        """By datasets.autoregressive.HattProcess; outside the recorded speeds and forces as HaTT does, clamped."""
        process = HattProcess(self.model)
        return render_by_duration(
            actions, lambda same, group: [r.samples for r in process.record(same, _SEEDS_PER_CALL * seed + group)]
        )


@dataclass(frozen=True)
class PiecewiseAr:
    """Method: piecewise AR (HaTT's model class, our own fit). grids: speeds × forces to choose from."""

    name: str = "piecewise AR (HaTT)"
    form: Form = "natural"
    grids: tuple[tuple[int, int], ...] = GRIDS

    def fit(self, specimen: MaterialRecordings, seed: int) -> FittedPiecewiseAr:
        """Deterministic: nothing is drawn. Raises FileError where no piece of a recording is steady and in contact."""
        del seed
        pieces = cut_segments(specimen.recordings, MAX_ORDER)
        fitted = fit_best_grid(pieces, self.grids)
        return FittedPiecewiseAr(make_texture_model(fitted.grid, fitted.lsf, fitted.variance, pieces, specimen.name))
