"""Studies of small stimuli, and listeners who choose by the Bradley–Terry model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hnf_core.export.wav import write_wav
from hnf_core.signal import Signal
from hnf_core.study.plan import KeyEntry, Plan, Trial, compare_methods, load_key, make_study, order_trials
from hnf_core.study.results import Response, format_responses, get_responses_path

RATE_HZ = 10_000.0
Listener = Callable[[Trial, np.random.Generator], bool]
"""Whether a listener chooses the first stimulus of a trial."""


def write_noise(path: Path, seed: int, *, rms: float = 2.0, seconds: float = 0.05, rate_hz: float = RATE_HZ) -> Path:
    samples = np.random.default_rng(seed).normal(0.0, rms, round(seconds * rate_hz)).astype(np.float32)
    write_wav(path, Signal(samples, rate_hz, seed, {"material": f"secret-{path.parent.name}"}))
    return path


def write_methods(folder: Path, methods: tuple[str, ...], stimuli: int = 2) -> dict[str, Path]:
    for index, method in enumerate(methods):
        for stimulus in range(stimuli):
            write_noise(folder / method / f"texture{stimulus}.wav", 100 * index + stimulus)
    return {method: folder / method for method in methods}


def build_study(
    folder: Path, methods: tuple[str, ...] = ("alpha", "beta", "gamma"), stimuli: int = 2, **options: object
) -> tuple[Plan, dict[str, KeyEntry]]:
    comparisons = compare_methods(write_methods(folder / "in", methods, stimuli))
    plan, _ = make_study(folder / "study", comparisons, **options)
    return plan, load_key(folder / "study", plan)


def respond(plan: Plan, participant: str, listener: Listener, rng: np.random.Generator) -> list[Response]:
    return [
        Response(
            plan.id, participant, trial.number, trial.pair, trial.repeat, trial.reference, trial.first, trial.second,
            "first" if listener(trial, rng) else "second", 1, 1.5, 0, 0, "2030-01-01T00:00:00+00:00",
        )
        for trial in order_trials(plan, participant)
    ]  # fmt: skip


def bradley_terry_listener(key: Mapping[str, KeyEntry], scores: Mapping[str, float]) -> Listener:
    def choose(trial: Trial, rng: np.random.Generator) -> bool:
        difference = scores[key[trial.first].method] - scores[key[trial.second].method]
        return bool(rng.random() < 1.0 / (1.0 + np.exp(-difference)))

    return choose


def store(folder: Path, participant: str, rows: list[Response]) -> Path:
    path = get_responses_path(folder, participant)
    path.parent.mkdir(exist_ok=True)
    path.write_text(format_responses(rows), encoding="utf-8")
    return path
