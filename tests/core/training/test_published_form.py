"""L_mag as published, training by it, raw actions, and the strokes that HNF+ adds."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

torch = pytest.importorskip("torch", reason="training needs the extra [train]")

from hnf_core.action.primitives import PRIMITIVE_NAMES
from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.cli.main import main
from hnf_core.datasets.recording import Recording
from hnf_core.datasets.registry import open_dataset
from hnf_core.errors import UsageError
from hnf_core.export.wav import read_wav
from hnf_core.field.field import FieldConfig, initial_parameters
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field, read_trained_material
from hnf_core.material.contact_model import UNKNOWN_MECHANICS
from hnf_core.material.token import TOKEN_DIM
from hnf_core.metrics.spectra import WINDOW_SAMPLES
from hnf_core.training.model import FieldNetwork
from hnf_core.training.published_form import MagnitudeTask, compute_l_mag, compute_magnitudes, make_added_strokes
from hnf_core.training.train_material import Schedule, train_material
from hnf_core.training.windows import TRAIN, cut_windows

RATE = 10_000
NO_TOKEN = np.zeros(TOKEN_DIM, dtype=np.float32)
SMALL = FieldConfig.published(hidden=32)


def texture(seconds: float = 5.0, seed: int = 1) -> Recording:
    action = make_random_smooth_action(seconds, seed, speed_m_s=(0.03, 0.3), force_n=(0.2, 3.0))
    speed = np.interp(np.arange(round(seconds * RATE)) / RATE, action.time, action.speed)
    noise = np.random.default_rng(seed).standard_normal(len(speed))
    return Recording(action, 10.0 * speed * np.convolve(noise, np.ones(8) / 8.0, "same"), RATE, "noise", "made up")


def write_table(path: Path, recording: Recording, tip_kg: float = 0.05) -> None:
    """As a pen with a load cell behind its tip records a stroke: the vibration is in the force."""
    time = np.arange(len(recording.samples)) / RATE
    action = recording.action
    force = np.interp(time, action.time, action.force) + tip_kg * recording.samples
    speed = np.interp(time, action.time, action.speed)
    path.parent.mkdir(parents=True, exist_ok=True)
    columns = np.stack([time, recording.samples, force, speed], axis=1)
    header = "time [s],acceleration [m/s^2],force [N],speed [m/s]"
    np.savetxt(path, columns, "%.8g", ",", header=header, comments="")


@pytest.fixture(scope="module")
def own(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("own")
    write_table(folder / "noise" / "one.csv", texture(3.0))
    return folder


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda arguments: pytest.fail("no Blender is needed"))


def plain_l_mag(predicted, recorded, bins):
    """The formula, term by term, with a DFT written out."""
    n = np.arange(1000)
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * n / 1000.0)
    total = 0.0
    for a, b in zip(predicted, recorded, strict=True):
        for k in range(1, bins + 1):
            wave = window * np.exp(-2j * np.pi * k * n / 1000.0)
            total += (abs(np.sum(wave * a)) - abs(np.sum(wave * b))) ** 2
    return total / (len(predicted) * bins)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 4), st.sampled_from((1, 7, 100)))
def test_l_mag_is_the_formula(seed, count, bins):
    a, b = torch.from_numpy(np.random.default_rng(seed).standard_normal((2, count, 1000)))
    value = compute_l_mag(a, compute_magnitudes(b, bins))
    assert float(value) == pytest.approx(plain_l_mag(a.numpy(), b.numpy(), bins), rel=1e-9)


def test_l_mag_hears_10_to_1000_hz_and_no_phase():
    n = np.arange(1000) / RATE
    silence = torch.zeros(1, 100, dtype=torch.float64)

    def tone(hz, phase=0.0):
        return torch.from_numpy(np.sin(2.0 * np.pi * hz * n + phase))[None]

    assert float(compute_l_mag(tone(1100.0), silence)) < 1e-20
    assert float(compute_l_mag(tone(200.0), silence)) > 100.0
    assert float(compute_l_mag(tone(200.0), compute_magnitudes(tone(200.0, 1.0)))) < 1e-9


def test_the_gradient_at_silence_is_finite():
    silent = torch.zeros(2, 1000, requires_grad=True)
    compute_l_mag(silent, torch.ones(2, 100)).backward()
    assert torch.isfinite(silent.grad).all()


def make_task(recordings, raw=False):
    states, windows = cut_windows(recordings, hop=WINDOW_SAMPLES, raw=raw)
    return MagnitudeTask(SMALL, 200, states, windows, NO_TOKEN, UNKNOWN_MECHANICS, raw=raw), windows


def test_targets_are_the_recorded_magnitudes():
    recording = texture(2.0)
    task, windows = make_task([recording])
    segments = torch.from_numpy(recording.samples.reshape(-1, 1000))
    torch.testing.assert_close(task.magnitude, compute_magnitudes(segments).float(), rtol=1e-5, atol=1e-6)
    assert windows.role.tolist() == [0, 0, 0, 0, 0, 0, 0, 0, 1, 2] * 2


def test_evaluation_at_the_action_rate_equals_every_sample():
    """A network of the published shape needs no finer rate, since a smooth action has no detail between its samples."""
    recording = texture(2.0)
    action, time = recording.action, np.arange(2 * RATE + 1) / RATE
    fine = replace(
        action, rate=float(RATE), contact=np.ones(len(time), dtype=bool),
        direction=np.stack([np.interp(time, action.time, axis) for axis in action.direction.T], axis=1),
        **{name: np.interp(time, action.time, getattr(action, name)) for name in ("speed", "force", "position")},
    )  # fmt: skip
    recorded = replace(recording, measure_raw_action=lambda: fine)
    network = FieldNetwork(SMALL, initial_parameters(SMALL, 3))
    rows = torch.arange(20)
    with torch.no_grad():
        states, every = (make_task([recorded], raw)[0].predict(network, rows) for raw in (False, True))
    assert every.shape == (20, 1000)
    assert float((every - states).abs().max()) < 1e-2 * float(every.abs().max())


def test_synthesis_of_a_raw_action_is_what_was_trained():
    """The same samples as in training, but for the low-pass at 1 kHz, which L_mag does not hear."""
    recording = texture(1.0)
    rng, count = np.random.default_rng(5), RATE + 1
    raw = replace(
        recording.action, rate=float(RATE), direction=np.tile([1.0, 0.0], (count, 1)), speed=np.full(count, 0.1),
        force=1.0 + 0.1 * rng.standard_normal(count), position=0.1 * np.arange(count) / RATE,
        contact=np.ones(count, dtype=bool),
    )  # fmt: skip
    recorded = replace(recording, measure_raw_action=lambda: raw)
    trained = train_material([recorded], SMALL, 0, schedule=Schedule.published(2), raw=True)
    task, _ = make_task([recorded], raw=True)
    with torch.no_grad():
        predicted = task.predict(FieldNetwork(SMALL, trained.field.parameters), torch.arange(10)).numpy().ravel()
    signal = synthesise(trained.field, uniform_stroke(raw, NO_TOKEN, UNKNOWN_MECHANICS), seed=1).signal.samples
    spectra = [np.fft.rfft(np.hanning(RATE) * samples.astype(np.float64)) for samples in (predicted, signal)]
    heard, above = slice(20, 980), slice(1150, 5000)
    np.testing.assert_allclose(spectra[1][heard], spectra[0][heard], atol=2e-3 * np.abs(spectra[0][heard]).max())
    assert np.abs(spectra[0][above]).max() > 100.0 * np.abs(spectra[1][above]).max()


def test_a_rate_without_sensors_is_refused():
    with pytest.raises(UsageError, match="no sensor recorded"):
        cut_windows([texture(2.0)], raw=True)


@pytest.mark.parametrize("from_process", [True, False])
def test_primitives_are_added_and_only_learned_from(from_process: bool) -> None:
    process = open_dataset("simulated", None).process("oak-wood") if from_process else None
    recordings = [texture(6.0, seed) for seed in (1, 2)]
    added = make_added_strokes(process, recordings, 3)
    assert len(added) % len(PRIMITIVE_NAMES) == 0
    alone, both = cut_windows(recordings)[1], cut_windows(recordings, added)[1]
    count = len(alone.role)
    np.testing.assert_array_equal(both.role[:count], alone.role)
    np.testing.assert_array_equal(both.power[:count], alone.power)
    assert len(both.role) > count
    assert (both.role[count:] == TRAIN).all()


def test_borrowed_windows_are_of_like_speed_and_force() -> None:
    recordings = [texture(10.0, seed) for seed in (1, 2)]
    training = {
        recording.samples[1000 * slot : 1000 * slot + 1000].tobytes()
        for recording in recordings
        for slot in range(100)
        if slot % 10 < 8
    }
    power = []
    for stroke in make_added_strokes(None, recordings, 0):
        whole = len(stroke.samples) // 1000
        assert {row.tobytes() for row in stroke.samples[: 1000 * whole].reshape(-1, 1000)} <= training
        power.append((float(np.mean(stroke.action.speed)), float(np.std(stroke.samples))))
    slow, fast = min(power), max(power)
    assert fast[0] > 2.0 * slow[0]
    assert fast[1] > 1.5 * slow[1]  # this texture is as loud as the hand is fast


QUICK = ("--form", "published", "--hidden", "24", "--layers", "2", "--epochs", "2")


@pytest.mark.parametrize("more", [(), ("--actions", "raw"), ("--augment",)])
def test_own_recordings_to_a_wav(own: Path, tmp_path: Path, capsys, more) -> None:
    out, wav = tmp_path / "noise.safetensors", tmp_path / "x.wav"
    words = ("train", "field", "--data", "own", own, "--material", "noise", "--out", out, *QUICK, *more)
    assert hnf(*words) == 0
    told = capsys.readouterr().out
    raw = "raw" if "raw" in more else "low-passed"
    assert "N = 5 heads, L = 2, H = 24, L_mag over C = 200 windows of 1000 samples, K = 100, 1 kHz low-pass" in told
    assert f"Adam 0.01 with a cosine, 2 epochs, split 8/1/1, {raw} actions" in told
    assert ("primitives added" in told) == ("--augment" in more)
    field = load_field(out)
    assert field.config == FieldConfig.published(24, 2)
    assert field.metadata["actions"] == raw
    assert field.metadata["settings"] in told
    assert read_trained_material(field, "here").name == "noise"
    first = out.read_bytes()
    assert hnf(*words) == 0
    assert out.read_bytes() == first
    assert hnf("synth", "--weights", out, "--stroke", "rub-slow", "--out", wav) == 0
    assert read_wav(wav).duration_s == pytest.approx(2.0)


def test_a_raw_table_is_felt_at_its_own_rate(own: Path, tmp_path: Path) -> None:
    """A force that vibrates at 300 Hz is felt at 300 Hz by weights of raw actions alone."""
    time = np.arange(RATE + 1) / RATE
    rows = np.stack([time, 0 * time, 0.1 + 0 * time, 1.0 + 0.5 * np.sin(2 * np.pi * 300.0 * time)], axis=1)
    table = tmp_path / "a.csv"
    np.savetxt(table, rows, "%.8g", ",", header="time_s,direction_rad,speed_m_s,force_n", comments="")
    level = {}
    for actions in ("raw", "low-passed"):
        out, wav = tmp_path / f"{actions}.safetensors", tmp_path / f"{actions}.wav"
        words = ("train", "field", "--data", "own", own, "--material", "noise", "--out", out, *QUICK)
        assert hnf(*words, "--actions", actions) == 0
        assert hnf("synth", "--weights", out, "--action", table, "--out", wav) == 0
        samples = read_wav(wav).samples.astype(np.float64)
        spectrum = np.abs(np.fft.rfft(np.hanning(len(samples)) * samples)) / len(samples)
        level[actions] = float(spectrum[round(300.0 * len(samples) / RATE)] / spectrum.max())
    assert level["raw"] > 30.0 * level["low-passed"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--data", "own", "{own}", "--material", "noise", "--actions", "raw"), "--form published alone"),
        (("--data", "own", "{own}", "--material", "noise", *QUICK, "--accumulation", "past"), "no past states"),
        (("--data", "own", "{own}", "--material", "noise", "--epochs", "0"), "at least 1"),
        (("--data", "simulated", "--material", "denim", "--form", "published", "--actions", "raw"), "no raw action"),
    ],
)
def test_what_does_not_go_together_is_said(own: Path, tmp_path: Path, capsys, words, told) -> None:
    filled = [word.replace("{own}", str(own)) for word in words]
    assert hnf("train", "field", *filled, "--out", tmp_path / "x.safetensors") == 2
    assert told in capsys.readouterr().err


def test_the_default_on_recordings_says_what_it_took(own: Path, tmp_path: Path, capsys) -> None:
    """Past states and the token are tried; the best of the validation windows is what is in the file."""
    out = tmp_path / "noise.safetensors"
    words = ("train", "field", "--data", "own", own, "--material", "noise", "--out", out, "--json")
    small = ("--hidden", "8", "--layers", "1", "--epochs", "2")
    assert hnf(*words, *small) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["choice"].startswith("took N = ")
    assert "N = 1 " in record["choice"]
    assert "N = 5 past states " in record["choice"]
    taken = load_field(out)
    losses = {
        part.rsplit(" ", 1)[0]: float(part.rsplit(" ", 1)[1].rstrip(")"))
        for part in record["choice"].split(": ")[1].split(", ")
    }
    assert taken.config.states == (1 if losses["N = 1"] <= losses["N = 5 past states"] else 5)
    assert not list(tmp_path.glob("*checkpoint"))
    assert hnf(*words, *small, "--states", "1") == 0
    assert json.loads(capsys.readouterr().out)["choice"] == ""


def test_the_token_of_the_same_name_is_tried(own: Path, tmp_path: Path, capsys) -> None:
    write_table(tmp_path / "own" / "Oak wood" / "one.csv", texture(2.0))
    out = tmp_path / "oak.safetensors"
    small = ("--hidden", "8", "--layers", "1", "--epochs", "1")
    words = ("train", "field", "--data", "own", tmp_path / "own", "--material", "Oak wood", "--out", out, *small)
    assert hnf(*words) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert "token of oak-wood " in line
    assert read_trained_material(load_field(out), "here").token.any() == line.startswith(
        "took token of oak-wood with N"
    )
