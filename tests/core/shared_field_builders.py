"""Four specimens, training strokes on them, references of them, and a small network."""

from __future__ import annotations

from functools import cache

from hnf_core.field.field import FieldConfig, initial_parameters
from hnf_core.material.library import LIBRARY_PATH
from hnf_core.training.model import FieldNetwork
from hnf_lab.shared_field.references import simulate_references
from hnf_lab.shared_field.simulated_strokes import StrokeCondition
from hnf_lab.shared_field.training_data import Sizes, build_training_data, load_specimens

SIZES = Sizes(patches=2, described=1, strokes=4, random=2, random_strokes=2, seconds=0.15)
CONFIG = FieldConfig(hidden=8, layers=1, line_gains=True)
CONDITIONS = [StrokeCondition(30, 1.0, 0.2), StrokeCondition(40, 0.7, 1.7)]


@cache
def pick_specimens():
    every = load_specimens(LIBRARY_PATH, SIZES)
    return [next(each for each in every if each.name == name) for name in ("oak-wood", "denim", "oak-wood/1", "silk/1")]


@cache
def gather_strokes():
    return build_training_data(pick_specimens(), SIZES, 3, workers=1)


@cache
def make_references():
    return simulate_references(pick_specimens(), CONDITIONS, 5, workers=1, seconds=0.3)


def network(config=CONFIG):
    return FieldNetwork(config, initial_parameters(config, 0))
