"""Compare N = 1, N = 5 heads of one state as published, and N = 5 past states on held-out windows.

  Usage: python -m hnf_lab.experiments.memory_states [--seconds S] [--seeds N] [MATERIAL …]    needs the extra "train"

Prints the table of docs/field.md. All are trained on the same simulated strokes on library materials: a hand that rubs
to and fro under a varying load. Memory could matter at reversals, at the onset of sliding, and with stick–slip. Landing
and lifting are excluded, since the impact of a landing is synthesised by a separate contact term.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.datasets.registry import open_dataset
from hnf_core.field.field import FieldConfig
from hnf_core.training.from_recordings import make_fine_carriers
from hnf_core.training.train_material import Schedule, train_material

STROKE_S = 5.0
MATERIALS = ("oak-wood", "sandpaper", "denim", "rubber")
BASE_CONFIG = FieldConfig(hidden=64, states=1, carriers=make_fine_carriers(), physics=False, action_octaves=1)
CONFIGS = {
    "N = 1": BASE_CONFIG,
    "N = 5 heads of one state, as published": replace(BASE_CONFIG, states=5, accumulation="heads", spacing_s=0.0),
    "N = 5 past states, 10 ms apart": replace(BASE_CONFIG, states=5, accumulation="past"),
}


def make_rubbing_action(seed: int) -> Action:
    """Make a reversing stroke at 2 to 5 reversals per second, up to 0.05–0.2 m/s, with a load varying by half."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(STROKE_S * ACTION_RATE_HZ) + 1) / ACTION_RATE_HZ
    swing = np.sin(2.0 * np.pi * rng.uniform(1.0, 2.5) * time + rng.uniform(0.0, 6.3))
    angle, peak, load = rng.uniform(0.0, 6.3), np.exp(rng.uniform(*np.log((0.05, 0.2)))), rng.uniform(0.5, 2.0)
    velocity = peak * swing
    force = load * (1.0 + 0.5 * np.sin(2.0 * np.pi * rng.uniform(0.5, 2.0) * time))
    direction = np.sign(velocity + 1e-12)[:, None] * np.array([np.cos(angle), np.sin(angle)])
    position = np.concatenate([[0.0], np.cumsum(0.5 * (np.abs(velocity[1:]) + np.abs(velocity[:-1])))]) / ACTION_RATE_HZ
    return Action(ACTION_RATE_HZ, direction, np.abs(velocity), force, position, force > 0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("materials", nargs="*", default=list(MATERIALS), metavar="MATERIAL")
    parser.add_argument("--seconds", type=float, default=100.0)
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    library = open_dataset("simulated", None)
    print("| material | form | held-out log-likelihood per bin, more is better | spectrum dB | power dB |")
    print("|---|---|---|---|---|")
    for material in arguments.materials:
        process = library.process(material)
        assert process is not None
        recordings = process.record(
            [make_rubbing_action(seed) for seed in range(round(arguments.seconds / STROKE_S))], 0
        )
        for name, config in CONFIGS.items():
            tests = [
                train_material(recordings, config, seed, schedule=Schedule(epochs=25, batches=16)).test
                for seed in range(arguments.seeds)
            ]
            gain = np.array([-test.loss for test in tests if test])
            spread = f" ± {gain.std(ddof=1):.4f}" if len(gain) > 1 else ""
            distance = np.mean([test.distance_db for test in tests if test])
            bias = np.mean([test.bias_db for test in tests if test])
            print(f"| {material} | {name} | {gain.mean():.4f}{spread} | {distance:.2f} | {bias:+.2f} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
