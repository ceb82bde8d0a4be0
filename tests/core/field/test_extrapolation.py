"""Confidence is 1 inside the training ranges and falls with a warning outside them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.action.primitive_path import make_primitive_action
from hnf_core.action.primitives import PRIMITIVE_NAMES
from hnf_core.action.synthetic_actions import make_circular_action, make_random_smooth_action, make_steady_action
from hnf_core.errors import StrokeError
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.range_check import check_ranges
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.training_ranges import PropertyRange, TrainingRanges, compute_training_ranges
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import load_library
from hnf_core.material.token import TOKEN_NAMES

LIBRARY = load_library()[:4]
TOKENS = np.stack([material.token for material in LIBRARY])
MECHANICS = (Mechanics(1e4, 0.1, 0.2), Mechanics(1e5, 0.4, 0.8))
MIDDLE = Mechanics(3e4, 0.2, 0.4)
SPEEDS, FORCES = (0.03, 0.3), (0.3, 3.0)
EVERYWHERE = [
    make_steady_action(0.1, v, f, angle) for v in SPEEDS for f in FORCES for angle in np.arange(16) * np.pi / 8
]  # fmt: skip
CONFIG = FieldConfig(hidden=4, layers=1)
PARAMETERS = initial_parameters(CONFIG, 0)


def trained(actions=EVERYWHERE, tokens=TOKENS, mechanics=MECHANICS, **keywords) -> Field:
    return Field(CONFIG, PARAMETERS, compute_training_ranges(actions, tokens, mechanics, **keywords))


def judge(field: Field, action: Action, token=TOKENS[0], mechanics=MIDDLE) -> tuple[float, str]:
    confidence, warnings = check_ranges(field, uniform_stroke(action, token, mechanics), action)
    assert 0.0 <= confidence <= 1.0
    # Whatever lowers it is said, and nothing else is.
    assert (confidence < 1.0) == bool(warnings)
    return confidence, " ".join(warnings)


FIELD = trained()
speeds, forces, angles = st.floats(*SPEEDS), st.floats(*FORCES), st.floats(-np.pi, np.pi)


@given(speeds, forces, angles, st.integers(0, 3), st.sampled_from([*MECHANICS, MIDDLE]))
def test_inside_every_range_it_is_sure_and_silent(speed, force, angle, material, mechanics):
    assert judge(FIELD, make_steady_action(0.1, speed, force, angle), TOKENS[material], mechanics) == (1.0, "")


@settings(max_examples=30)
@given(st.lists(st.integers(0, 2**31), min_size=1, max_size=4), st.sampled_from(["pen", "finger"]))
def test_what_it_was_trained_on_is_inside(seeds, probe):
    actions = [make_random_smooth_action(1.0, seed, speed_m_s=SPEEDS, force_n=FORCES, probe=probe) for seed in seeds]
    field = trained(actions)
    assert all(judge(field, action) == (1.0, "") for action in actions)


@pytest.mark.parametrize("name", PRIMITIVE_NAMES)
def test_starts_and_ends_of_a_stroke_are_not_held_against_it(name):
    assert judge(FIELD, make_primitive_action(name)) == (1.0, "")


further = st.floats(0.0, 4.0)
"""Octaves, token widths …: how far two strokes lie outside; the further one must not be the surer."""


def falls(field: Field, near: float, far: float, at) -> None:
    near, far = sorted((near, far))
    first, second = at(near), at(far)
    assert second[0] <= first[0]
    if far > near + 0.2 and near > 0.4:
        assert second[0] < first[0] < 1.0


@given(further, further, st.booleans())
def test_speed(near, far, fast):
    edge, sign = (SPEEDS[1], 1) if fast else (SPEEDS[0], -1)
    falls(FIELD, near, far, lambda octaves: judge(FIELD, make_steady_action(0.1, edge * 2.0 ** (sign * octaves), 1.0)))
    confidence, words = judge(FIELD, make_steady_action(0.1, 0.6 if fast else 0.015, 1.0))
    assert confidence == pytest.approx(0.5)
    assert ("Speed reaches 600 mm/s" if fast else "Speed is 15 mm/s or less") in words
    assert "trained on 30–300 mm/s" in words


@given(further, further, st.booleans())
def test_force(near, far, hard):
    edge, sign = (FORCES[1], 1) if hard else (FORCES[0], -1)
    falls(FIELD, near, far, lambda octaves: judge(FIELD, make_steady_action(0.1, 0.1, edge * 2.0 ** (sign * octaves))))
    confidence, words = judge(FIELD, make_steady_action(0.1, 0.1, 6.0 if hard else 0.15))
    assert confidence == pytest.approx(0.5)
    assert ("Force reaches 6 N" if hard else "Force is 0.15 N or less") in words
    assert "trained on 0.3–3 N" in words


CORNERED = trained([
    make_steady_action(0.1, v, f, angle)
    for v, f in ((0.03, 0.3), (0.3, 0.3), (0.03, 3.0)) for angle in np.arange(16) * np.pi / 8
])  # fmt: skip
"""Fast with a light hand, slow with a heavy one, never both."""


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_corner_of_speed_and_force_that_was_never_visited(first, second):
    def at(share):
        speed, force = (low * (high / low) ** (0.4 + 0.6 * share) for low, high in (SPEEDS, FORCES))
        return judge(CORNERED, make_steady_action(0.1, speed, force))

    near, far = sorted((first, second))
    assert at(far)[0] <= at(near)[0]
    confidence, words = at(1.0)
    assert confidence < at(0.5)[0] < at(0.0)[0] == 1.0
    assert "300 mm/s together with 3 N was never trained; the nearest is 94.9 mm/s with 0.949 N" in words
    assert judge(FIELD, make_steady_action(0.1, 0.3, 3.0)) == (1.0, "")


@given(speeds, forces, further, further)
def test_out_of_the_corner_and_out_of_the_box_it_goes_on_falling(speed, force, near, far):
    near, far = sorted((near, far))
    sure = [judge(CORNERED, make_steady_action(0.1, speed * 2.0**octaves, force))[0] for octaves in (near, far)]
    assert sure[1] <= sure[0] + 1e-12


SCRAPED = trained([make_steady_action(0.1, v, f) for v in SPEEDS for f in FORCES])
"""Left to right and nothing else."""


@given(st.floats(0.0, np.pi), st.floats(0.0, np.pi), st.sampled_from([-1.0, 1.0]))
def test_direction(near, far, side):
    near, far = sorted((near, far))
    first, second = (judge(SCRAPED, make_steady_action(0.1, 0.1, 1.0, side * angle)) for angle in (near, far))
    assert second[0] <= first[0]
    if near > 0.7 and far > near + 0.1:
        assert second[0] < first[0] < 1.0
    assert judge(SCRAPED, make_steady_action(0.1, 0.1, 1.0, side * near / 8.0)) == (1.0, "")
    _, words = judge(SCRAPED, make_steady_action(0.1, 0.1, 1.0, -np.pi / 2))
    assert "Direction -90° (0° is left to right) was never trained; the nearest is 0°." in words


@given(angles)
def test_directions_between_eight_trained_ones_are_inside(angle):
    field = trained([make_steady_action(0.1, v, f, k * np.pi / 4) for v in SPEEDS for f in FORCES for k in range(8)])
    assert judge(field, make_steady_action(0.1, 0.1, 1.0, angle)) == (1.0, "")


def test_a_circle_covers_every_direction():
    assert all(compute_training_ranges([make_circular_action(2.0, 0.1, 1.0, 0.02)], TOKENS, MECHANICS).sectors)


def test_untrained_directions_lower_confidence_on_grain_only():
    field = trained(directed=[False] * len(EVERYWHERE))
    assert field.ranges.sectors == ()
    isotropic, grained = TOKENS[0].copy(), TOKENS[0].copy()
    for token, value in ((isotropic, 0.0), (grained, 0.8)):
        token[[index for index, name in enumerate(TOKEN_NAMES) if name.startswith("cos2")]] = value
        token[[index for index, name in enumerate(TOKEN_NAMES) if name.startswith("sin2")]] = 0.0
    field = dataclasses.replace(field, ranges=dataclasses.replace(
        field.ranges, token_low=np.minimum(isotropic, grained), token_high=np.maximum(isotropic, grained)))  # fmt: skip
    assert judge(field, make_steady_action(0.1, 0.1, 1.0, 2.0), isotropic) == (1.0, "")
    confidence, words = judge(field, make_steady_action(0.1, 0.1, 1.0, 2.0), grained)
    assert confidence < 1.0
    assert "80% of this surface's waves run one way" in words


@given(further, further, st.sampled_from([0, 7, 42]), st.booleans())
def test_token(near, far, feature, above):
    """A band's level, below and above everything trained (what a level is relative to cannot leave its range)."""

    def at(widths):
        token, low, high = TOKENS[0].copy(), FIELD.ranges.token_low[feature], FIELD.ranges.token_high[feature]
        width = max(float(high - low), 0.5)
        token[feature] = high + widths * width if above else low - widths * width
        return judge(FIELD, make_steady_action(0.1, 0.1, 1.0), token)

    falls(FIELD, near, far, at)
    assert at(0.0) == (1.0, "")


def test_a_strange_surface_is_described_with_its_values():
    token = TOKENS[0].copy()
    token[0] = -2.0
    confidence, words = judge(FIELD, make_steady_action(0.1, 0.1, 1.0), token)
    assert confidence < 0.6
    assert "the height of its waves about 8 mm long is 10000 µm RMS, trained on" in words


@given(further, further, st.booleans(), st.sampled_from(["stiffness_n_m", "damping_ratio", "friction"]))
def test_mechanics(near, far, above, name):
    low, high = FIELD.ranges.mechanics[name].span

    def at(octaves):
        value = high * 2.0**octaves if above else low * 2.0**-octaves
        return judge(FIELD, make_steady_action(0.1, 0.1, 1.0), mechanics=dataclasses.replace(MIDDLE, **{name: value}))

    falls(FIELD, near, far, at)
    assert at(0.0) == (1.0, "")
    confidence, words = at(1.0)
    assert confidence == pytest.approx(0.5)
    assert f"trained on {low:g}–{high:g}" in words


def test_confidence_for_unknown_mechanics_follows_the_training():
    stroke, unknown = make_steady_action(0.1, 0.1, 1.0), dataclasses.replace(MIDDLE, friction=None)
    confidence, words = judge(FIELD, stroke, mechanics=unknown)
    assert (confidence, words) == (0.5, "Friction is unknown here; in training it was always given.")
    assert judge(trained(withheld=True), stroke, mechanics=unknown) == (1.0, "")
    blind = trained(mechanics=[Mechanics()])
    assert judge(blind, stroke, mechanics=Mechanics()) == (1.0, "")
    assert "Stiffness is 30000 N/m; training never gave it." in judge(blind, stroke)[1]


def test_probe():
    confidence, words = judge(FIELD, make_steady_action(0.1, 0.1, 1.0, probe="finger"))
    assert (confidence, words) == (0.5, "Touched with the finger; trained with the pen.")
    assert judge(trained(probes=["pen", "finger"]), make_steady_action(0.1, 0.1, 1.0, probe="finger")) == (1.0, "")


def test_everything_wrong_is_said_at_once():
    token = TOKENS[0].copy()
    token[0] = -1.0
    stroke = uniform_stroke(make_steady_action(0.1, 2.0, 20.0, np.pi, probe="finger"), token, Mechanics(1e7, None, 0.4))
    confidence, warnings = check_ranges(SCRAPED, stroke, stroke.action)
    assert len(warnings) == 7
    assert 0.0 < confidence < 0.01


def test_nothing_is_said_of_what_is_not_on_record():
    old = dataclasses.replace(
        FIELD, ranges=TrainingRanges(SPEEDS, FORCES, FIELD.ranges.token_low, FIELD.ranges.token_high)
    )
    action = make_steady_action(0.1, 0.1, 1.0, 2.0, probe="finger")
    assert judge(old, action, mechanics=Mechanics(1e9, 5.0, None)) == (1.0, "")
    assert judge(load_field(), make_primitive_action("left-right-hard"), mechanics=Mechanics()) == (1.0, "")


def test_no_contact_and_no_training_are_said():
    air = make_steady_action(0.1, 0.1, 0.0)
    stroke = uniform_stroke(air, TOKENS[0], MIDDLE)
    assert check_ranges(FIELD, stroke, air) == (1.0, ("The stroke never touches anything: the signal is silent.",))
    untrained = dataclasses.replace(FIELD, ranges=None)
    assert judge(untrained, make_steady_action(0.1, 0.1, 1.0)) == (0.2, "The field is not trained.")


def test_a_press_that_never_moves_is_judged_by_its_force_alone():
    assert judge(SCRAPED, make_steady_action(0.1, 0.0, 1.0, np.pi)) == (1.0, "")
    assert judge(SCRAPED, make_steady_action(0.1, 0.0, 6.0, np.pi))[0] == pytest.approx(0.5)


# -- what training leaves on record ----------------------------------------------------------------------------------


def test_rest_and_air_are_not_training():
    resting, air = make_steady_action(0.1, 0.0, 2.0), make_steady_action(0.1, 5.0, 0.0)
    ranges = compute_training_ranges([make_steady_action(0.1, 0.1, 1.0), resting, air], TOKENS, MECHANICS)
    assert ranges.speed == (0.1, 0.1)
    assert ranges.force == (1.0, 1.0)
    assert ranges.sectors.count(True) == 1
    assert ranges.mechanics["friction"] == PropertyRange((0.2, 0.8), False)
    assert ranges.probes == ("pen",)


def test_a_spike_in_a_long_recording_is_not_training():
    wandering = make_random_smooth_action(200.0, 1, speed_m_s=SPEEDS, force_n=FORCES)
    force = wandering.force.copy()
    force[20_000:20_002] = 40.0
    ranges = compute_training_ranges([dataclasses.replace(wandering, force=force)], TOKENS, MECHANICS)
    assert 2.5 < ranges.force[1] <= 3.0


@pytest.mark.parametrize("actions", [[], [make_steady_action(1 / ACTION_RATE_HZ, 0.0, 1.0)]])
def test_data_without_a_stroke_is_refused(actions):
    with pytest.raises(StrokeError, match="no recorded stroke ever moves"):
        compute_training_ranges(actions, TOKENS, MECHANICS)


def test_a_field_held_at_its_ceiling_says_so():
    parameters = {**PARAMETERS, "alpha.bias": np.full_like(PARAMETERS["alpha.bias"], 30.0)}
    stroke = uniform_stroke(make_steady_action(0.2, 0.1, 1.0), TOKENS[0], MIDDLE)
    assert synthesise(FIELD, stroke, seed=0).warnings == ()
    (warning,) = synthesise(dataclasses.replace(FIELD, parameters=parameters), stroke, seed=0).warnings
    assert "held at 403 m/s²" in warning


def test_a_field_without_a_sense_of_direction_is_judged_as_one():
    grained = TOKENS[0].copy()
    for index, name in enumerate(TOKEN_NAMES):
        if name.startswith(("cos2", "sin2")):
            grained[index] = 0.6
    deaf = dataclasses.replace(trained(tokens=grained[None]), config=dataclasses.replace(CONFIG, directed=False))
    assert "of this surface's waves run one way" in judge(deaf, make_steady_action(0.1, 0.1, 1.0), grained)[1]
    assert judge(trained(tokens=grained[None]), make_steady_action(0.1, 0.1, 1.0), grained) == (1.0, "")
