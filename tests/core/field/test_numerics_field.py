"""Finite inputs of the field path never give NaN, infinity or an input too large to compute."""

import dataclasses

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.errors import StrokeError
from hnf_core.field.carriers import Carriers
from hnf_core.field.field import Field, FieldConfig, accumulate, evaluate, initial_parameters
from hnf_core.field.height_profile import compute_profile_power
from hnf_core.field.prepare import count_memory_states, prepare_stroke
from hnf_core.field.render import render_contact
from hnf_core.field.stroke import (
    LIMITS,
    HeightProfile,
    StrokeInput,
    build_condition,
    resample_action,
    uniform_stroke,
)
from hnf_core.field.synthesis import synthesise
from hnf_core.material.contact_model import MECHANICS_LIMITS, MECHANICS_NAMES, Mechanics
from hnf_core.material.token import TOKEN_DIM
from reference.every_state import prepare_every_state

WOOD = Mechanics(8e4, 0.15, 0.3)
SMALL = FieldConfig(hidden=8, layers=2)


def random_field(config: FieldConfig) -> Field:
    rng = np.random.default_rng(1)
    start = initial_parameters(config, 0)
    return Field(config, {k: (v + 0.3 * rng.standard_normal(v.shape)).astype(np.float32) for k, v in start.items()})


FIELDS = {
    "linear contact": Field(SMALL, initial_parameters(SMALL, 0)),
    "random": random_field(SMALL),
    "published": random_field(FieldConfig.published(hidden=8, layers=2)),
    "no arcs": random_field(FieldConfig(hidden=8, layers=2, carriers=Carriers(arc_octaves=0))),
}


def rough_token() -> np.ndarray:
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    token[0:49:7] = -5.3 - 0.25 * np.arange(7)
    return token


def make_action(speed, force, *, sign=1.0, probe="pen") -> Action:
    speed, force, sign = np.broadcast_arrays(*(np.asarray(each, dtype=float) for each in (speed, force, sign)))
    velocity = speed * sign
    position = np.concatenate([[0.0], np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) / ACTION_RATE_HZ)])
    direction = np.stack([sign, np.zeros(len(sign))], axis=1)
    return Action(ACTION_RATE_HZ, direction, speed.copy(), force.copy(), position, force > 0.0, probe)


def within(name: str, low: float, high: float) -> st.SearchStrategy[float]:
    """Anywhere in LIMITS, and as often where touch is."""
    return st.floats(*LIMITS[name]) | st.floats(low, high)


@st.composite
def strokes(draw):
    states = draw(st.integers(2, 6))

    def column(values):
        return np.array(draw(st.lists(values, min_size=states, max_size=states)))

    angle = column(st.floats(-4.0, 4.0))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1) * draw(st.sampled_from([1.0, 1.0, 0.0]))
    action = Action(
        draw(st.sampled_from([200.0, 100.0, 1000.0])),
        direction,
        column(within("speed [m/s]", 0.0, 1.0)),
        column(within("force [N]", 0.0, 3.0)),
        column(within("position [m]", 0.0, 0.1)),
        column(st.booleans()),
        draw(st.sampled_from(["pen", "finger"])),
    )
    token = draw(st.lists(within("token", -9.0, 1.0), min_size=TOKEN_DIM, max_size=TOKEN_DIM))
    mechanics = Mechanics(
        draw(st.none() | within("stiffness [N/m]", 1e2, 1e6)),
        draw(st.none() | within("damping ratio", 0.0, 1.0)),
        draw(st.none() | within("friction", 0.0, 1.0)),
    )
    profile = None
    if draw(st.booleans()):
        shape = np.random.default_rng(draw(st.integers(0, 9))).uniform(-1.0, 1.0, draw(st.integers(0, 64)))
        profile = HeightProfile(
            draw(within("profile step [m]", 1e-6, 1e-2)),
            draw(within("profile origin [m]", -0.01, 0.01)),
            shape * draw(within("profile height [m]", 0.0, 1e-4)),
            draw(within("resolved wavelength [m]", 0.0, 0.01)),
        )
    index = np.zeros(states, dtype=np.int32)
    return StrokeInput(action, np.array([token], dtype=np.float32), (mechanics,), index, profile)


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
@given(strokes(), st.sampled_from(sorted(FIELDS)))
def test_every_input_within_the_limits_gives_a_finite_signal(stroke, name):
    try:
        action, token_index = resample_action(stroke)
    except StrokeError:
        return  # shorter than 5 ms, said in words
    field = FIELDS[name]
    emission = evaluate(field, build_condition(stroke, action, token_index))
    assert np.isfinite(emission.alpha).all()
    assert np.isfinite(emission.sigma_dt).all()
    assert (emission.sigma_dt >= 0.0).all()
    assert np.isfinite(accumulate(field.config, emission)).all()
    result = synthesise(field, stroke, seed=3)
    assert np.isfinite(result.signal.samples).all()
    assert 0.0 <= result.confidence <= 1.0


N = 41
STATE = np.arange(N)
EXTREMES = {
    **{
        f"{speed:g} m/s, {force:g} N": make_action(np.full(N, speed), force)
        for speed in (0.0, 1e-12, 0.1, 1e3)
        for force in (0.0, 1e-9, 1.0, 1e6)
    },
    "one sample of contact": make_action(np.full(N, 0.1), np.where(STATE == 20, 1.0, 0.0)),
    "contact every other sample": make_action(np.full(N, 0.1), np.where(STATE % 2, 1.0, 0.0)),
    "blows": make_action(np.full(N, 0.1), np.where(STATE % 2, 1e6, 1e-9)),
    "reversal each sample": make_action(np.full(N, 0.1), 1.0, sign=np.where(STATE % 2, 1.0, -1.0)),
    "reversal each sample at 1000 m/s": make_action(np.full(N, 1e3), 1.0, sign=np.where(STATE % 2, 1.0, -1.0)),
    "from 0.1 to 1000 m/s at once": make_action(np.where(STATE > 20, 1e3, 0.1), 1.0),
}
ROUGH = HeightProfile(25e-6, -2e-3, 1e-5 * np.random.default_rng(1).standard_normal(4000), 1e-4)


@pytest.mark.parametrize("profile", [None, ROUGH], ids=["texture", "profile"])
@pytest.mark.parametrize("case", EXTREMES)
def test_extreme_strokes_give_a_finite_signal(case, profile):
    probe = "finger" if len(case) % 2 else "pen"
    stroke = uniform_stroke(dataclasses.replace(EXTREMES[case], probe=probe), rough_token(), WOOD)
    result = synthesise(FIELDS["random"], dataclasses.replace(stroke, profile=profile), seed=1)
    assert np.isfinite(result.signal.samples).all()
    if not (EXTREMES[case].force > 0.0).any():
        assert not result.signal.samples.any()


@pytest.mark.parametrize("name", LIMITS)
@pytest.mark.parametrize("side", [0, 1])
def test_beyond_the_limits_is_refused_by_name(name, side):
    limit = LIMITS[name][side]
    value = limit * (1.5 if limit * (side - 0.5) > 0.0 else 0.5) - (limit == 0.0) * 1e-3
    action, token, profile = make_action(np.full(5, 0.1), 1.0), rough_token(), ROUGH
    mechanics = dict(zip(MECHANICS_LIMITS, MECHANICS_NAMES, strict=True))
    columns = {"speed [m/s]": "speed", "force [N]": "force", "position [m]": "position", "direction": "direction"}
    profiles = {
        "profile step [m]": "step_m",
        "profile origin [m]": "origin_m",
        "resolved wavelength [m]": "resolved_wavelength_m",
    }
    for wrong in (value, float("nan")):
        parts = {"action": action, "tokens": token[None], "mechanics": (WOOD,), "profile": profile}
        if name in columns:
            column = getattr(action, columns[name]).copy()
            column[2] = wrong
            parts["action"] = dataclasses.replace(action, **{columns[name]: column})
        elif name == "action rate [Hz]":
            parts["action"] = dataclasses.replace(action, rate=wrong)
        elif name == "token":
            parts["tokens"] = np.where(np.arange(TOKEN_DIM) == 3, np.float32(wrong), token)[None]
        elif name in mechanics:
            parts["mechanics"] = (dataclasses.replace(WOOD, **{mechanics[name]: wrong}),)
        elif name in ("profile height [m]", "profile seam [m]"):
            part = "height" if name == "profile height [m]" else "seam"
            parts["profile"] = dataclasses.replace(profile, **{part: np.array([0.0, wrong, 0.0, 0.0])})
        else:
            parts["profile"] = dataclasses.replace(profile, **{profiles[name]: wrong})
        words = (
            "must not be negative" if wrong < 0.0 and name in ("speed [m/s]", "force [N]") else name.partition(" [")[0]
        )
        with pytest.raises(StrokeError, match=words):
            StrokeInput(token_index=np.zeros(5, dtype=np.int32), **parts)


def test_states_in_portions_are_the_states_at_once():
    speed = 0.1 + 0.05 * np.sin(np.arange(61))
    stroke = uniform_stroke(make_action(speed, 1.0), rough_token(), WOOD)
    action, token_index = resample_action(stroke)
    condition = build_condition(stroke, action, token_index)
    field = FIELDS["random"]
    whole = accumulate(field.config, evaluate(field, condition))
    for portion in (7, 40):
        parts = []
        for start in range(0, 61, portion):
            first, stop = max(start - count_memory_states(field), 0), min(start + portion, 61)
            given = evaluate(field, condition.rows(slice(first, stop)))
            parts.append(accumulate(field.config, given)[start - first :])
        # Without the kernel float32 products round differently with the number of rows.
        np.testing.assert_allclose(np.concatenate(parts), whole, rtol=1e-4)


def test_relief_above_the_nyquist_rate_does_not_alias():
    """9000 waves a metre at 1 m/s are 9 kHz: read at 10 kHz they would sound at 1 kHz."""
    place = np.arange(0.0, 0.3, 1e-5)
    ripple = HeightProfile(1e-5, 0.0, 1e-6 * np.cos(2.0 * np.pi * 9000.0 * place), 5e-5)

    def heard(speed):
        stroke = uniform_stroke(make_action(np.full(51, speed), 1.0), rough_token(), WOOD)
        prepared = prepare_stroke(FIELDS["linear contact"], dataclasses.replace(stroke, profile=ripple), seed=0)
        return float(np.std(render_contact(prepared, 1000, 1000)))

    # What is left of 1 is the end of the ripple, a step in other bands; unfaded it was 2.8.
    assert heard(1.0) < 0.05 * heard(0.2)


def test_what_is_read_is_never_above_the_model_rates_band():
    """Not even what a slow state left in the memory of a fast one."""
    action = make_action(np.where(STATE > 20, 2.0, 0.2), 1.0)
    prepared = prepare_every_state(FIELDS["random"], uniform_stroke(action, rough_token(), WOOD), seed=0)
    arcs = FIELDS["random"].config.carriers
    loud = prepared.amplitude[:, 0, arcs.arc_slice] != 0.0
    read = np.abs(np.diff(action.position))[:, None] * ACTION_RATE_HZ * arcs.arc_centres()
    assert not (loud[1:] | loud[:-1])[read > 4800.0].any()
    assert loud[5:19, -24:].any()
    assert loud[25:, :24].all()


def test_a_profile_shorter_than_any_carrier_s_wave_gives_nothing() -> None:
    tiny = HeightProfile(step_m=1e-9, origin_m=1e-9, height=np.array([0.0, 1e-9, 0.0, 1e-9]), resolved_wavelength_m=0.0)
    assert not compute_profile_power(tiny, Carriers()).any()
