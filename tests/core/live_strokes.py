"""Hands for the tests of what is felt live."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.field import carrier_rendering
from hnf_core.field.carrier_rendering import Knots, render_carriers_full_rate, sum_time_carriers
from hnf_core.field.live.hand_tracker import LiveState
from hnf_core.field.live.synthesis import LiveSynthesis
from hnf_core.field.prepare import PreparedStroke
from hnf_core.field.render import render_contact
from hnf_core.field.stroke import StrokeInput, interpolate_position, uniform_stroke
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import without_kernel
from hnf_core.material.library import get_material
from reference.every_state import prepare_every_state

BLOCK = 50
SEED = 3


def hand(speed, force, *, angle=0.3, contact=None, seconds: float = 3.0) -> Action:
    """speed: m/s, signed: the place on the path runs backward with it. All may be functions of time or constants."""
    time = np.arange(round(seconds * ACTION_RATE_HZ) + 1) / ACTION_RATE_HZ
    speed, force, angle = (
        np.broadcast_to(given(time) if callable(given) else float(given), time.shape).astype(float)
        for given in (speed, force, angle)
    )
    position = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / ACTION_RATE_HZ)])
    turned = angle + np.where(speed < 0.0, np.pi, 0.0)
    direction = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    contact = force > 0.0 if contact is None else contact(time)
    return Action(ACTION_RATE_HZ, direction, np.abs(speed), force, position, contact)


def on(action: Action, material: str) -> StrokeInput:
    known = get_material(material)
    return uniform_stroke(action, known.token, known.mechanics)


def offline(stroke: StrokeInput) -> np.ndarray:
    """The whole stroke at the model's rate: carriers in time in float64, those in arc length as they are kept for any
    render (field/noise_cache.py), read by numpy."""
    prepared = prepare_every_state(load_field(), stroke, seed=SEED)
    carriers, count, amplitude = prepared.carriers, prepared.count, prepared.amplitude[:, 0]
    out = sum_time_carriers(amplitude[:, carriers.time_slice], carriers, SEED, 0, count)
    near = Knots(BLOCK * np.arange(len(amplitude)), amplitude).select_range(0, count)
    when = carrier_rendering._Interpolation(0, *near.locate(np.arange(count)))
    with without_kernel():
        place, octaves = interpolate_position(prepared.action, 0, count), list(range(carriers.arc_octaves))
        out += carrier_rendering._sum_arc_bands(near, carriers, SEED, octaves, place, when)
    return prepared.audible * (out + tones_of(prepared) + render_contact(prepared, 0, count))


def tones_of(prepared: PreparedStroke) -> np.ndarray | float:
    """What a regular surface sounds at, at every sample."""
    if prepared.course.lines is None or prepared.tone_amplitude is None:
        return 0.0
    position = interpolate_position(prepared.action, 0, prepared.count)
    return prepared.course.lines.render(prepared.action, prepared.knots, prepared.tone_amplitude, 0, position)


def as_the_model_says(stroke: StrokeInput) -> np.ndarray:
    """The same, every carrier plainly in float64."""
    prepared = prepare_every_state(load_field(), stroke, seed=SEED)
    out = render_carriers_full_rate(prepared.amplitude, prepared.carriers, SEED, prepared.action, 0, prepared.count)
    return prepared.audible * (out + tones_of(prepared) + render_contact(prepared, 0, prepared.count))


def states(stroke: StrokeInput) -> list[LiveState]:
    action = stroke.action
    return [
        LiveState((float(d[0]), float(d[1])), float(v), float(s), float(f), bool(c), int(material))
        for d, v, s, f, c, material in zip(
            action.direction, action.speed, action.position, action.force, action.contact, stroke.token_index,
            strict=True,
        )
    ]  # fmt: skip


def live_of(stroke: StrokeInput, **changed) -> LiveSynthesis:
    given = {"seed": SEED, "probe": stroke.action.probe} | changed
    return LiveSynthesis(load_field(), stroke.tokens, stroke.mechanics, **given)


def live(stroke: StrokeInput) -> np.ndarray:
    """The whole stroke, sample by sample with offline(): what its first state gave is cut off."""
    synthesis = live_of(stroke)
    return np.concatenate([synthesis.step(state) for state in states(stroke)])[BLOCK:]


def error(found: np.ndarray, wanted: np.ndarray) -> float:
    """RMS of the difference over RMS of what is wanted."""
    return float(np.sqrt(np.mean(np.square(found - wanted)) / np.mean(np.square(wanted))))


def third_octaves_db(found: np.ndarray, wanted: np.ndarray, loud_db: float = -50.0) -> np.ndarray:
    """Level of found over wanted in the third octaves from 20 Hz to 4 kHz that hold more than loud_db of the power."""
    frequency = np.fft.rfftfreq(len(wanted), 1e-4)
    power = [np.square(np.abs(np.fft.rfft(signal))) for signal in (found, wanted)]
    edges = 20.0 * 2.0 ** (np.arange(24) / 3.0)
    inside = [(frequency >= low) & (frequency < high) for low, high in pairwise(edges)]
    bands = np.array([[each[band].sum() for each in power] for band in inside])
    loud = bands[:, 1] > power[1].sum() * 10.0 ** (loud_db / 10.0)
    return 10.0 * np.log10(bands[loud, 0] / bands[loud, 1])
