"""Which object is touched, and where a stroke passes from one to another, on surfaces whose answers are known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_contacts import RATE, grid_mesh, stroke

from hnf_core.action.contacts import CONTACT_TOLERANCE_M, action_from_contacts, find_contacts, plan_patches
from hnf_core.action.crossing import (
    CROSSING_MARGIN_M,
    LEAST_SHARE,
    STEP_OVER_M,
    Seam,
    can_step_over,
    choose_objects,
    choose_touched,
    find_seams,
    join_contacts,
    move_contacts,
    move_patch,
)
from hnf_core.field.carriers import Carriers
from hnf_core.field.height_profile import add_seams, compute_profile_power
from hnf_core.field.stroke import HeightProfile

LENGTHS = st.floats(0.0, 0.02, allow_nan=False)


def test_the_pen_steps_to_a_neighbor_and_not_into_depth() -> None:
    down = (0.0, 0.0, -1.0)
    assert can_step_over((0.0005, 0.0, -0.9 * STEP_OVER_M), down, 0.001)  # from a book to the table
    assert not can_step_over((0.0005, 0.0, -0.1), down, 0.001)  # from a box to the floor
    assert can_step_over((0.05, 0.0, -0.02), down, 0.001)  # over a gap to the next
    assert not can_step_over((0.05, 0.0, -0.3), down, 0.001)
    flat = (0.9950, 0.0, -0.0998)  # along a table that is seen from its edge, each step is long
    assert can_step_over((0.02, 0.0, 0.0), flat, 0.018)
    assert not can_step_over((0.02, 0.0, 0.0), flat, 0.005)


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_what_is_grazed_is_left_out(share) -> None:
    """A path of 0.1 m: the first object up to `share` of it, a gap in the air, then the second."""
    place = 0.1 * np.array([0.0, share, share, 1.0])
    points = np.stack([place, 0.0 * place, 0.0 * place], axis=1)
    chosen = choose_touched(["A", "A", "B", "B"], points)
    touched = ["A"] * (share >= LEAST_SHARE) + ["B"] * (share <= 1.0 - LEAST_SHARE)
    assert list(chosen) == touched or min(share, 1.0 - share) == pytest.approx(LEAST_SHARE)
    assert choose_touched(["A", "", "B"], np.zeros((3, 3))) == ("A", "B")
    assert choose_touched(["", ""], np.zeros((2, 3))) == ()


@settings(deadline=None)
@given(st.lists(st.tuples(LENGTHS, LENGTHS, LENGTHS), min_size=1, max_size=20))
def test_the_own_surface_comes_first_then_the_nearest(rows) -> None:
    distances = np.array(rows).T
    chosen = choose_objects(distances)
    for own, others, index in zip(distances[0], distances[1:].T, chosen, strict=True):
        if index == 0:
            under = own <= CONTACT_TOLERANCE_M
            assert under or (others > CONTACT_TOLERANCE_M).all()
            assert not under or (others + CROSSING_MARGIN_M >= own).all()
        else:
            assert others[index - 1] == others.min() <= CONTACT_TOLERANCE_M
            assert own > others[index - 1]


def test_one_object_is_itself() -> None:
    assert (choose_objects(np.linspace(0.0, 0.1, 7)[None]) == 0).all()


def frame(turn: float, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    matrix = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    matrix[:3, :3], matrix[:3, 3] = [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], shift
    return matrix


def cross(step_m: float, turn: float = 0.7):
    """A stroke from one square of 100 mm to another, that is turned in its own frame and `step_m` higher."""
    here, there = grid_mesh(), grid_mesh(turn=turn)
    to_here = frame(turn, (0.1, 0.0, step_m))
    samples = stroke([(0.0, 0.003, 0.0), (0.1, 0.003, 0.0)])
    moved = dataclasses.replace(
        samples,
        point=(samples.point - to_here[:3, 3]) @ to_here[:3, :3],
        tangent=samples.tangent @ to_here[:3, :3],
    )
    first, second = find_contacts(samples, here), find_contacts(moved, there)
    owner = choose_objects(np.stack([first.distance, second.distance]))
    return first, second, owner, to_here


def test_two_squares_feel_as_one_plane() -> None:
    first, second, owner, to_here = cross(0.0)
    joined = join_contacts([first, move_contacts(second, to_here)], owner)
    assert sorted(set(owner.tolist())) == [0, 1]
    assert (np.diff(owner) >= 0).all()
    whole = find_contacts(stroke([(0.0, 0.003, 0.0), (0.1, 0.003, 0.0)]), grid_mesh(size=0.4))
    np.testing.assert_allclose(joined.point[:, 1:], whole.point[:, 1:], atol=1e-9)
    np.testing.assert_allclose(joined.velocity, whole.velocity, atol=1e-9)
    assert joined.on_surface.all()
    assert find_seams(joined, owner) == ()


def test_directions_are_those_of_each_object_s_own_patches() -> None:
    first, second, owner, to_here = cross(0.0)
    parts = [
        plan_patches(dataclasses.replace(each, on_surface=each.on_surface & (owner == number)))
        for number, each in enumerate((first, second))
    ]
    patches = (*parts[0][0], *(move_patch(patch, to_here) for patch in parts[1][0]))
    index = np.where(parts[1][1] >= 0, parts[1][1] + np.int32(len(parts[0][0])), parts[0][1]).astype(np.int32)
    joined = join_contacts([first, move_contacts(second, to_here)], owner)
    together = action_from_contacts(joined, patches, index)
    alone = [action_from_contacts(each, *part) for each, part in zip((first, second), parts, strict=True)]
    for number, each in enumerate(alone):
        mine = (index >= 0) & (owner == number)
        np.testing.assert_allclose(together.direction[mine], each.direction[mine], atol=1e-9)
        np.testing.assert_allclose(together.speed[mine], each.speed[mine], atol=1e-9)
    assert together.contact.all()


@pytest.mark.parametrize("step", [2e-4, -1e-3])
def test_a_seam_is_where_and_as_high_as_it_is(step) -> None:
    first, second, owner, to_here = cross(step)
    joined = join_contacts([first, move_contacts(second, to_here)], owner)
    (seam,) = find_seams(joined, owner)
    assert seam.step_m == pytest.approx(step, rel=1e-6)
    # The other square wins when the own one is farther by the margin, and at one sample in 0.5 mm.
    assert 0.05 <= seam.position_m <= 0.05 + CROSSING_MARGIN_M + abs(step) + 0.1 / RATE


def test_there_and_back_is_one_seam() -> None:
    first, second, owner, to_here = cross(2e-4)
    joined = join_contacts([first, move_contacts(second, to_here)], owner)
    rows = np.concatenate([np.arange(len(owner)), np.arange(len(owner))[::-1]])
    both = dataclasses.replace(
        joined, **{name: getattr(joined, name)[rows] for name in type(joined).__dataclass_fields__}
    )
    assert find_seams(both, owner[rows]) == find_seams(joined, owner)


def place_contacts(point: np.ndarray, normal: np.ndarray, position: np.ndarray):
    """Contacts at these points; all that a seam does not read is that of another stroke."""
    first, *_ = cross(0.0)
    first_rows = {name: getattr(first, name)[: len(point)] for name in type(first).__dataclass_fields__}
    return dataclasses.replace(first, **first_rows | {"point": point, "normal": normal, "position": position})


@settings(deadline=None)
@given(fold=st.floats(-1.2, 1.2).filter(lambda fold: abs(fold) > 0.02), phase=st.floats(0.0, 1.0))
def test_a_fold_between_two_objects_is_no_step(fold, phase) -> None:
    """Wherever the samples lie on it."""
    position = (np.arange(12) - 6.0 + phase) * 1e-3
    sine, cosine, beyond = np.sin(fold), np.cos(fold), position > 0.0
    along, up = np.where(beyond, position * cosine, position), np.where(beyond, position * sine, 0.0)
    point = np.stack([along, 0.0 * position, up], axis=1)
    normal = np.where(beyond[:, None], [-sine, 0.0, cosine], [0.0, 0.0, 1.0])
    assert find_seams(place_contacts(point, normal, position), beyond.astype(np.int32)) == ()
    raised = point + np.where(beyond[:, None], [0.0, 0.0, 5e-3], 0.0)  # Five samples away, no fold explains it.
    if abs(fold) < 0.1:
        assert len(find_seams(place_contacts(raised, normal, position), beyond.astype(np.int32))) == 1


def test_a_narrow_object_has_two_edges() -> None:
    """A card 0.8 mm wide and 0.5 mm high."""
    position = np.arange(12) * 0.2e-3
    on_card = (position > 0.9e-3) & (position < 1.7e-3)
    point = np.stack([position, 0 * position, np.where(on_card, 0.5e-3, 0.0)], axis=1)
    contacts = place_contacts(point, np.tile([0.0, 0.0, 1.0], (12, 1)), position)
    up, down = find_seams(contacts, on_card.astype(np.int32))
    assert (up.step_m, down.step_m) == pytest.approx((0.5e-3, -0.5e-3))


def test_without_contact_there_is_no_seam() -> None:
    first, second, owner, to_here = cross(2e-4)
    joined = join_contacts([first, move_contacts(second, to_here)], owner)
    lifted = owner.copy()
    lifted[np.flatnonzero(np.diff(owner))[0] - 3 :][:7] = -1
    assert find_seams(joined, lifted) == ()


@pytest.mark.parametrize("profile", [None, "bumps"])
@pytest.mark.parametrize("step", [1e-4, -5e-4])
def test_a_seam_is_a_step_of_its_height_and_no_texture(profile, step) -> None:
    position = np.linspace(0.0, 0.1, 201)
    generator = np.random.default_rng(3)
    if profile is not None:
        profile = HeightProfile(50e-6, 0.0, 1e-6 * generator.standard_normal(2001), 2e-4)
    found = add_seams(profile, [Seam(0.05, step)], position)
    assert found is not None
    assert found.seam is not None
    assert found.seam[0] == 0.0
    assert found.seam[-1] == pytest.approx(step)
    assert abs(found.seam[len(found.seam) // 2] - step / 2.0) < 0.1 * abs(step)
    before = np.zeros(len(found.height)) if profile is None else profile.height
    np.testing.assert_allclose(found.height - found.seam, before, atol=1e-18)
    powers = compute_profile_power(found, Carriers()), compute_profile_power(dataclasses.replace(
        found, height=before, seam=None), Carriers())  # fmt: skip
    np.testing.assert_allclose(*powers, rtol=1e-9, atol=1e-30)


def test_no_seam_leaves_the_profile_alone() -> None:
    assert add_seams(None, [], np.zeros(3)) is None
