"""Reference preparation of a stroke: F_Θ evaluated at every state (200 Hz), whatever the action does in between."""

from __future__ import annotations

import numpy as np

from hnf_core.field.adaptive_sampling import BATCH_SAMPLES, SampledEmission
from hnf_core.field.field import Evaluator, Field, evaluate
from hnf_core.field.prepare import PreparedStroke, follow_stroke, make_evaluate_at, prepare_sampled
from hnf_core.field.stroke import SAMPLES_PER_STATE, StrokeInput, resample_action


def prepare_every_state(
    field: Field, stroke: StrokeInput, *, seed: int, evaluator: Evaluator = evaluate
) -> PreparedStroke:
    """Prepare a stroke of a field with one head as `prepare_stroke`, but from F_Θ at each of its states."""
    action, token_index = resample_action(stroke)
    course = follow_stroke(field, stroke, action, token_index, seed)
    evaluate_at = make_evaluate_at(field, stroke, action, token_index, evaluator, course)
    at = SAMPLES_PER_STATE * np.arange(len(action.speed))
    emissions = [evaluate_at(at[low : low + BATCH_SAMPLES]) for low in range(0, len(at), BATCH_SAMPLES)]
    alpha = np.concatenate([each.alpha[:, 0].astype(np.float32) for each in emissions])
    sampled = SampledEmission(at, alpha, np.concatenate([each.sigma_dt for each in emissions]), 0.0)
    return prepare_sampled(field, stroke, seed, action, token_index, sampled, course)
