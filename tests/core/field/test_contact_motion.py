"""The probe over a measured relief: as the simulator, in phase with the surface, and the same without the kernel."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import Action
from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.field.contact.contact_motion import (
    fuse_axes,
    integrate_numpy,
    make_moving_contact,
    render_motion,
    render_motion_axes,
)
from hnf_core.field.stroke import HeightProfile, StrokeInput, resample_action
from hnf_core.field.synthesis import render_incremental, synthesise, synthesise_axes
from hnf_core.field.weights import load_field
from hnf_core.kernel.compiled_carriers import integrate_motion
from hnf_core.kernel.loader import load_kernel, without_kernel
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import get_material
from hnf_core.material.probe import get_probe
from hnf_core.signal import dft321
from hnf_core.simulation.simulate import FULL_PHYSICS, simulate_batch, straight_stroke
from hnf_lab.shared_field.simulated_strokes import Surface, make_surface

FIELD = load_field()
PLASTIC = get_material("smooth-plastic").mechanics
QUIET = dataclasses.replace(PLASTIC, friction_noise_n=0.0)


def rms(samples: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(samples))))


def grating(pitch_m: float, amplitude_m: float) -> Surface:
    """A grating across x on the simulator's map of 20 mm, which holds a whole number of its waves."""
    wave = amplitude_m * np.sin(2.0 * np.pi * np.arange(512) * (20e-3 / 512) / pitch_m)
    return make_surface("grating", np.broadcast_to(wave, (512, 512)).astype(np.float32).copy())


def profile_of(pitch_m: float, amplitude_m: float, length_m: float = 0.8) -> HeightProfile:
    step = min(pitch_m / 16.0, 1e-4)
    place = np.arange(round(length_m / step)) * step - 0.1
    return HeightProfile(step, -0.1, amplitude_m * np.sin(2.0 * np.pi * place / pitch_m), 2.0 * step)


def stroke_on(
    surface: Surface, profile: HeightProfile | None, speed: float, force: float, probe: str = "pen",
    mechanics: Mechanics = QUIET, seconds: float = 2.0,
) -> StrokeInput:  # fmt: skip
    action = make_steady_action(seconds, speed, force, 0.0, probe)
    index = np.zeros(len(action.speed), np.int32)
    return StrokeInput(action, surface.token[None].astype(np.float32), (mechanics,), index, profile)


def simulated(
    surfaces: list[Surface], hands: list[tuple[float, float]], probe: str = "pen", seconds: float = 2.0
) -> list[np.ndarray]:
    """What the simulator feels on each surface at a (speed, force), all in one batch, which costs as much as one."""
    strokes = [straight_stroke(speed, force, seconds, start_m=(1e-3, 1e-3)) for speed, force in hands]
    maps, mechanics = [surface.maps for surface in surfaces], [QUIET] * len(strokes)
    found = simulate_batch(maps, strokes, mechanics, get_probe(probe), physics=FULL_PHYSICS)
    return [dft321(each - each.mean(axis=0))[3000:-1000] for each in found]


def motion_of(stroke: StrokeInput) -> np.ndarray:
    action, index = resample_action(stroke)
    return render_motion(stroke, action, index, FIELD.config.carriers)


PITCHES_MM, HANDS = (0.5, 1.0, 2.0, 4.0), ((0.1, 1.0), (0.2, 1.0), (0.05, 2.0))


@cache
def gratings() -> dict[float, Surface]:
    return {pitch: grating(1e-3 * pitch, 1.2e-2 * 1e-3 * pitch) for pitch in PITCHES_MM}


@cache
def simulated_gratings() -> dict[tuple[float, tuple[float, float]], np.ndarray]:
    cases = [(pitch, hand) for pitch in PITCHES_MM for hand in HANDS]
    felt = simulated([gratings()[pitch] for pitch, _ in cases], [hand for _, hand in cases])
    return dict(zip(cases, felt, strict=True))


@pytest.mark.parametrize("pitch_mm", PITCHES_MM)
@pytest.mark.parametrize("hand", HANDS)
def test_a_grating_is_as_strong_as_the_simulator_s(pitch_mm, hand):
    profile = profile_of(1e-3 * pitch_mm, 1.2e-2 * 1e-3 * pitch_mm)
    found = motion_of(stroke_on(gratings()[pitch_mm], profile, *hand))[3000:-1000]
    assert 20.0 * abs(np.log10(rms(found) / rms(simulated_gratings()[pitch_mm, hand]))) < 0.5


@pytest.mark.parametrize("probe", ["finger", "rigid-tip"])
def test_so_it_is_under_other_probes(probe):
    surface = grating(4e-3, 50e-6)
    stroke = stroke_on(surface, profile_of(4e-3, 50e-6), 0.1, 1.0, probe, seconds=1.2)
    found = motion_of(stroke)[3000:-1000]
    (wanted,) = simulated([surface], [(0.1, 1.0)], probe, seconds=1.2)  # the 0.8 s that count are 20 whole waves
    assert 20.0 * abs(np.log10(rms(found) / rms(wanted))) < 0.5


@pytest.mark.parametrize("pitch_mm", [0.5, 1.0, 2.0, 4.0])
def test_level_and_tone_do_not_depend_on_the_seed(pitch_mm):
    pitch, amplitude, speed = 1e-3 * pitch_mm, 1.2e-2 * 1e-3 * pitch_mm, 0.1
    stroke = stroke_on(grating(pitch, amplitude), profile_of(pitch, amplitude), speed, 1.0, mechanics=PLASTIC)
    levels = []
    for seed in range(16):
        samples = synthesise(FIELD, stroke, seed=seed).signal.samples[1000:-1000]
        levels.append(20.0 * np.log10(rms(samples)))
        power = np.square(np.abs(np.fft.rfft(samples * np.hanning(len(samples)))))
        tone = np.fft.rfftfreq(len(samples), 1e-4)[power.argmax()]
        assert tone == pytest.approx(speed / pitch, rel=0.01)
    assert np.ptp(levels) < 1.5


def test_a_tone_follows_the_hand_s_speed():
    """A sweep from 50 to 250 mm/s: the analytic signal turns once for every ridge that passes."""
    pitch, count = 1e-3, 601
    speed = np.linspace(0.05, 0.25, count)
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 200.0)])
    action = Action(200.0, np.tile([1.0, 0.0], (count, 1)), speed, np.ones(count), position, np.ones(count, bool))
    stroke = StrokeInput(
        action, grating(pitch, 8e-6).token[None], (QUIET,), np.zeros(count, np.int32), profile_of(pitch, 8e-6)
    )
    samples = synthesise(FIELD, stroke, seed=0).signal.samples.astype(np.float64)
    spectrum = np.fft.fft(samples)
    spectrum[len(samples) // 2 :] = 0.0
    spectrum[: round(30 * len(samples) / 1e4)] = 0.0
    phase = np.unwrap(np.angle(np.fft.ifft(spectrum)))
    for first in range(4000, 24000, 4000):
        turned = (phase[first + 4000] - phase[first]) / (2.0 * np.pi)
        way = np.interp(np.array([first, first + 4000]) / 50.0, np.arange(count), position)
        assert turned == pytest.approx((way[1] - way[0]) / pitch, rel=0.01)


def test_at_rest_the_height_gives_nothing():
    count = 201
    action = Action(
        200.0, np.tile([1.0, 0.0], (count, 1)), np.zeros(count), np.ones(count), np.full(count, 2e-3),
        np.ones(count, bool),
    )  # fmt: skip
    profile = profile_of(1e-3, 50e-6)
    stroke = StrokeInput(action, grating(1e-3, 5e-6).token[None], (QUIET,), np.zeros(count, np.int32), profile)
    assert np.abs(motion_of(stroke)).max() < 1e-3


def test_axes_add_up_in_power():
    stroke = stroke_on(grating(2e-3, 25e-6), profile_of(2e-3, 25e-6), 0.1, 1.0)
    action, index = resample_action(stroke)
    axes = render_motion_axes(stroke, action, index, FIELD.config.carriers)
    assert np.square(fuse_axes(axes)).sum() == pytest.approx(np.square(axes).sum(), rel=0.02)
    along, across, normal = (each.signal.samples for each in synthesise_axes(FIELD, stroke, seed=0))
    whole = synthesise(FIELD, stroke, seed=0).signal
    assert np.sqrt(rms(along) ** 2 + rms(across) ** 2 + rms(normal) ** 2) == pytest.approx(whole.rms, rel=0.1)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_one_axis_alone_is_returned_as_it_is(seed):
    axis = np.random.default_rng(seed).standard_normal(3000)
    np.testing.assert_allclose(fuse_axes(np.stack([axis, np.zeros(3000)])), axis, atol=1e-6)


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 2**31), st.floats(1e3, 1e7), st.floats(0.01, 1.5), st.floats(0.0, 2.0),
    st.sampled_from(["pen", "finger", "rigid-tip"]),
)  # fmt: skip
def test_the_kernel_integrates_as_python_does(seed, stiffness, damping, friction, probe):
    kernel = load_kernel()
    if kernel is None:
        pytest.skip("no compiled kernel here")
    rng, steps = np.random.default_rng(seed), 400
    contact = make_moving_contact(Mechanics(stiffness, damping, friction), get_probe(probe), 4)
    smooth = np.cumsum(rng.standard_normal((5, steps + 2)), axis=1)
    drives = np.stack(
        [2e-7 * smooth[0], 2e-2 * smooth[1], 5e-3 * smooth[2], np.abs(0.2 * smooth[3]), np.abs(0.1 * smooth[4])]
    )
    states = [np.array([-1e-5, 0.0, 0.0, 0.0, 0.1]) for _ in range(2)]
    for found, wanted in zip(
        integrate_motion(kernel, contact.columns, drives, states[0]), integrate_numpy(contact, drives, states[1]),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6 * max(np.abs(wanted).max(), 1.0))
    np.testing.assert_allclose(states[0], states[1], rtol=1e-5, atol=1e-9)


def test_without_the_kernel_it_sounds_the_same():
    stroke = stroke_on(grating(1e-3, 8e-6), profile_of(1e-3, 8e-6, 0.2), 0.1, 1.0, seconds=0.3)
    found = motion_of(stroke)
    with without_kernel():
        np.testing.assert_allclose(motion_of(stroke), found, atol=1e-5 * np.abs(found).max())


def test_another_force_late_in_a_stroke_leaves_its_start_alone():
    stroke = stroke_on(grating(1e-3, 8e-6), profile_of(1e-3, 8e-6), 0.1, 1.0, seconds=3.0)
    earlier = render_incremental(FIELD, stroke, seed=3)
    force = stroke.action.force.copy()
    force[500:] *= 1.3
    changed = dataclasses.replace(stroke, action=dataclasses.replace(stroke.action, force=force))
    again = render_incremental(FIELD, changed, seed=3, earlier=earlier)
    assert again.samples.tobytes() == render_incremental(FIELD, changed, seed=3).samples.tobytes()
    assert again.rendered_count < len(again.samples) / 2


def test_materials_join_without_a_blow():
    """The same surface called by two names of equal mechanics, and of unequal ones: no step in between."""
    stroke = stroke_on(grating(2e-3, 1e-7), profile_of(2e-3, 1e-7), 0.1, 1.0)
    soft = dataclasses.replace(QUIET, stiffness_n_m=2e4)
    index = (np.arange(len(stroke.action.speed)) > 200).astype(np.int32)
    joined = dataclasses.replace(
        stroke, tokens=np.repeat(stroke.tokens, 2, axis=0), mechanics=(QUIET, soft), token_index=index
    )
    assert np.abs(motion_of(joined)[9000:11000]).max() < 0.5


@pytest.mark.parametrize("hand", [0.0, 200.0])
@pytest.mark.parametrize("stiffness", [4e5, 1e9])
def test_any_probe_is_stable_and_a_softened_one_is_said(tmp_path, stiffness, hand):
    file = tmp_path / "probe.toml"
    file.write_text(
        f'name = "needle"\nmass_kg = 1e-3\ntip_radius_m = 0.5e-3\nstiffness_n_m = {stiffness}\n'
        f"[hand]\nstiffness_n_m = {hand}\ndamping_ratio = 1.0\n",
        encoding="utf-8",
    )
    stroke = stroke_on(grating(1e-3, 8e-6), profile_of(1e-3, 8e-6), 0.1, 1.0, str(file), seconds=0.5)
    result = synthesise(FIELD, stroke, seed=0)
    assert np.isfinite(result.signal.samples).all()
    assert rms(result.signal.samples) < 1e3
    assert any("softer" in text for text in result.warnings) == (stiffness > 1e8)
