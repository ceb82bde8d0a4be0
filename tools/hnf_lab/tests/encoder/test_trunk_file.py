"""Trunks that users bring: torchvision's AlexNet, read as data alone and checked."""

import hashlib
import os
import shlex
import subprocess
import sys

import pytest
from alexnet_parts import HIDDEN, random_tensors, trunk_names

from hnf_core.errors import FileError, WeightsError
from hnf_core.material.alexnet_encoder import AlexNetConfig

torch = pytest.importorskip("torch", reason="trunks are for training, which needs torch")
from safetensors.torch import save_file

from hnf_lab.encoder.network import (
    load_backbone,
    read_state_dict,
)


def torchvision_state(seed: int = 5) -> dict:
    """Make the state dict of torchvision.models.alexnet(), with a small classifier in place of the large one."""
    tensors = random_tensors(AlexNetConfig(hidden=HIDDEN), seed)
    state = {name: torch.tensor(tensors[name]) for name in trunk_names()}
    return {**state, "classifier.1.weight": torch.zeros(4, 4), "classifier.1.bias": torch.zeros(4)}


def write(path, state):
    if path.suffix == ".safetensors":
        save_file(state, path)
    else:
        torch.save(state, path)
    return path


@pytest.fixture(autouse=True)
def torch_that_reads_nothing(monkeypatch):
    def unpickled(*args, **kwargs):
        raise AssertionError("a file was given to torch to unpickle")

    monkeypatch.setattr(torch, "load", unpickled)


@pytest.mark.parametrize("kind", [torch.float32, torch.float16, torch.bfloat16])
def test_a_trunk_in_torchvisions_form_is_read(tmp_path, kind):
    state = {name: value.to(kind) for name, value in torchvision_state().items()}
    path = write(tmp_path / "alexnet.safetensors", state)
    trunk, digest = load_backbone(path)
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert list(trunk) == trunk_names()
    assert all(torch.equal(trunk[each], state[each].float()) for each in trunk)
    assert {value.dtype for value in trunk.values()} == {torch.float32}


def test_what_is_no_trunk_is_refused_in_words(tmp_path):
    state = torchvision_state()
    without = {name: value for name, value in state.items() if name != "features.6.bias"}
    with pytest.raises(WeightsError, match=r"missing \['features.6.bias'\]"):
        load_backbone(write(tmp_path / "a.safetensors", without))
    with pytest.raises(WeightsError, match=r"unknown \['layer1"):
        load_backbone(write(tmp_path / "b.safetensors", {**state, "layer1.0.conv1.weight": torch.zeros(2)}))
    with pytest.raises(WeightsError, match=r"features.0.weight is \(96, 3, 11, 11\)"):
        load_backbone(write(tmp_path / "c.safetensors", {**state, "features.0.weight": torch.zeros(96, 3, 11, 11)}))
    with pytest.raises(WeightsError, match="not finite"):
        load_backbone(write(tmp_path / "d.safetensors", {**state, "features.0.bias": torch.full((64,), float("nan"))}))
    with pytest.raises(WeightsError, match=r"features.0.bias is torch\.int64"):
        load_backbone(
            write(tmp_path / "i.safetensors", {**state, "features.0.bias": torch.zeros(64, dtype=torch.int64)})
        )
    with pytest.raises(WeightsError, match="state dict"):
        load_backbone(write(tmp_path / "e.pth", [torch.zeros(1)]))
    (tmp_path / "f.pth").write_bytes(b"not weights at all")
    (tmp_path / "f.safetensors").write_bytes(b"not weights at all")
    for name in ("f.pth", "f.safetensors"):
        with pytest.raises(WeightsError, match="not a file of weights"):
            load_backbone(tmp_path / name)
    with pytest.raises(FileError, match="cannot read"):
        load_backbone(tmp_path / "absent.pth")


@pytest.mark.parametrize("name", ["alexnet.pth", "alexnet.pt", "alexnet", "renamed.safetensors"])
@pytest.mark.parametrize("zipped", [True, False])
def test_torchs_own_files_are_refused_unread(tmp_path, name, zipped):
    torch.save(torchvision_state(), tmp_path / name, _use_new_zipfile_serialization=zipped)
    with pytest.raises(WeightsError, match="not a file of weights") as caught:
        load_backbone(tmp_path / name)
    assert "python -c" in caught.value.remedy


class WritesWhenRead:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


@pytest.mark.parametrize("name", ["evil.pth", "evil.safetensors"])
def test_a_file_that_would_run_a_program_is_refused(tmp_path, name):
    written = tmp_path / "written"
    torch.save({**torchvision_state(), "features.0.bias": WritesWhenRead(written)}, tmp_path / name)
    with pytest.raises(WeightsError, match="not a file of weights"):
        load_backbone(tmp_path / name)
    assert not written.exists()


TORCHVISION = """
import torch


class Network:
    def state_dict(self):
        return {"features.0.bias": torch.arange(3.0)}


def alexnet(weights):
    assert weights == "DEFAULT"
    return Network()


resnet50 = alexnet
"""


@pytest.mark.parametrize("network", ["alexnet", "resnet50"])
def test_the_remedy_is_a_command_that_writes_what_is_read(tmp_path, network):
    package = tmp_path / "packages" / "torchvision"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("from . import models\n")
    (package / "models.py").write_text(TORCHVISION)
    torch.save({}, tmp_path / "mine.pth")
    with pytest.raises(WeightsError) as caught:
        read_state_dict(tmp_path / "mine.pth", network)
    words = shlex.split(caught.value.remedy.partition("Python: ")[2])
    assert words[:2] == ["python", "-c"]
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    run = subprocess.run([sys.executable, *words[1:]], cwd=tmp_path, env=environment, capture_output=True, timeout=120)
    assert run.returncode == 0, run.stderr
    state, _ = read_state_dict(tmp_path / f"{network}.safetensors", network)
    assert torch.equal(state["features.0.bias"], torch.arange(3.0))
