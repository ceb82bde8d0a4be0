"""`import hnf_core as hnf`: what it loads, that every name is documented and runs, and that bad input is refused."""

from __future__ import annotations

import doctest
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hnf_core as hnf
from hnf_core import api, metrics

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples"
WITH_TORCH = {"own_recordings.py", "train_a_field.ipynb"}
SIGNAL = hnf.synthesise("cork", "left-right-soft").signal
CALLABLES = [name for name in hnf.__all__ if callable(getattr(hnf, name)) and name not in ("HnfError", "Signal")]


def run(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True, timeout=280
    )


def test_importing_loads_nothing_and_using_it_nothing_heavy(tmp_path: Path) -> None:
    code = (
        "import sys, hnf_core as hnf\n"
        "first = sorted({'numpy', 'torch', 'scipy', 'bpy'} & set(sys.modules))\n"
        "hnf.write_wav('x.wav', hnf.synthesise('cork', 'rub-slow').signal)\n"
        "print(first, sorted({'torch', 'scipy', 'bpy', 'matplotlib'} & set(sys.modules)))"
    )
    done = run("-c", code, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[] []"


def test_a_name_that_is_not_there_is_refused() -> None:
    with pytest.raises(AttributeError, match="no attribute 'syntesise'"):
        _ = hnf.syntesise
    assert set(dir(hnf)) >= set(hnf.__all__)


@pytest.mark.parametrize("name", CALLABLES)
def test_every_name_has_a_full_docstring(name: str) -> None:
    """A first line that stands alone, every parameter, and an example."""
    text = inspect.getdoc(getattr(hnf, name)) or ""
    first = text.split("\n")[0]
    assert first.endswith(".")
    if name != "OutputStream":
        assert "Examples\n--------" in text
    if inspect.isfunction(getattr(hnf, name)) and name not in ("load_field", "save_field"):
        parameters = list(inspect.signature(getattr(hnf, name)).parameters)
        assert [each for each in parameters if not re.search(rf"^{each}\b.* : ", text, re.MULTILINE)] == []


@pytest.mark.parametrize("module", [api, metrics])
def test_the_examples_in_docstrings_run(module, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    failed, attempted = doctest.testmod(module)
    assert attempted > 10
    assert failed == 0


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_an_example_runs(path: Path, tmp_path: Path) -> None:
    if path.name in WITH_TORCH:
        pytest.importorskip("torch", reason="the example trains")
    if path.name == "touch_scene.py":
        pytest.skip("needs Blender: tests/blender/test_example_scene.py runs it")
    done = run(str(path), *([str(tmp_path)] if "[FOLDER]" in path.read_text("utf-8") else []), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.ipynb")), ids=lambda path: path.name)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="the notebook plots")
    if path.name in WITH_TORCH:
        pytest.importorskip("torch", reason="the notebook trains")
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert all(not cell.get("outputs") for cell in cells)
    (tmp_path / "notebook.py").write_text(code, encoding="utf-8")
    done = run("notebook.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr


NOISE = np.random.default_rng(0).normal(size=10_000)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda path: hnf.write_wav(path, [1.0, 2.0]), "rate"),
        (lambda path: hnf.write_wav(path, [[1.0, 2.0]], 10_000), r"shape \(1, 2\)"),
        (lambda path: hnf.write_wav(path, [1.0, 2.0], 10), "kHz"),
        (lambda path: hnf.write_wav(path, ["loud"], 10_000), "not made of numbers"),
        (lambda path: hnf.write_wav(path, SIGNAL, 8000), "10000 Hz, not 8000 Hz"),
        (lambda path: hnf.synthesise("oakwod", "rub-slow"), "oak-wood"),
        (lambda path: hnf.synthesise(3, "rub-slow"), "no material"),
        (lambda path: hnf.synthesise("cork", 3), "no action"),
        (lambda path: hnf.synthesise("cork", "rub-slow", probe="nose"), "no probe"),
        (lambda path: hnf.synthesise("cork", "rub-slow", seed=-1), "seed -1"),
        (lambda path: hnf.synthesise("cork", "rub-slow", seed=1.5), "seed 1.5"),
        (lambda path: hnf.synthesise("cork", "rub-slow", rate_hz="10"), "no sample rate"),
        (lambda path: hnf.material(3), "no name"),
        (lambda path: hnf.Action([0.0, 1.0], 0.0, 0.1, "hard"), "not made of numbers"),
        (lambda path: hnf.Recording("abc", 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)), "not made of numbers"),
        (lambda path: hnf.Recording(np.zeros((0, 3)), 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)), "neither"),
        (lambda path: hnf.train([None]), "recordings"),
        (lambda path: hnf.Action([0.0, 1.0], 0.0, [0.1, 0.1, 0.1], 1.0), "shapes"),
        (lambda path: hnf.Action([0.0, 1.0], 0.0, -0.1, 1.0), "negative"),
        (lambda path: hnf.Action([1.0, 0.0], 0.0, 0.1, 1.0), "does not rise"),
        (lambda path: hnf.Recording(np.zeros((9, 2)), 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)), "neither"),
        (lambda path: hnf.Recording(np.zeros(9), 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)), "action"),
        (lambda path: hnf.Recording([np.nan] * 9, 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)), "not finite"),
        (lambda path: hnf.train([]), "recordings"),
        (lambda path: hnf.open_stream("moon"), "moon"),
        (lambda path: hnf.load_material("nowhere.hnf"), "nowhere.hnf"),
        (lambda path: hnf.read_signal("nowhere.wav"), "nowhere.wav"),
        (lambda path: hnf.export(path.with_suffix(".xyz"), SIGNAL), "xyz"),
        (lambda path: hnf.export(path.with_suffix(".haps"), SIGNAL), "'.haps' cannot be written"),
        (lambda path: hnf.metrics.welch([1.0, 2.0]), "rate"),
        (lambda path: hnf.metrics.welch([1.0, 2.0], 10_000), "less than one window"),
        (lambda path: hnf.metrics.st_sim(SIGNAL.samples, SIGNAL, 8000), "not 8000 Hz"),
        (lambda path: hnf.metrics.st_sim(SIGNAL, SIGNAL.samples, 8000), "not 8000 Hz"),
        (lambda path: hnf.metrics.st_sim(SIGNAL, hnf.Signal(SIGNAL.samples, 8000.0, 0)), "two rates"),
        (lambda path: hnf.metrics.welch(SIGNAL, 2000), "not 2000 Hz"),
        (lambda path: hnf.metrics.welch(np.ones(10_000), 10), "kHz"),
        (lambda path: hnf.metrics.welch(np.ones(10_000), "10000"), "no sample rate"),
        (lambda path: hnf.metrics.welch(np.full(10_000, np.nan), 10_000), "not finite"),
        (lambda path: hnf.metrics.spqi(np.ones(500), np.ones(500), 10_000), "less than one block"),
        (lambda path: hnf.metrics.st_sim(np.ones(500), np.ones(500), 10_000), "less than one block"),
        (lambda path: hnf.metrics.average_spectrum_distance(NOISE, np.zeros(10_000), 10_000), "silent"),
    ],
)  # fmt: skip
def test_bad_input_is_refused_in_words(call, words: str, tmp_path: Path) -> None:
    with pytest.raises(hnf.HnfError, match=words):
        call(tmp_path / "x.wav")
    assert list(tmp_path.iterdir()) == []


def test_lists_and_arrays_give_the_same(tmp_path: Path) -> None:
    hnf.write_wav(tmp_path / "list.wav", [0.0, 1.0, -1.0], 1000)
    hnf.write_wav(str(tmp_path / "array.wav"), np.array([0.0, 1.0, -1.0], np.float32), rate_hz=1000.0)
    assert (tmp_path / "list.wav").read_bytes() == (tmp_path / "array.wav").read_bytes()
    assert hnf.read_signal(tmp_path / "list.wav").samples.tolist() == [0.0, 1.0, -1.0]


def test_three_axes_are_fused_with_their_power() -> None:
    rng = np.random.default_rng(0)
    axes = rng.normal(size=(10_000, 3))
    axes -= axes.mean(axis=0)
    recording = hnf.Recording(axes, 10_000, hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0))
    assert np.sum(np.square(recording.acceleration)) == pytest.approx(np.sum(np.square(axes)))


def test_the_mean_of_one_axis_is_no_vibration() -> None:
    action = hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0)
    plain, tilted = (hnf.Recording(NOISE + offset, 10_000, action).acceleration for offset in (0.0, 9.81))
    np.testing.assert_allclose(tilted, plain, atol=1e-12)


def test_a_doubtful_action_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="in degrees"):
        hnf.Action([0.0, 1.0, 2.0], [0.0, 45.0, 90.0], 0.1, 1.0)
    with pytest.warns(UserWarning, match="in mm/s"):
        hnf.Action([0.0, 1.0], 0.0, 80.0, 1.0)
    with pytest.warns(UserWarning, match="position_m moves by 5 m, and speed_m_s comes to 0.1 m"):
        hnf.Action([0.0, 1.0], 0.0, 0.1, 1.0, position_m=[0.0, 5.0])


def test_it_is_what_the_command_line_gives(tmp_path: Path) -> None:
    from hnf_blender.cli import main

    words = ["synth", "--material", "cork", "--stroke", "rub-slow", "--seed", "3"]
    assert main([*words, "--out", str(tmp_path / "cli.wav")]) == 0
    hnf.write_wav(tmp_path / "api.wav", hnf.synthesise("cork", "rub-slow", seed=3).signal)
    assert (tmp_path / "api.wav").read_bytes() == (tmp_path / "cli.wav").read_bytes()


def test_a_table_keeps_its_short_tap_and_its_way_back(tmp_path: Path) -> None:
    from hnf_blender.cli import main

    time = np.arange(1001) / 1000.0
    tap = np.where(np.abs(time - 0.5) < 1.6e-3, 2.0, 0.0)
    way = 0.01 * np.sin(4.0 * np.pi * time)
    speed, angle = np.abs(np.gradient(way, time)), np.where(np.gradient(way) < 0.0, np.pi, 0.0)
    for name, force in (("tap", tap), ("rub", np.ones(1001))):
        table = tmp_path / f"{name}.csv"
        rows = zip(time, angle, speed, force, way, strict=True)
        lines = [",".join(repr(float(value)) for value in row) for row in rows]
        table.write_text("time_s,direction_rad,speed_m_s,force_n,position_m\n" + "\n".join(lines), encoding="utf-8")
        words = ["synth", "--material", "cork", "--action", str(table), "--out", str(tmp_path / f"{name}.wav")]
        assert main(words) == 0
        ours = hnf.synthesise("cork", hnf.read_action(table)).signal
        assert ours.samples.tolist() == hnf.read_signal(tmp_path / f"{name}.wav").samples.tolist()
        given = hnf.synthesise("cork", hnf.Action(time, angle, speed, force, position_m=way)).signal
        assert given.samples.tolist() == ours.samples.tolist()


def test_a_table_in_degrees_is_warned_of(tmp_path: Path) -> None:
    table = tmp_path / "degrees.csv"
    table.write_text("time_s,direction_rad,speed_m_s,force_n\n0,90,0.1,1\n1,180,0.1,1\n", encoding="utf-8")
    with pytest.warns(UserWarning, match=r"degrees\.csv: .*in degrees"):
        hnf.read_action(table)


@pytest.mark.parametrize(("code", "is_written"), [(1, True), (1, False)])
def test_a_report_is_given_back_if_there_is_one(code, is_written, tmp_path: Path, monkeypatch) -> None:
    import hnf_blender.cli

    report = tmp_path / "report.json"
    report.write_text('{"failed": []}', encoding="utf-8")

    def touch(arguments: list[str]) -> int:
        if is_written:
            (tmp_path / "new.json").write_text('{"failed": ["A"]}', encoding="utf-8")
            (tmp_path / "new.json").replace(report)
        return code

    monkeypatch.setattr(hnf_blender.cli, "main", touch)
    if is_written:
        assert hnf.touch("scene.blend", tmp_path) == {"failed": ["A"]}
    else:
        with pytest.raises(hnf.HnfError, match="could not be touched"):
            hnf.touch("scene.blend", tmp_path)
