"""Cleaning: what belongs to nothing goes, the rest stays, and neither scale nor place nor order matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_shapes import fog, joined, moved, sheet, sphere, torus

from hnf_core.errors import SceneError
from hnf_core.scene.splats.gaussians import Splats
from hnf_core.scene.splats.prune import PRUNE_REASONS, prune_splats

BALL = sphere(600)
SPECKS = moved(sphere(6), 0.01, (2.0, 0.0, 0.0))


def changed(cloud: Splats, which: slice, **values: float) -> Splats:
    parts = {name: getattr(cloud, name).copy() for name in values}
    for name, value in values.items():
        parts[name][which] = value
    return replace(cloud, **parts)


@pytest.mark.parametrize("cloud", [BALL, torus(), sheet(), fog(), joined(BALL, moved(BALL, 0.5, (4.0, 0.0, 0.0)))],
                         ids=["sphere", "torus", "sheet", "fog", "two"])  # fmt: skip
def test_what_holds_together_stays(cloud):
    assert prune_splats(cloud).mask.mean() > 0.99


@pytest.mark.parametrize(
    ("reason", "dirt"),
    [
        ("broken", changed(SPECKS, slice(None), means=np.nan)),
        ("broken", changed(SPECKS, slice(None), scales=0.0)),
        ("broken", changed(SPECKS, slice(None), rotations=np.inf)),
        ("faint", changed(BALL, slice(None), opacities=0.01)),
        ("far", moved(SPECKS, by=(1e6, 0.0, 0.0))),
        ("giant", changed(SPECKS, slice(None), scales=5.0)),
        ("floating", SPECKS),
    ],
)
def test_dirt_goes_for_its_reason_and_nothing_else_goes(reason, dirt):
    alone = prune_splats(BALL)
    assert alone.mask.all()
    cleaned = prune_splats(joined(BALL, dirt))
    assert cleaned.mask.tolist() == [True] * len(BALL) + [False] * len(dirt)
    assert cleaned.dropped == {each: len(dirt) * (each == reason) for each in PRUNE_REASONS}
    np.testing.assert_array_equal(cleaned.splats.means, BALL.means)
    assert f"{len(dirt)} {reason}" in cleaned.summary()


def test_one_far_splat_in_five_costs_the_rest_nothing():
    random = np.random.default_rng(1)
    stray = replace(sphere(150), means=(1e6 * random.standard_normal((150, 3))).astype(np.float32))
    cleaned = prune_splats(joined(BALL, stray))
    assert cleaned.mask[: len(BALL)].all()
    assert not cleaned.mask[len(BALL) :].any()


def test_a_thin_haze_around_a_solid_thing_goes():
    random = np.random.default_rng(2)
    haze = replace(sphere(60), means=random.uniform(-2.0, 2.0, (60, 3)).astype(np.float32))
    outside = np.linalg.norm(haze.means, axis=1) > 1.4
    dense = sphere(3000)
    cleaned = prune_splats(joined(dense, haze.take(outside)))
    assert cleaned.mask[: len(dense)].all()
    assert cleaned.mask[len(dense) :].mean() < 0.1


@settings(max_examples=15, deadline=None)
@given(power=st.integers(-20, 20), seed=st.integers(0, 1000))
def test_neither_scale_nor_order_matters(power, seed):
    cloud = joined(BALL, SPECKS, changed(BALL.take(np.arange(9)), slice(None), opacities=0.01))
    plain = prune_splats(cloud)
    order = np.random.default_rng(seed).permutation(len(cloud))
    other = prune_splats(moved(cloud.take(order), 2.0**power))
    np.testing.assert_array_equal(other.mask, plain.mask[order])
    assert other.dropped == plain.dropped
    assert other.size == plain.size * 2.0**power
    assert other.spacing == plain.spacing * 2.0**power


@settings(max_examples=10, deadline=None)
@given(scale=st.floats(1e-4, 1e4), shift=st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_any_scale_and_place_keeps_what_is_clear(scale, shift):
    cleaned = prune_splats(moved(moved(joined(BALL, SPECKS), by=shift), scale))
    assert cleaned.mask.tolist() == [True] * len(BALL) + [False] * len(SPECKS)


@settings(max_examples=15, deadline=None)
@given(count=st.integers(0, 40), seed=st.integers(0, 1000), faintest=st.floats(0.0, 1.0))
def test_a_cloud_is_never_emptied_in_silence(count, seed, faintest):
    random = np.random.default_rng(seed)
    cloud = fog(count, seed)
    cloud = replace(cloud, opacities=random.uniform(0.0, faintest, count).astype(np.float32))
    try:
        cleaned = prune_splats(cloud)
    except SceneError:
        with pytest.raises(SceneError, match=f"^cloud.ply: .* {count} splats"):
            prune_splats(cloud, where="cloud.ply")
    else:
        assert len(cleaned.splats) == cleaned.mask.sum() >= 4
        assert cleaned.mask.sum() + sum(cleaned.dropped.values()) == count


def test_splats_in_one_point_are_refused():
    with pytest.raises(SceneError, match="one point"):
        prune_splats(replace(BALL, means=np.ones_like(BALL.means)))
