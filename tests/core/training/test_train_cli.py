"""`hnf train field` on a written model and, where present, on a published one."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from hatt_files import HATT, model_xml, needs_hatt

pytest.importorskip("torch", reason="training needs the extra [train]")

from steady_spectra import expected_spectrum

from hnf_core.cli.main import main
from hnf_core.datasets.hatt_models import read_texture_model
from hnf_core.datasets.recording import Recording
from hnf_core.datasets.registry import get_training_recordings, open_dataset
from hnf_core.export.wav import read_wav
from hnf_core.field.weights import load_field, read_trained_material
from hnf_core.training.from_recordings import TrainingOverrides, train_from_recordings
from hnf_lab.baselines.piecewise_ar import compute_power_spectrum

QUICK = ("--seconds", "20", "--epochs", "2", "--hidden", "16", "--layers", "2")


def hnf(*words) -> int:
    def no_blender(arguments):
        raise AssertionError("train needs no Blender")

    return main([str(word) for word in words], no_blender)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    models = tmp_path / "HaTT" / "Models10000Hz" / "XML"
    models.mkdir(parents=True)
    (models / "Models_Test Cloth.xml").write_text(model_xml(), encoding="utf-8")
    return tmp_path / "HaTT"


def test_weights_that_synth_takes_with_a_curve_beside_them(folder: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out" / "cloth.safetensors"
    words = ("train", "field", "--data", "hatt", folder, "--material", "test cloth", "--out", out, *QUICK, "--json")
    assert hnf(*words) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["material"] == "Test Cloth"
    assert record["training_data"] == "20 s of hatt strokes"
    assert record["test"]["windows"] == 20
    assert Path(record["curve"]).read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in out.parent.iterdir()) == ["cloth.curve.png", "cloth.safetensors"]
    field = load_field(out)
    assert read_trained_material(field, "here").name == "Test Cloth"
    assert field.ranges.sectors == ()
    assert field.ranges.force[1] <= 4.0
    assert "not to be redistributed" in field.metadata["licence"]
    wav = tmp_path / "x.wav"
    assert hnf("synth", "--weights", out, "--stroke", "left-right-soft", "--out", wav) == 0
    assert read_wav(wav).rms > 0.0
    first = out.read_bytes()
    assert hnf(*words) == 0
    assert out.read_bytes() == first


def test_plain_arrays_train_the_same_field(folder: Path) -> None:
    """Only actions and waveforms reach the trainer, never a model's coefficients."""
    loaded = get_training_recordings(open_dataset("hatt", folder), "Test Cloth", 20.0, 0)
    plain = [
        Recording(each.action, np.array(each.samples.tolist()), 10_000.0, "Test Cloth", "arrays", each.known)
        for each in loaded
    ]
    small = TrainingOverrides(hidden=8, layers=1, epochs=1)
    (first, _), (second, _) = (train_from_recordings(some, "hatt", "", 0, small) for some in (loaded, plain))
    for name, value in first.field.parameters.items():
        np.testing.assert_array_equal(value, second.field.parameters[name])


def test_simulated_materials_train_with_token_and_direction(tmp_path: Path, capsys) -> None:
    out = tmp_path / "denim.safetensors"
    words = ("--seconds", "5", "--epochs", "1", "--hidden", "16", "--layers", "1")
    assert hnf("train", "field", "--data", "simulated", "--material", "denim", "--out", out, *words) == 0
    assert "denim" in capsys.readouterr().out
    field = load_field(out)
    assert field.config.physics
    assert field.config.directed
    assert field.config.carriers.arc_count
    assert read_trained_material(field, "here").token.any()


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (("--data", "hatt", "{folder}", "--material", "Velvet"), 1, "Test Cloth"),
        (("--data", "hatt", "{folder}/none", "--material", "Velvet"), 1, "none"),
        (("--data", "hatt", "--material", "Velvet"), 2, "folder"),
        (("--data", "hat", "{folder}", "--material", "Velvet"), 2, "hatt"),
        (("--data", "hatt", "a", "b", "--material", "Velvet"), 2, "Quote"),
        (("--data", "hatt", "{folder}", "--material", "Test Cloth", "--seconds", "1"), 2, "at least 5"),
        (("--data", "hatt", "{folder}", "--material", "Test Cloth", "--source", "recordings"), 2, "recordings"),
    ],
)
def test_wrong_words_are_told_and_cost_nothing(folder: Path, tmp_path: Path, capsys, words, status, told) -> None:
    out = tmp_path / "kept.safetensors"
    out.write_bytes(b"saved before")
    filled = [word.replace("{folder}", str(folder)) for word in words]
    assert hnf("train", "field", *filled, "--out", out) == status
    assert told in capsys.readouterr().err
    assert out.read_bytes() == b"saved before"


def test_weights_must_be_called_safetensors(folder: Path, tmp_path: Path, capsys) -> None:
    words = ("--data", "hatt", folder, "--material", "Test Cloth", "--out", tmp_path / "x.pt")
    assert hnf("train", "field", *words) == 2
    assert ".safetensors" in capsys.readouterr().err


def test_a_run_killed_outright_is_taken_up_again(folder: Path, tmp_path: Path, capsys) -> None:
    """What is killed is a process of its own; the other runs are in this one, which has loaded torch."""

    def build_words(out: Path) -> list[str]:
        words = ["train", "field", "--data", "hatt", str(folder), "--material", "Test Cloth", "--out", str(out)]
        return [*words, "--seconds", "8", "--epochs", "6", "--hidden", "16", "--layers", "2"]

    whole, killed = tmp_path / "whole.safetensors", tmp_path / "killed.safetensors"
    assert hnf(*build_words(whole)) == 0
    checkpoint = tmp_path / "killed.safetensors.checkpoint"
    code = "import sys; from hnf_core.cli.main import main; sys.exit(main(sys.argv[1:], lambda arguments: 1))"
    run = subprocess.Popen([sys.executable, "-c", code, *build_words(killed)], stdout=subprocess.DEVNULL)
    for _ in range(4000):
        if checkpoint.exists() or run.poll() is not None:
            break
        time.sleep(0.02)
    run.send_signal(signal.SIGKILL)
    assert run.wait(timeout=20) == -signal.SIGKILL
    assert checkpoint.exists()
    assert not killed.exists()
    capsys.readouterr()
    assert hnf(*build_words(killed)) == 0
    assert "began anew" not in capsys.readouterr().err
    assert killed.read_bytes() == whole.read_bytes()
    assert not checkpoint.exists()
    checkpoint.write_bytes(b"no checkpoint")
    assert hnf(*build_words(killed)) == 0
    assert f"{checkpoint} is damaged or of another run" in capsys.readouterr().err
    assert killed.read_bytes() == whole.read_bytes()


@needs_hatt
def test_a_published_texture_is_learned_to_its_exact_spectrum(tmp_path: Path) -> None:
    """A quarter of the default's strokes and half of its epochs, to stay short; docs/field.md has the full figures."""
    out = tmp_path / "abs.safetensors"
    words = ("--data", "hatt", HATT, "--material", "ABS Plastic", "--out", out, "--seconds", "120", "--epochs", "20")
    assert hnf("train", "field", *words) == 0
    field = load_field(out)
    material = read_trained_material(field, "here")
    model = read_texture_model(HATT / "models_10khz" / "Models_ABS Plastic.xml")
    frequency = np.arange(20.0, 1001.0, 10.0)
    distances = []
    for speed in (0.05, 0.1, 0.15):
        for force in (0.5, 1.0, 2.0):
            exact = compute_power_spectrum(model, speed, force, frequency)
            found = expected_spectrum(
                field, material.token, material.mechanics, "pen", (1.0, 0.0), speed, force, frequency
            )
            loud = exact > 1e-3 * exact.max()
            distances.append(np.sqrt(np.mean(np.square(10.0 * np.log10(found[loud] / exact[loud])))))
    assert np.mean(distances) < 0.8


@pytest.mark.parametrize(
    ("words", "column", "said"),
    [
        (("--states", "0"), None, "--states must be at least 1"),
        (("--hidden", "-3"), None, "--hidden must be at least 1"),
        (("--layers", "0"), None, "--layers must be at least 1"),
        (("--source", "model"), None, "there is no model"),
        (("--seconds", "5"), None, "--seconds is for strokes on a model"),
        ((), "acceleration", "is constant throughout"),
        ((), "speed", "no recorded stroke ever moves"),
        ((), "force", "no recorded stroke ever presses"),
    ],
)
def test_own_recordings_are_refused_in_words(tmp_path: Path, capsys, words, column, said) -> None:
    time = np.arange(30_001) / 10_000.0
    table = {
        "time": time, "acceleration": np.random.default_rng(0).normal(size=len(time)),
        "force": np.ones(len(time)), "speed": np.full(len(time), 0.1),
    }  # fmt: skip
    if column is not None:
        table[column] = np.zeros(len(time))
    (tmp_path / "own" / "cloth").mkdir(parents=True)
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.stack(list(table.values()), axis=1)]
    (tmp_path / "own" / "cloth" / "1.csv").write_text("\n".join([",".join(table), *rows]), encoding="utf-8")
    out = tmp_path / "cloth.safetensors"
    data = ("--data", "own", tmp_path / "own", "--material", "cloth", "--epochs", "1")
    assert hnf("train", "field", *data, "--hidden", "8", "--layers", "1", "--out", out, *words) != 0
    assert said in capsys.readouterr().err
    assert not out.exists()
