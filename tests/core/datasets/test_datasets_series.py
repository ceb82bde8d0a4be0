"""Laws of the way from measured series to a(t) and action; and of reading XML that nobody vouches for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.datasets.data_files import parse_xml
from hnf_core.datasets.time_series import (
    build_action,
    check_time_grid,
    derive_motion,
    interpolate_series,
    resample_to_action_rate,
    smooth_series,
)
from hnf_core.errors import FileError
from hnf_core.tables import parse_unit_factor

grids = st.integers(0, 2**32).map(lambda seed: np.cumsum(np.random.default_rng(seed).uniform(0.6, 1.4, 40)))
coefficients = st.tuples(*[st.floats(-3.0, 3.0)] * 3)


@settings(max_examples=60, deadline=None)
@given(grids, coefficients)
def test_a_parabola_on_any_grid_is_resampled_exactly(time, c):
    at = np.linspace(time[1], time[-2], 101)
    values = np.polynomial.polynomial.polyval(time, c)
    np.testing.assert_allclose(interpolate_series(time, values, at), np.polynomial.polynomial.polyval(at, c), atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(grids)
def test_samples_themselves_come_back_and_ends_are_held(time):
    values = np.random.default_rng(0).standard_normal((40, 2))
    np.testing.assert_allclose(interpolate_series(time, values, time), values, atol=1e-12)
    outside = interpolate_series(time, values, np.array([time[0] - 9.0, time[-1] + 9.0]))
    np.testing.assert_allclose(outside, values[[0, -1]], atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(grids, st.integers(1, 38), st.floats(4.0, 300.0), st.integers(0, 999))
def test_a_long_interval_is_bridged_by_a_straight_line(time, row, factor, seed):
    time = time + np.where(np.arange(40) > row, factor * np.median(np.diff(time)), 0.0)
    values = np.random.default_rng(seed).standard_normal((40, 2))
    fraction = np.linspace(0.0, 1.0, 21)[:, None]
    inside = interpolate_series(time, values, time[row] + fraction[:, 0] * (time[row + 1] - time[row]))
    np.testing.assert_allclose(inside, values[row] + fraction * (values[row + 1] - values[row]), atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.floats(-5.0, 5.0), st.floats(-50.0, 50.0))
def test_smoothing_leaves_a_ramp_alone_up_to_its_ends(start, slope):
    ramp = start + slope * np.arange(800) / 1000.0
    np.testing.assert_allclose(smooth_series(ramp, 1000.0), ramp, atol=1e-7 * (1.0 + abs(start) + abs(slope)))


@pytest.mark.parametrize(("tone", "gain"), [(2.0, 0.9966), (20.0, np.sqrt(0.5)), (100.0, 1.7e-4)])
def test_a_hand_is_slower_than_20_hz(tone, gain):
    time = np.arange(20_000) / 10_000.0
    kept = resample_to_action_rate(time, np.sin(2 * np.pi * tone * time), 0.5, 200)
    expected = gain * np.sin(2 * np.pi * tone * (0.5 + np.arange(200) / 200.0))
    np.testing.assert_allclose(kept, expected, atol=2e-3)


def test_motion_of_a_turn_and_of_rest():
    path = np.zeros((300, 2))
    path[100:200, 0] = 0.1 * np.arange(100) / 200.0
    path[200:, 0] = path[199, 0]
    path[200:, 1] = 0.1 * np.arange(1, 101) / 200.0
    direction, speed = derive_motion(path)
    np.testing.assert_allclose(direction[:190], np.tile([1.0, 0.0], (190, 1)), atol=1e-12)  # also while at rest
    np.testing.assert_allclose(direction[210:], np.tile([0.0, 1.0], (90, 1)), atol=1e-12)
    np.testing.assert_allclose(speed[110:190], 0.1)
    assert np.all(speed[:98] == 0.0)
    np.testing.assert_array_equal(derive_motion(np.zeros((9, 2)))[0], np.tile([1.0, 0.0], (9, 1)))


def test_negative_speed_and_force_count_as_none():
    action = build_action(np.tile([1.0, 0.0], (3, 1)), np.array([-1.0, 0.1, 0.1]), np.array([1.0, -0.2, 1.0]))
    assert action.speed.tolist() == [0.0, 0.1, 0.1]
    assert action.contact.tolist() == [True, False, True]
    np.testing.assert_allclose(action.position, [0.0, 0.00025, 0.00075])


@pytest.mark.parametrize(("grid", "row"), [([0.0, 1.0, 1.0, 2.0], 3), ([0.0, 1.0, 2.0, 1.5], 4)])
def test_a_grid_that_stands_is_refused(grid, row):
    with pytest.raises(FileError, match=f"sample {row}"):
        check_time_grid(np.array(grid), "x")


@pytest.mark.parametrize(
    ("quantity", "written", "factor"),
    [("acceleration", " m/s² ", 1.0), ("acceleration", "G", 9.80665), ("speed", "MM/S", 1e-3), ("force", "mN", 1e-3),
     ("position", "µm", 1e-6), ("time", "[ms]", 1e-3), ("rate", "kHz", 1e3), ("acceleration", "m/s^2", 1.0)],
)  # fmt: skip
def test_units_as_people_write_them(quantity, written, factor):
    assert parse_unit_factor(quantity, written, "x") == pytest.approx(factor)


@pytest.mark.parametrize("written", ["", "m", "furlong", "m/s^3"])
def test_other_units_are_refused_with_those_that_are_known(written):
    with pytest.raises(FileError, match=r"no unit of speed.*mm/s"):
        parse_unit_factor("speed", written, "x")


def test_namespaces_and_comments_do_not_matter():
    root = parse_xml(b'<a:x xmlns:a="urn:a"><!-- no --><a:value>1</a:value></a:x>', "x")
    assert (root.tag, root[0].tag, root[0].text) == ("x", "value", "1")


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_a_tree_or_a_file_error(data):
    try:
        root = parse_xml(data, "x")
    except FileError:
        return
    assert root.tag


@pytest.mark.parametrize(
    "data",
    [
        b'<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>',
        b"<!DOCTYPE a [<!ENTITY % b \"<!ENTITY c 'x'>\"> %b;]><a>&c;</a>",
        b"<!DOCTYPE a><a/>",
    ],
)
def test_any_dtd_is_refused(data):
    with pytest.raises(FileError, match="line 1 declares a DTD"):
        parse_xml(data, "x")
