"""The table of conversions between haptic formats: what is known to be kept, and what is known to be lost."""

from __future__ import annotations

import json
import shutil

import pytest

from hnf_blender.cli import main
from hnf_core.errors import FileError
from hnf_core.export.formats import FORMATS
from hnf_lab.evaluation.formats import WORDS, find_clips, format_matrix, make_clips, measure_formats

HOLD_CLICKS = ("haptic", "ahap", "hjif")


@pytest.fixture(scope="module")
def cells(tmp_path_factory):
    return {
        (cell.source, cell.target): cell
        for cell in measure_formats(make_clips(tmp_path_factory.mktemp("clips"), 6, seed=3))
    }


def test_formats_with_clicks_keep_what_the_promise_says(cells) -> None:
    for source in HOLD_CLICKS:
        for target in HOLD_CLICKS:
            cell = cells[source, target]
            assert cell.clips == 6
            assert cell.clicks_out == cell.clicks_in > 0
            assert cell.duration_ms < 1.0
            assert cell.level_db < 0.5


def test_what_a_format_has_no_clicks_for_is_counted(cells) -> None:
    assert cells["haptic", "android"].clicks_in > 0
    assert cells["haptic", "android"].clicks_out == 0
    assert cells["android", "haptic"].clicks_in == 0
    assert not any(cell.refused for cell in cells.values())


def test_the_same_seed_makes_the_same_clips(tmp_path) -> None:
    first, again, other = (
        [path.read_bytes() for path in make_clips(tmp_path / name, 3, seed)]
        for name, seed in (("a", 1), ("b", 1), ("c", 2))
    )
    assert first == again != other


def test_a_clip_that_is_refused_is_named(tmp_path) -> None:
    clips = make_clips(tmp_path, 2, seed=0)
    clips[1].write_text("{}")
    cells = measure_formats(clips, ("haptic", "ahap"))
    assert all(cell.clips == 1 and clips[1].name in cell.refused[0] for cell in cells)
    assert "Refused:" in format_matrix(cells)


def test_the_command_prints_a_table_of_all_formats(tmp_path, capsys) -> None:
    assert set(WORDS) == {word for word, form in FORMATS.items() if form.load}
    assert main(["eval", "formats", "--clips", "1"]) == 0
    table = capsys.readouterr().out
    assert table.count("\n|") == len(WORDS) + 1
    make_clips(tmp_path / "mine" / "deeper", 1, seed=5)
    shutil.copy(tmp_path / "mine" / "deeper" / "clip-000.haptic", tmp_path / "mine" / "CLIP.HAPTIC")
    assert len(find_clips(tmp_path / "mine")) == 2
    assert main(["eval", "formats", str(tmp_path / "mine"), "--json"]) == 0
    assert {cell["clips"] for cell in json.loads(capsys.readouterr().out)} == {2}
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="holds no haptic file"):
        find_clips(tmp_path / "empty")
