"""Stress: an hour, 10 km of path, rates from 1 Hz to 10 MHz, and what is written of them."""

from __future__ import annotations

import dataclasses
import itertools
import json
import tracemalloc

import numpy as np
import pytest

from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.actuators.limiter import Limiter
from hnf_core.actuators.limits import Limits
from hnf_core.cli.synth import write_in_chunks
from hnf_core.errors import FileError, StrokeError, UsageError
from hnf_core.export.convert import export_signal
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.export.wav import read_wav, write_wav, write_wav_stream
from hnf_core.field.carriers import MODEL_RATE_HZ, Carriers
from hnf_core.field.field import Field, FieldConfig, initial_parameters
from hnf_core.field.prepare import prepare_stroke, split_blocks
from hnf_core.field.render import CHUNK_STEP, render_block, render_chunks
from hnf_core.field.resampling import count_outputs, resample, resample_stream
from hnf_core.field.stroke import HeightProfile, StrokeInput, uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.token import TOKEN_DIM
from hnf_core.signal import Signal

CONFIG = FieldConfig(hidden=8, layers=2, carriers=Carriers(time_edges_hz=(50.0, 100.0, 200.0, 400.0), arc_octaves=2))
FIELD = Field(CONFIG, initial_parameters(CONFIG, 0))
WOOD, FELT = Mechanics(8e4, 0.15, 0.3), Mechanics(2e3, 0.4, 0.5)
STEP_S = CHUNK_STEP / MODEL_RATE_HZ
HOUR_S = 3600.0


def rough_token(level=-5.3):
    token = np.zeros(TOKEN_DIM, dtype=np.float32)
    token[0:49:7] = level - 0.25 * np.arange(7)
    return token


def wandering(seconds) -> StrokeInput:
    """Over two materials, with two lifts, one of them across the border between portions."""
    action = make_random_smooth_action(seconds, 3, speed_m_s=(0.03, 0.3), force_n=(0.3, 2.0))
    states = np.arange(len(action.speed))
    lifted = (np.abs(states / 200.0 - STEP_S) < 0.03) | (np.abs(states / 200.0 - 0.3 * STEP_S) < 0.2)
    action = dataclasses.replace(action, force=np.where(lifted, 0.0, action.force), contact=action.contact & ~lifted)
    index = (states // 700 % 2).astype(np.int32)
    return StrokeInput(action, np.stack([rough_token(), rough_token(-4.8)]), (WOOD, FELT), index)


def steady(seconds, **changes) -> StrokeInput:
    stroke = uniform_stroke(make_steady_action(seconds, 0.1, 1.0), rough_token(), WOOD)
    return dataclasses.replace(stroke, action=dataclasses.replace(stroke.action, **changes))


def rms(samples) -> float:
    return float(np.sqrt(np.mean(np.square(samples, dtype=np.float64))))


def whole_of(field, stroke, seed=5):
    prepared = prepare_stroke(field, stroke, seed=seed)
    return np.concatenate([render_block(prepared, *block) for block in split_blocks(prepared.count)])


@pytest.mark.parametrize("config", [CONFIG, FieldConfig(hidden=8, layers=2), FieldConfig.published(hidden=8, layers=2)])
def test_portions_are_the_whole(config):
    """A stroke cut into portions → the whole one within 1e-6 of its RMS, over lifts, materials and memory"""
    field = Field(config, initial_parameters(config, 0))
    stroke = wandering((2.2 if config is CONFIG else 1.1) * STEP_S)
    pieces = list(render_chunks(field, stroke, seed=5, length=CHUNK_STEP))
    assert [len(piece.samples) for piece in pieces[:-1]] == [CHUNK_STEP] * (len(pieces) - 1)
    found, whole = np.concatenate([piece.samples for piece in pieces]), whole_of(field, stroke)
    assert len(found) == len(whole)
    assert np.abs(found - whole).max() < 1e-6 * rms(whole)
    assert max(piece.loudest for piece in pieces) == prepare_stroke(field, stroke, seed=5).loudest


def test_what_cannot_be_cut():
    """A portion of another length, or a stroke with a height profile → UsageError; nothing is left out in silence"""
    with pytest.raises(UsageError, match="whole number"):
        next(render_chunks(FIELD, steady(1.0), seed=0, length=CHUNK_STEP + 1))
    profile = HeightProfile(25e-6, 0.0, np.zeros(100), 1e-4)
    with pytest.raises(UsageError, match="height profile"):
        next(render_chunks(FIELD, dataclasses.replace(steady(1.0), profile=profile), seed=0))


def test_an_hour_in():
    """The last seconds of an hour, computed alone → as loud as the first to chance, and another draw"""
    stroke, last = steady(HOUR_S), int(HOUR_S * MODEL_RATE_HZ) // CHUNK_STEP * CHUNK_STEP - CHUNK_STEP
    heard = [
        next(render_chunks(FIELD, stroke, seed=3, length=CHUNK_STEP, begin=begin)).samples
        for begin in (CHUNK_STEP, last)
    ]
    levels = [np.mean(np.square(samples[: CHUNK_STEP // 1000 * 1000].reshape(-1, 1000)), axis=1) for samples in heard]
    chance = np.sqrt(sum(level.var(ddof=1) / len(level) for level in levels))
    assert abs(levels[0].mean() - levels[1].mean()) < 4.0 * chance
    assert abs(np.corrcoef(*heard)[0, 1]) < 0.1


@pytest.mark.parametrize("kilometres", [10.0, 1000.0])
def test_far_along_the_path(kilometres):
    """A path that begins at 10 km, 1000 km → as loud as from 0; s is exact to 1e-4 of a carrier's sample"""
    near, far = steady(2.0), steady(2.0)
    position = far.action.position + 1e3 * kilometres
    far = dataclasses.replace(far, action=dataclasses.replace(far.action, position=position))
    step = CONFIG.carriers.arc_step_m(CONFIG.carriers.arc_octaves - 1)
    assert np.spacing(position[-1]) < 1e-4 * step
    levels = [whole_of(FIELD, stroke)[2000:-2000].reshape(-1, 1000) for stroke in (near, far)]
    power = [np.mean(np.square(level), axis=1) for level in levels]
    chance = np.sqrt(sum(each.var(ddof=1) / len(each) for each in power))
    assert abs(power[0].mean() - power[1].mean()) < 4.0 * chance


def peak_of(seconds, path, rate=MODEL_RATE_HZ) -> float:
    stroke, config = steady(seconds), FieldConfig.published(hidden=8, layers=2)  # whose carriers are kept nowhere
    field = Field(config, initial_parameters(config, 0))
    tracemalloc.start()
    try:
        write_in_chunks(path, field, stroke, seed=1, rate=rate, facts={}, chunk_samples=CHUNK_STEP)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_of_a_long_stroke(tmp_path):
    """A longer stroke → no more memory than its table of states; an hour and ten minutes: above"""
    long, short = peak_of(8.0 * STEP_S, tmp_path / "a.wav"), peak_of(2.0 * STEP_S, tmp_path / "b.wav")
    states = 6.0 * STEP_S * 200.0
    assert abs(long - short) < 100.0 * states  # the samples alone would take 400 a state


@pytest.mark.parametrize("rate", [100.0, 48_000.0])
def test_a_long_stroke_is_written_as_a_short_one(tmp_path, rate):
    """A stroke written in portions, at any rate → the samples of the whole within 1e-6 of its peak, equally told"""
    stroke = wandering(1.1 * STEP_S)
    told = write_in_chunks(
        tmp_path / "x.wav", FIELD, stroke, seed=5, rate=rate, facts={"stroke": "s"}, chunk_samples=CHUNK_STEP
    )
    result = synthesise(FIELD, stroke, seed=5, sample_rate=rate)
    found = read_wav(tmp_path / "x.wav")
    assert len(found.samples) == len(result.signal.samples)
    peak = np.abs(result.signal.samples).max()
    assert np.abs(found.samples - result.signal.samples).max() < 1e-6 * peak
    assert (told.sample_rate, told.duration_s) == (found.sample_rate, found.duration_s)
    assert told.rms == pytest.approx(found.rms, rel=1e-9)
    assert told.peak == pytest.approx(peak, rel=1e-6)
    assert (told.confidence, told.warnings) == (result.confidence, result.warnings)
    assert found.provenance == {**result.signal.provenance, "stroke": "s"}
    assert found.seed == 5


RATES = (1.0, 100.0, 999.0, 2205.0, 44_100.0, 192_000.0, 1e6)


@pytest.mark.parametrize("rate", RATES)
def test_rates(rate):
    """Synthesis at 1 Hz to 1 MHz → finite, of the right length; what the rate cannot hold is told"""
    result = synthesise(FIELD, steady(0.6), seed=1, sample_rate=rate)
    assert len(result.signal.samples) == round(0.6 * rate)
    assert np.isfinite(result.signal.samples).all()
    assert any("cannot hold" in warning for warning in result.warnings) == (rate < 2200.0)


@pytest.mark.parametrize("rate", [0.0, -1.0, 0.5, 1e8, 1e300, 5e-324, float("nan"), float("inf")])
def test_no_rates(rate):
    """Rates of 0, under 1 Hz, over 10 MHz, NaN or ∞ → UsageError; some asked for terabytes, one gave a constant"""
    with pytest.raises(UsageError, match="is no sample rate"):
        synthesise(FIELD, steady(0.1), seed=1, sample_rate=rate)


@pytest.mark.parametrize("rate", [100.0, 8000.0, 192_000.0])
def test_resampling_a_stream(rate):
    """Resampled in uneven portions → the whole one's samples, to the last bit"""
    samples = np.random.default_rng(0).standard_normal(30_000)
    borders = [0, 1, 77, 5000, 5001, 20_000, 30_000]
    pieces = [samples[a:b] for a, b in itertools.pairwise(borders)]
    found = np.concatenate(list(resample_stream(pieces, len(samples), MODEL_RATE_HZ, rate)))
    whole, _ = resample(samples, MODEL_RATE_HZ, rate)
    assert len(found) == len(whole) == count_outputs(len(samples), MODEL_RATE_HZ, rate)
    np.testing.assert_array_equal(found, whole)


def test_memory_of_a_low_rate():
    """10 kHz to 100 Hz of a minute → less memory than twenty copies of it; it once took 650 MB"""
    samples = np.zeros(600_000)
    tracemalloc.start()
    try:
        resample(samples, MODEL_RATE_HZ, 100.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 120e6


@pytest.mark.parametrize(("seconds", "words"), [(0.0, "no duration"), (1e-9, "action rate")])
def test_strokes_of_no_time(seconds, words):
    """A stroke of one sample, or of two 1e-9 s apart → StrokeError"""
    action = make_steady_action(0.005, 0.1, 1.0)
    if seconds:
        action = dataclasses.replace(action, rate=1.0 / seconds)
    else:
        names = ("direction", "speed", "force", "position", "contact")
        action = dataclasses.replace(action, **{name: getattr(action, name)[:1] for name in names})
    with pytest.raises(StrokeError, match=words) as caught:
        synthesise(FIELD, uniform_stroke(action, rough_token(), WOOD), seed=0)
    assert caught.value.remedy


def head(rate=10_000.0):
    return Signal(np.zeros(0, dtype=np.float32), rate, 7, {"stroke": "s"})


def test_a_streamed_wav_is_the_written_one(tmp_path):
    """A WAV written block by block → the bytes of one written at once"""
    samples = np.random.default_rng(0).standard_normal(1000).astype(np.float32)
    write_wav(tmp_path / "a.wav", dataclasses.replace(head(), samples=samples))
    write_wav_stream(tmp_path / "b.wav", head(), 1000, [samples[:1], samples[1:1], samples[1:999], samples[999:]])
    assert (tmp_path / "a.wav").read_bytes() == (tmp_path / "b.wav").read_bytes()


def test_a_streamed_wav_that_fails(tmp_path):
    """A stream that breaks, counts wrong, holds NaN or outgrows 4 GB → an error, and the earlier file as it was"""
    path = tmp_path / "x.wav"
    path.write_bytes(b"earlier")

    def breaking():
        yield np.zeros(5, dtype=np.float32)
        raise StrokeError("the stroke is gone.")

    nan = [np.array([0.0, np.nan], dtype=np.float32)]
    for blocks, count, rate, error in (
        (breaking(), 10, 1e4, StrokeError),
        ([np.zeros(5, dtype=np.float32)], 10, 1e4, FileError),
        (nan, 2, 1e4, FileError),
        (breaking(), 2**30, 1e4, FileError),
        (breaking(), 10, 0.5, FileError),
    ):
        with pytest.raises(error):
            write_wav_stream(path, head(rate), count, blocks)
        assert path.read_bytes() == b"earlier"
        assert [each.name for each in tmp_path.iterdir()] == ["x.wav"]


NOISE = np.random.default_rng(0).standard_normal(2000)
SIGNALS = {
    "denormal": NOISE * 1e-44,
    "1e-30": NOISE * 1e-30,
    "1e30": NOISE * 1e30,
    "greatest": np.where(np.arange(2000) % 2, 3.4e38, -3.4e38),
    "constant": np.full(2000, 5.0),
    "silent": np.zeros(2000),
}
WRITTEN = [word for word in FORMATS if word != "glb"]


@pytest.mark.parametrize("word", WRITTEN)
@pytest.mark.parametrize("name", SIGNALS)
def test_formats(tmp_path, word, name):
    """Every format: a signal denormal, 1e±30, ±3.4e38, constant, silent → written, and read again finite"""
    form = FORMATS[word]
    signal = dataclasses.replace(head(), samples=SIGNALS[name].astype(np.float32))
    done = export_signal(signal, form, tmp_path / f"x{form.suffix}", ExportOptions())
    assert done.path.is_file()
    back = form.read(done.path, ImportOptions(rate_hz=10_000.0, seed=7))
    assert np.isfinite(back.samples).all()
    assert "NaN" not in json.dumps(done.to_json())


@pytest.mark.parametrize("word", WRITTEN)
@pytest.mark.parametrize("rate", [0.0, -1.0, 1e9, float("nan"), float("inf")])
def test_formats_without_a_rate(tmp_path, word, rate):
    """Every format: a rate of 0, NaN, ∞ or 1 GHz → FileError, no file"""
    form = FORMATS[word]
    signal = dataclasses.replace(head(rate), samples=NOISE.astype(np.float32))
    with pytest.raises(FileError, match="Hz"):
        export_signal(signal, form, tmp_path / f"x{form.suffix}", ExportOptions())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("rate", [1.0, 100.0, 10_000.0, 192_000.0])
def test_the_limiter(rate):
    """The limiter at 1 Hz to 192 kHz, fed ±1e300, denormals, NaN and ∞ → counts in full scale, slew and peak kept"""
    limits = Limits(100.0, peak=0.8, sustained=0.3, slew_per_s=2000.0)
    given = np.concatenate([1e300 * NOISE[:300], [np.nan, np.inf, -np.inf, 5e-324], 1e-300 * NOISE[:50]])[:, None]
    limiter = Limiter(limits, rate, 1)
    found = limiter.process(given).ravel().astype(np.int64)
    assert np.abs(found).max() <= limits.peak_counts
    assert np.abs(np.diff(found)).max() <= max(2000.0 / rate * 32767, 1.0) + 1
    assert limiter.nonfinite == 3
    assert np.isfinite(limiter.heat).all()
