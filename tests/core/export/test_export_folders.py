"""An export overwrites only its own files and writes a sidecar for each."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from export_signals import OPTIONS, WORDS, texture, tone
from test_export_cli import hnf
from touched_surfaces import rough_tone, touched_sheet

from hnf_core.errors import FileError
from hnf_core.export.convert import export_signal
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ExportOptions
from hnf_core.export.provenance import get_sidecar_path
from hnf_core.export.wav import write_wav


def contents(folder: Path) -> dict[str, Any]:
    return {name: None if (folder / name).is_dir() else (folder / name).read_bytes() for name in os.listdir(folder)}


def refused(why: str, path: Path, word: str, options: ExportOptions = OPTIONS) -> None:
    """Nothing is written, replaced or left behind."""
    before = contents(path.parent)
    with pytest.raises(FileError, match=why) as caught:
        export_signal(rough_tone(), FORMATS[word], path, options)
    assert caught.value.remedy
    assert contents(path.parent) == before


def test_a_note_does_not_replace_what_was_exported(tmp_path: Path) -> None:
    export_signal(tone(), FORMATS["android"], tmp_path / "x.wav.json", OPTIONS)
    refused(r"x\.wav\.json: here goes the note", tmp_path / "x.wav", "wav")


def test_an_export_does_not_replace_a_note(tmp_path: Path) -> None:
    export_signal(tone(), FORMATS["wav"], tmp_path / "x.wav", OPTIONS)
    refused(r"x\.wav\.json: it is the note of x\.wav", tmp_path / "x.wav.json", "android")


@pytest.mark.parametrize("word", WORDS)
@pytest.mark.parametrize("there", ["{}", "no JSON", '{"schema": 1, "file": "x", "hash": 3}', "[1]"])
def test_a_stranger_in_the_place_of_the_note_stays(tmp_path: Path, word: str, there: str) -> None:
    path = tmp_path / f"x{FORMATS[word].suffix}"
    get_sidecar_path(path).write_text(there, "utf-8")
    refused("here goes the note", path, word)


@pytest.mark.parametrize("word", WORDS)
def test_a_folder_in_the_place_of_the_note_or_the_file_is_named(tmp_path: Path, word: str) -> None:
    path = tmp_path / f"x{FORMATS[word].suffix}"
    get_sidecar_path(path).mkdir()
    refused(f"{get_sidecar_path(path).name}: is a folder", path, word)
    get_sidecar_path(path).rmdir()
    path.mkdir()
    refused(f"{path.name}: is a folder", path, word)


def test_a_file_whose_note_fails_is_said_to_be_written(tmp_path: Path) -> None:
    """A name that a file system still takes, and no longer with the note's ending."""
    path = tmp_path / f"{'x' * 236}.haptic"
    with pytest.raises(FileError, match="the file is written, and its note is not") as caught:
        export_signal(tone(), FORMATS["haptic"], path, OPTIONS)
    assert caught.value.where == str(path)
    assert "unharmed" not in str(caught.value)
    assert os.listdir(tmp_path) == [path.name]


def test_a_folder_is_not_called_a_full_disk(tmp_path: Path) -> None:
    (tmp_path / "x.wav").mkdir()
    with pytest.raises(FileError, match="is a folder") as caught:
        write_wav(tmp_path / "x.wav", tone())
    assert "disk" not in str(caught.value)
    assert os.listdir(tmp_path) == ["x.wav"]


@pytest.mark.parametrize("word", WORDS)
def test_an_earlier_export_is_replaced_with_its_note(tmp_path: Path, word: str) -> None:
    path = tmp_path / f"x{FORMATS[word].suffix}"
    export_signal(texture(0.2), FORMATS[word], path, OPTIONS)
    first = contents(tmp_path)
    export_signal(tone(), FORMATS[word], path, OPTIONS)
    second = contents(tmp_path)
    assert first.keys() == second.keys()
    assert all(first[name] != second[name] for name in first)


def test_a_texture_mesh_replaces_only_its_own_earlier_mesh(tmp_path: Path) -> None:
    path, options = tmp_path / "x.hjif", ExportOptions(surface=touched_sheet())
    mesh = tmp_path / "x.hjif.glb"
    mesh.write_bytes(b"a stranger")
    refused(r"x\.hjif\.glb: here goes the mesh of x\.hjif", path, "hjif", options)
    mesh.unlink()
    for _ in range(2):
        export_signal(rough_tone(), FORMATS["hjif"], path, options)
    refused(r"x\.hjif\.glb: it is the mesh of x\.hjif", mesh, "glb", options)


def test_a_glb_of_its_own_is_no_mesh_of_a_texture(tmp_path: Path) -> None:
    path, options = tmp_path / "x.hjif", ExportOptions(surface=touched_sheet())
    export_signal(rough_tone(), FORMATS["glb"], tmp_path / "x.hjif.glb", options)
    refused(r"x\.hjif\.glb: here goes the mesh of x\.hjif", path, "hjif", options)
    export_signal(tone(), FORMATS["hjif"], path, OPTIONS)
    refused(r"x\.hjif\.glb: here goes the mesh of x\.hjif", path, "hjif", options)


def test_the_command_line_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_wav(tmp_path / "in.wav", texture(0.2))
    words = ("export", tmp_path / "in.wav", "--format")
    assert hnf(*words, "android", "--out", tmp_path / "z.wav.json") == 0
    assert hnf(*words, "wav", "--out", tmp_path / "z.wav") == 1
    assert "Give another name, or move z.wav.json away." in capsys.readouterr().err
