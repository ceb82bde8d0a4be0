"""Trunks that users bring: torchvision's AlexNet, read as data and checked."""

import hashlib

import pytest
from alexnet_parts import HIDDEN, random_tensors, trunk_names

from hnf_core.errors import FileError, WeightsError
from hnf_core.material.alexnet.network import Design

torch = pytest.importorskip("torch", reason="torch reads torch's own files")
from hnf_core.training.encoder.trunk_file import load_trunk  # noqa: E402


def torchvision_state(seed: int = 5) -> dict:
    """What torchvision.models.alexnet().state_dict() holds, with a small classifier in place of the large one."""
    tensors = random_tensors(Design(hidden=HIDDEN), seed)
    state = {name: torch.tensor(tensors[name]) for name in trunk_names()}
    return {**state, "classifier.1.weight": torch.zeros(4, 4), "classifier.1.bias": torch.zeros(4)}


def write(path, state):
    if path.suffix == ".safetensors":
        from safetensors.torch import save_file

        save_file(state, path)
    else:
        torch.save(state, path)
    return path


@pytest.mark.parametrize("name", ["alexnet.pth", "alexnet.safetensors"])
def test_a_trunk_in_torchvisions_form_is_read(tmp_path, name):
    state = torchvision_state()
    path = write(tmp_path / name, state)
    trunk, digest = load_trunk(path)
    assert digest == hashlib.sha256(path.read_bytes()).hexdigest()
    assert list(trunk) == trunk_names()
    assert all(torch.equal(trunk[each], state[each]) for each in trunk)


def test_what_is_no_trunk_is_refused_in_words(tmp_path):
    state = torchvision_state()
    without = {name: value for name, value in state.items() if name != "features.6.bias"}
    with pytest.raises(WeightsError, match=r"missing \['features.6.bias'\]"):
        load_trunk(write(tmp_path / "a.pth", without))
    with pytest.raises(WeightsError, match=r"unknown \['layer1"):
        load_trunk(write(tmp_path / "b.safetensors", {**state, "layer1.0.conv1.weight": torch.zeros(2)}))
    with pytest.raises(WeightsError, match=r"features.0.weight is \(96, 3, 11, 11\)"):
        load_trunk(write(tmp_path / "c.pth", {**state, "features.0.weight": torch.zeros(96, 3, 11, 11)}))
    with pytest.raises(WeightsError, match="not finite"):
        load_trunk(write(tmp_path / "d.pth", {**state, "features.0.bias": torch.full((64,), float("nan"))}))
    with pytest.raises(WeightsError, match="state dict"):
        load_trunk(write(tmp_path / "e.pth", [torch.zeros(1)]))
    (tmp_path / "f.pth").write_bytes(b"not weights at all")
    (tmp_path / "f.safetensors").write_bytes(b"not weights at all")
    for name in ("f.pth", "f.safetensors"):
        with pytest.raises(WeightsError, match="not a file of weights"):
            load_trunk(tmp_path / name)
    with pytest.raises(FileError, match="cannot read"):
        load_trunk(tmp_path / "absent.pth")


class WritesWhenRead:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def test_a_file_that_would_run_a_program_is_refused(tmp_path):
    written = tmp_path / "written"
    state = {**torchvision_state(), "features.0.bias": WritesWhenRead(written)}
    with pytest.raises(WeightsError, match="not a file of weights"):
        load_trunk(write(tmp_path / "evil.pth", state))
    assert not written.exists()
