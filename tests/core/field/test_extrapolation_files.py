"""Ranges in weights files: kept whole, and silent where an older file has less to say."""

import dataclasses
import json

import numpy as np
import pytest

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.errors import WeightsError
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.training_ranges import compute_training_ranges
from hnf_core.field.weights import load_field, save_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM

CONFIG = FieldConfig(hidden=4, layers=1)
TOKENS = np.linspace(-7.0, -5.0, 2 * TOKEN_DIM, dtype=np.float32).reshape(2, TOKEN_DIM)
RANGES = compute_training_ranges(
    [make_steady_action(0.1, v, f, v) for v, f in ((0.03, 0.3), (0.3, 0.3), (0.1, 3.0))],
    TOKENS,
    [Mechanics(1e4, 0.0, None), Mechanics(2e4, 0.3, None)],
    ["finger", "pen"],
)


def written(tmp_path, ranges):
    path = tmp_path / "w.safetensors"
    save_field(path, Field(CONFIG, initial_parameters(CONFIG, 0), ranges))
    return path


@pytest.mark.parametrize(
    "change", [{}, {"sectors": ()}, {"hull": None, "sectors": None}, {"mechanics": None, "probes": None}]
)
def test_ranges_come_back_as_they_were_written(tmp_path, change):
    ranges = dataclasses.replace(RANGES, **change)
    again = load_field(written(tmp_path, ranges)).ranges
    for each in dataclasses.fields(ranges):
        np.testing.assert_equal(getattr(again, each.name), getattr(ranges, each.name))


def test_the_shipped_field_loads_and_knows_its_ranges():
    ranges = load_field().ranges
    assert ranges.speed[0] < 0.04 < 0.15 < ranges.speed[1]
    assert ranges.force[0] < 0.5 < 2.0 < ranges.force[1]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("speed_m_s", [0.3, 0.1]),
        ("speed_m_s", [0.0, 0.1]),
        ("force_n", "hard"),
        ("hull_m_s_n", [[0.1, -1.0]]),
        ("hull_m_s_n", [0.1, 1.0]),
        ("sectors", [True, False]),
        ("sectors", [False] * 16),
        ("mechanics", {"friction": {"span": None, "unknown": True}}),
        ("mechanics", []),
    ],
)
def test_damaged_ranges_are_refused(tmp_path, key, value):
    path = written(tmp_path, RANGES)
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    header["__metadata__"]["ranges"] = json.dumps({**json.loads(header["__metadata__"]["ranges"]), key: value})
    changed = json.dumps(header).encode()
    changed += b" " * (-len(changed) % 8)
    path.write_bytes(len(changed).to_bytes(8, "little") + changed + data[8 + size :])
    with pytest.raises(WeightsError, match="unreadable description"):
        load_field(path)
