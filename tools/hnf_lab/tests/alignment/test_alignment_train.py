"""Training two encoders: it learns, ends when told, a killed run goes on to the same weights; and the words of it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from alignment_pairs import write_pairs

torch = pytest.importorskip("torch", reason="alignment trains with torch")

from safetensors.torch import save_file

from hnf_core.cli.main import main
from hnf_core.errors import FileError, UsageError, WeightsError
from hnf_core.material.shared_space import load_space
from hnf_lab.alignment import train
from hnf_lab.alignment.encoders import (
    Architecture,
    HeadArchitecture,
    ResNetEncoder,
    compute_varied_statistics,
    embed_images,
    embed_touches,
)
from hnf_lab.alignment.inputs import open_source
from hnf_lab.alignment.results import compute_recall
from hnf_lab.alignment.train import Recipe, fit_encoders, load_encoders, save_encoders, save_shared_space

TINY = Architecture((1, 1, 1, 1), 4, 8)
RECIPE = Recipe(pixels=32, batch=16, chunk=16, steps=6, rate=3e-3, architecture=TINY)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pairs")
    write_pairs(folder)
    return folder


@pytest.fixture(scope="module")
def tuples(folder: Path):
    return open_source([[str(folder)]]).load_training()


def weights(fitted) -> dict:
    return {f"{name}.{key}": value for name in ("vision", "touch")
            for key, value in getattr(fitted, name).state_dict().items()}  # fmt: skip


def assert_same(one: dict, other: dict) -> None:
    assert one.keys() == other.keys()
    assert [name for name in one if not torch.equal(one[name], other[name])] == []


@pytest.mark.parametrize("chunk", [16, 8])
def test_the_right_touch_is_found_after_training(tuples, chunk: int) -> None:
    """Among 96 patches; with gradients cached as well."""
    wide = Architecture((1, 1, 1, 1), 8, 8)
    fitted = fit_encoders(tuples, replace(RECIPE, steps=60, rate=1e-2, chunk=chunk, architecture=wide))
    losses = fitted.history[:, 2]
    assert losses[-10:].mean() < np.log(16) - 0.1  # what knowing nothing costs
    assert fitted.history[:, 0].tolist() == list(range(1, 61))
    assert not fitted.vision.training
    looks, touches = embed_images(fitted.vision, tuples, 32).points, embed_touches(fitted.touch, tuples, 32, 0).points
    assert compute_recall(looks, touches, (10,))[10] > 0.19  # chance 0.10, three deviations 0.09


HEADS = replace(RECIPE, pixels=64, steps=40, piece_weight=0.2, architecture=HeadArchitecture(32, looks=2))


@pytest.fixture(scope="module")
def heads(tuples):
    return fit_encoders(tuples, HEADS)


def test_heads_find_the_right_touch_and_survive_a_kill(tuples, heads, tmp_path, monkeypatch) -> None:
    looks, touches = embed_images(heads.vision, tuples, 64), embed_touches(heads.touch, tuples, 64, 0)
    assert compute_recall(looks.points, touches.points, (10,))[10] > 0.25  # chance 0.10
    assert looks.features.shape == (len(tuples), 32)
    monkeypatch.setattr(train, "CHECKPOINT_INTERVAL_S", 0.0)

    def kill_later(progress: float, loss: float) -> None:
        if progress > 0.4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_encoders(tuples, HEADS, tmp_path / "checkpoint", kill_later)
    assert_same(weights(heads), weights(fit_encoders(tuples, HEADS, tmp_path / "checkpoint")))


def test_the_space_is_the_heads_without_torch(tuples, heads, tmp_path: Path) -> None:
    save_encoders(tmp_path, heads, HEADS, {"sensor": "both"})
    models = load_encoders(tmp_path)
    assert save_shared_space(tmp_path / "space.safetensors", models, tuples)
    space = load_space(tmp_path / "space.safetensors")
    touch = embed_touches(models.touch, tuples, 64, 0).points
    found = (tuples.label >= 0) & (tuples.sensor == 0)
    assert len(space.points) == found.sum()
    statistics = compute_varied_statistics(tuples, 0, 0)
    with torch.no_grad():
        there = {"vision": models.vision(statistics.vision), "touch": models.touch(statistics.touch)}
    for name, inputs in (("vision", statistics.vision), ("touch", statistics.touch)):
        here = space.heads[name].embed(inputs.numpy())
        assert np.sum(here * there[name].numpy(), axis=1).min() > 0.9995  # weights are stored in half precision
    assert touch.shape[1] == space.points.shape[1]
    network = fit_encoders(tuples, replace(RECIPE, steps=1))
    assert not save_shared_space(
        tmp_path / "none.safetensors", replace(models, vision=network.vision, touch=network.touch), tuples
    )
    assert not (tmp_path / "none.safetensors").exists()


def test_equal_seeds_give_equal_weights_and_others_do_not(tuples) -> None:
    one, same, other = (weights(fit_encoders(tuples, replace(RECIPE, seed=seed))) for seed in (0, 0, 1))
    assert_same(one, same)
    assert not torch.equal(one["touch.fc.weight"], other["touch.fc.weight"])


def test_a_killed_run_goes_on_to_the_same_weights(tuples, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(train, "CHECKPOINT_INTERVAL_S", 0.0)
    whole = weights(fit_encoders(tuples, RECIPE))
    path = tmp_path / "checkpoint"
    done = []

    def killed(progress: float, loss: float) -> None:
        done.append(loss)
        if len(done) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_encoders(tuples, RECIPE, path, killed)
    resumed = fit_encoders(tuples, RECIPE, path, lambda progress, loss: done.append(loss))
    assert len(done) == 7  # the step during which it was killed is done again
    assert_same(whole, weights(resumed))
    other = fit_encoders(tuples, replace(RECIPE, seed=3), path)
    assert len(other.history) == 6
    assert_same(weights(other), weights(fit_encoders(tuples, replace(RECIPE, seed=3))))


def test_minutes_end_it_and_steps_do_if_they_come_first(tuples) -> None:
    short = fit_encoders(tuples, replace(RECIPE, steps=None, minutes=0.01))
    assert 1 <= len(short.history) < 200
    assert short.history[-1, 1] >= 0.6
    assert len(fit_encoders(tuples, replace(RECIPE, steps=2, minutes=10.0)).history) == 2
    with pytest.raises(UsageError, match="needs an end"):
        Recipe()
    with pytest.raises(UsageError, match="fewer than a batch"):
        fit_encoders(tuples, replace(RECIPE, batch=1000))


def test_the_rate_rises_and_falls() -> None:
    rates = [RECIPE.compute_learning_rate(progress) for progress in np.linspace(0.0, 1.0, 101)]
    top = int(np.argmax(rates))
    assert np.all(np.diff(rates[: top + 1]) > 0)
    assert np.all(np.diff(rates[top:]) < 0)
    assert max(rates) == pytest.approx(RECIPE.rate, rel=0.02)
    assert rates[-1] == pytest.approx(0.0, abs=1e-12)


def test_weights_come_back_and_damaged_ones_do_not(tuples, tmp_path: Path) -> None:
    fitted = fit_encoders(tuples, replace(RECIPE, steps=1))
    record = save_encoders(tmp_path, fitted, RECIPE, {"sensor": "both"})
    back = load_encoders(tmp_path)
    assert (back.sensor, back.pixels) == ("both", 32)
    assert_same(weights(fitted), weights(back))
    assert json.loads((tmp_path / "alignment.json").read_text())["sha256"] == record["sha256"]
    assert save_encoders(tmp_path / "again", fitted, RECIPE, {"sensor": "both"}) == record
    data = bytearray((tmp_path / "touch.safetensors").read_bytes())
    data[-1] ^= 1
    (tmp_path / "touch.safetensors").write_bytes(data)
    with pytest.raises(WeightsError, match="not the file"):
        load_encoders(tmp_path)
    (tmp_path / "touch.safetensors").write_bytes(b"no weights")
    with pytest.raises(FileError, match="no aligned encoders"):
        load_encoders(tmp_path)
    with pytest.raises(FileError, match="no aligned encoders"):
        load_encoders(tmp_path / "none")


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda arguments: 1)


def test_the_words_train_and_judge(folder: Path, tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.setattr(train, "RESNET50", TINY)
    quick = ("--data", folder, "--steps", "2", "--batch", "16", "--pixels", "32", "--encoder", "resnet50", "--json")
    trunk = tmp_path / "trunk.safetensors"
    save_file(ResNetEncoder(TINY).state_dict(), trunk)
    for sensor, more in (("gelsight", ()), ("both", ("--trunk", trunk))):
        assert hnf("train", "alignment", *quick, "--sensor", sensor, "--out", tmp_path / sensor, *more) == 0
        record = json.loads(capsys.readouterr().out)
        assert record["sensor"] == sensor
        assert record["tuples"] == (96 if sensor == "both" else 52)
        assert sorted(path.name for path in (tmp_path / sensor).iterdir()) == [
            "alignment.json", "touch.safetensors", "vision.safetensors"
        ]  # fmt: skip
    judged = ("eval", "alignment", "--data", folder, "--models", tmp_path / "gelsight", tmp_path / "both")
    assert hnf(*judged, "--items", "40", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["chance"] == {"known": pytest.approx(0.348, abs=1e-3), "unseen": pytest.approx(0.522, abs=1e-3)}
    rows = {(row["data"], row["trained_on"], row["head"], row["tested_on"]) for row in told["accuracy"]}
    assert ("known", "gelsight", "touch", "digit") in rows
    assert ("unseen", "both", "vision", "looks") in rows
    assert {(each["trained_on"], each["tested_on"]) for each in told["kept"]} == {
        ("gelsight", "digit"), ("both", "gelsight")
    } - {("gelsight", "digit")}  # fmt: skip
    assert len(told["models"]) == 2
    assert hnf(*judged, "--items", "40") == 0
    assert "| touch | both | DIGIT |" in capsys.readouterr().out


def test_wrong_words_are_told(folder: Path, tmp_path: Path, capsys) -> None:
    out = ("--out", tmp_path / "out")
    assert hnf("train", "alignment", "--data", folder, *out) == 2
    assert "how many minutes or steps" in capsys.readouterr().err
    assert hnf("train", "alignment", "--data", tmp_path / "none", "--steps", "1", *out) == 1
    assert "no tactile pairs here" in capsys.readouterr().err
    assert hnf("train", "alignment", "--data", folder, "--steps", "1", "--trunk", folder / "no.pth", *out) == 1
    torch.save(ResNetEncoder(TINY).state_dict(), tmp_path / "trunk.pth")
    assert hnf("train", "alignment", "--data", folder, "--steps", "1", "--trunk", tmp_path / "trunk.pth", *out) == 1
    assert "torchvision.models.resnet50(" in capsys.readouterr().err
    assert hnf("train", "alignment", "--data", folder, "--minutes", "0", *out) == 2
    assert hnf("train", "alignment", "--data", folder, "--steps", "1", "--pixels", "48", *out) == 2
    assert "are a ResNet-50's" in capsys.readouterr().err
    assert hnf("eval", "alignment", "--models", tmp_path / "none") == 1
    assert hnf("eval", "alignment", "--models", tmp_path, "--items", "3") == 2
