"""Mutated files: the same from a seed, and whatever is neither read nor refused in one line is found."""

from __future__ import annotations

import io
import json
import struct
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hnf_blender.cli import main
from hnf_core.errors import FileError
from hnf_core.scene.splats.io_sog import ZIP_ERRORS
from hnf_lab.evaluation import fuzz


def test_every_reader_reads_or_refuses() -> None:
    tallies = fuzz.fuzz_readers(tuple(fuzz.READERS), 60, seed=5)
    assert [each.faults for each in tallies] == [[]] * len(fuzz.READERS)
    assert all(each.count == 60 for each in tallies)
    assert sum(each.read for each in tallies) > 60
    assert sum(each.refused for each in tallies) > 300


def test_a_seed_and_a_number_make_the_same_file() -> None:
    data = json.dumps({"a": [1, 2.5, {"b": "text"}], "c": None}).encode()
    first = [fuzz.make_mutation(data, "haptic", 3, number) for number in range(200)]
    assert first == [fuzz.make_mutation(data, "haptic", 3, number) for number in range(200)]
    assert first != [fuzz.make_mutation(data, "haptic", 4, number) for number in range(200)]
    assert len(set(first)) > 100
    assert len([each for each in first if each != data]) > 180


@pytest.mark.parametrize("data", [b"", b"x", b"{}", b"[1]", bytes(range(256)), b"\xff" * 10])
def test_any_data_is_mutated(data) -> None:
    for number in range(100):
        assert isinstance(fuzz.mutate(data, np.random.default_rng(number)), bytes)


def test_what_an_archive_holds_is_damaged_under_right_checksums() -> None:
    stream, files = io.BytesIO(), {"meta.json": b'{"a": [1, 2]}', "rows.bin": bytes(range(64))}
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    changed = set()
    for number in range(100):
        unpacked = unpack(fuzz.make_mutation(stream.getvalue(), "sog", 1, number))
        changed |= {name for name in files if name in unpacked and unpacked[name] != files[name]}
    assert changed == set(files)


def unpack(data: bytes) -> dict[str, bytes]:
    """The files of an archive whose checksums are right, none of a damaged one."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return {name: archive.read(name) for name in archive.namelist()}
    except (*ZIP_ERRORS, OSError):
        return {}


def test_the_document_of_a_glb_is_damaged_under_right_lengths() -> None:
    whole = fuzz._join_glb(b'{"asset": {"version": "2.0"}, "nodes": [{"mesh": 0}]}', b"rest")
    found = []
    for number in range(100):
        data = fuzz.make_mutation(whole, "glb", 1, number)
        if len(data) >= 20 and struct.unpack_from("<4sII", data) == (b"glTF", 2, len(data)) and data.endswith(b"rest"):
            (length,) = struct.unpack_from("<I", data, 12)
            found += [data[20 : 20 + length]] if length + 24 == len(data) else []
    assert len(set(found) - {whole[20:-4]}) > 25


REMEDY = "Export it again."


def slow(path: Path) -> None:
    time.sleep(5.0)


def raises(error: BaseException):
    def read(path: Path) -> None:
        if path.read_bytes() != b"whole":
            raise error

    return read


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("no"), "ValueError: no"),
        (MemoryError(), "MemoryError"),
        (FileError("is damaged (IndexError: list index out of range).", remedy=REMEDY), "no clear line"),
        (FileError("has no remedy."), "no clear line"),
        (FileError("has two\nlines.", remedy=REMEDY), "no clear line"),
        (FileError("is damaged.", remedy=REMEDY), ""),
    ],
)
def test_what_is_no_clear_refusal_is_a_fault(tmp_path, monkeypatch, error, said) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"whole")
    monkeypatch.setattr(fuzz, "READERS", {"mine": raises(error)})
    monkeypatch.setattr(fuzz, "make_sources", lambda folder: {"mine": path})
    monkeypatch.setattr(fuzz, "make_mutation", lambda *about: b"broken")
    (tally,) = fuzz.fuzz_readers(["mine"], 2, seed=0)
    assert tally.refused == (0 if said else 2)
    assert [fault.number for fault in tally.faults] == ([0, 1] if said else [])
    assert all(said in fault.what for fault in tally.faults)
    table = fuzz.format_tallies([tally], 0)
    assert ("2 × mine, first mutation 0 of seed 0" in table) == bool(said)


def test_a_hang_is_a_fault(tmp_path, monkeypatch) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"whole")
    monkeypatch.setattr(fuzz, "MAX_READ_S", 0.2)
    with fuzz._alarm():
        error, seconds = fuzz._time_read(slow, path)
    assert seconds < 3.0
    assert "took more than" in fuzz.describe_fault(error, seconds)


def test_the_command_names_its_kinds(capsys) -> None:
    assert main(["eval", "fuzz", "--count", "3", "--only", "wav", "haptic", "--json"]) == 0
    assert [each["kind"] for each in json.loads(capsys.readouterr().out)] == ["wav", "haptic"]
    assert main(["eval", "fuzz", "--only", "xyz"]) == 2
    assert "There are: wav" in capsys.readouterr().err


def test_scenes_are_opened_in_a_process_of_their_own() -> None:
    pytest.importorskip("bpy")
    (tally,) = fuzz.fuzz_scenes(["obj"], 4, seed=0)
    assert tally.count == 4
    assert not tally.faults


def test_a_file_on_which_blender_hangs_is_a_fault(monkeypatch) -> None:
    hanging = (
        "import faulthandler, time; print('hnf: ready', flush=True); "
        "faulthandler.dump_traceback_later(0.1, exit=True); time.sleep(30)"
    )
    monkeypatch.setattr(fuzz, "_CHILD", hanging)
    (tally,) = fuzz.fuzz_scenes(["obj"], 2, seed=0)
    assert [(fault.number, fault.what) for fault in tally.faults] == [
        (number, "it took more than 60 s in Blender") for number in range(2)
    ]


def test_collada_is_named_as_a_kind_of_older_versions(capsys) -> None:
    assert main(["eval", "fuzz", "--scenes", "--only", "xyz"]) == 2
    assert "blend, dae" in capsys.readouterr().err


def test_a_process_that_dies_costs_one_file(monkeypatch) -> None:
    dying = (
        "import os, sys, json; first, last = map(int, sys.argv[4:])\n"
        "print('hnf: ready', flush=True)\n"
        "for number in range(first, last):\n"
        "    if number == 2: os._exit(7)\n"
        "    print('hnf: answer ' + json.dumps([number, 'refused', 0.1]), flush=True)"
    )
    monkeypatch.setattr(fuzz, "_CHILD", dying)
    monkeypatch.setattr(fuzz, "SCENES_PER_PROCESS", 4)
    monkeypatch.setattr(fuzz, "touch_alone", lambda path: path.name)
    (tally,) = fuzz.fuzz_scenes(["obj"], 5, seed=0)
    assert tally.refused == 4
    assert [(fault.number, fault.what) for fault in tally.faults] == [(2, "ball.obj")]
    assert [note.what for note in tally.notes] == ["the process ended with 7; by itself: ball.obj"]
    monkeypatch.setattr(fuzz, "_CHILD", "raise SystemExit('no bpy')")
    with pytest.raises(FileError, match="no bpy"):
        fuzz.fuzz_scenes(["obj"], 5, seed=0)


@pytest.mark.parametrize(
    ("program", "outcome"),
    [
        ("print('plan')", "read"),
        ("print('plan'); sys.exit(1)", "read"),
        ("sys.exit(f'hnf: {path}: is damaged. Export it again.')", "refused"),
        ("print('note: slow', file=sys.stderr); sys.exit(f'hnf: {path}: is damaged. Export it again.')", "refused"),
        ("sys.exit(f'hnf: {path}: is damaged (IndexError). Export it again.')", "ended with 1"),
        ("sys.exit('hnf: is damaged. Export it again.')", "ended with 1"),
        ("os.kill(os.getpid(), 11)", "ended with -11"),
        ("time.sleep(60)", "took more than 0.5 s"),
    ],
)
def test_the_answer_of_the_command_is_judged(program: str, outcome: str, monkeypatch) -> None:
    monkeypatch.setattr(fuzz, "_TOUCH", f"import os, sys, time; path = sys.argv[2]; {program}")
    monkeypatch.setattr(fuzz, "MAX_COMMAND_S", 0.5 if "sleep" in program else 60.0)
    answer = fuzz.touch_alone(Path("ball.obj"))
    assert outcome == answer if outcome in ("read", "refused") else outcome in answer


def test_the_command_is_run_as_at_a_shell(tmp_path) -> None:
    pytest.importorskip("bpy")
    assert fuzz.touch_alone(tmp_path / "gone.obj") == "refused"
