"""The report for whoever helps, and the cache's button."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy
import pytest
from touch_scene import place_data

import hnf_core
from hnf_blender.ops import diagnose_ops
from hnf_blender.registration import register_classes, unregister_classes
from hnf_blender.state.addon_settings import get_cache_folder
from hnf_blender.state.session_state import STATE, JobStatus, LastJob
from hnf_core import diagnostics
from hnf_core.field.weights import load_field
from hnf_core.kernel.loader import load_kernel, without_kernel


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place_data(monkeypatch, tmp_path)
    return get_cache_folder()


@pytest.fixture(autouse=True)
def operators(cache: Path):
    STATE.clear()
    STATE.diagnosis = ()
    register_classes(diagnose_ops.CLASSES)
    yield
    unregister_classes(diagnose_ops.CLASSES)
    STATE.clear()
    STATE.diagnosis = ()


def test_the_report_names_every_part_and_where_it_lies(cache: Path) -> None:
    (cache / "deep").mkdir()
    (cache / "deep" / "patch.npz").write_bytes(bytes(2500))
    assert bpy.ops.hnf.diagnose() == {"FINISHED"}
    rows = dict(STATE.diagnosis)
    assert rows["Blender"].startswith(f"{bpy.app.version[0]}.{bpy.app.version[1]}")
    assert (rows["numpy"], rows["Add-on"]) == (numpy.__version__, hnf_core.__version__)
    assert rows["Field"] == load_field().identity
    assert (rows["Cache folder"], rows["Cache size"]) == (str(cache), "2.5 kB")
    assert Path(rows["Add-on folder"]).joinpath("__init__.py").is_file()
    for package in ("OpenEXR", "embreex", "safetensors"):
        assert rows[package][0].isdigit()


def test_the_last_error_is_in_it() -> None:
    STATE.last_job = LastJob(False, "The bake stopped.", ("Killed",))
    bpy.ops.hnf.diagnose()
    text = diagnose_ops.format_rows(STATE.diagnosis)
    assert "failed: The bake stopped." in text
    assert "Killed" in text


def test_copied_is_what_is_shown() -> None:
    assert bpy.ops.hnf.diagnose_copy() == {"FINISHED"}
    assert STATE.diagnosis == diagnose_ops.collect_diagnosis()
    if not bpy.app.background:  # without a window there is no clipboard
        assert bpy.context.window_manager.clipboard == diagnose_ops.format_rows(STATE.diagnosis)


def test_lines_up() -> None:
    assert diagnose_ops.format_rows((("A", "1"), ("Long", "2"))) == "A     1\nLong  2\n"


def test_a_part_that_is_missing_is_said_not_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    assert diagnostics.get_version("no-such-package") == ""
    monkeypatch.setattr(diagnose_ops, "REPORTED_PACKAGES", ("no-such-package",))
    assert ("no-such-package", "not installed") in diagnose_ops.collect_diagnosis()


def test_whoever_does_the_kernels_work_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    told = diagnostics.describe_kernel()
    assert (told == "at work") == (load_kernel() is not None)
    with without_kernel():
        assert diagnostics.describe_kernel().startswith("using slower numpy version")
    assert ("Compiled kernel", told) in diagnose_ops.collect_diagnosis()


def test_clearing_the_cache_deletes_its_files_and_nothing_else(cache: Path) -> None:
    (cache / "deep").mkdir()
    (cache / "deep" / "patch.npz").write_bytes(bytes(10))
    beside = cache.parent / f"{cache.name}-beside"
    beside.write_bytes(b"kept")
    assert bpy.ops.hnf.cache_clear() == {"FINISHED"}
    assert [path for path in cache.rglob("*") if path.is_file()] == []
    assert beside.read_bytes() == b"kept"
    beside.unlink()


def test_a_bake_keeps_its_cache(cache: Path) -> None:
    (cache / "patch.npz").write_bytes(bytes(10))
    STATE.job = JobStatus("Close-ups", 1, 2, 0.0, None)
    with pytest.raises(RuntimeError, match="bake is running"):
        bpy.ops.hnf.cache_clear()
    assert (cache / "patch.npz").is_file()


def test_another_file_is_not_described_by_the_last_ones_figures() -> None:
    bpy.ops.hnf.diagnose()
    STATE.clear()
    assert STATE.diagnosis == ()


def test_figures_are_collected_again_only_where_they_are_shown(cache: Path) -> None:
    diagnose_ops.refresh_diagnosis()
    assert STATE.diagnosis == ()
    bpy.ops.hnf.diagnose()
    (cache / "patch.npz").write_bytes(bytes(2500))
    diagnose_ops.refresh_diagnosis()
    assert dict(STATE.diagnosis)["Cache size"] == "2.5 kB"


def test_a_cache_file_in_use_is_left_and_not_counted(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, size in (("held.npz", 3000), ("free.npz", 2000)):
        (cache / name).write_bytes(bytes(size))
    unlink = Path.unlink

    def refusing(path: Path, missing_ok: bool = False) -> None:
        if path.name == "held.npz":
            raise PermissionError("in use")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refusing)
    assert bpy.ops.hnf.cache_clear() == {"FINISHED"}
    assert [path.name for path in cache.iterdir()] == ["held.npz"]
