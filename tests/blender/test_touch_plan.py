"""What --plan says, and that it is true of the run; that it writes nothing."""

from __future__ import annotations

import pytest
from touch_scene import PLATE, ridge_plate, save_scene

from hnf_blender.cli import main


@pytest.mark.parametrize(
    "words",
    [
        ("--material", f"{PLATE}=oak-wood"),
        ("--stroke", "rub-slow", "--on", PLATE),
        ("--probe", f"{PLATE}:0.01,0.02"),
        ("--stroke", "rub-slow", "--on", "nobody"),
    ],
    ids=lambda words: words[0] + words[-1][:4],
)
def test_a_plan_needs_no_folder_and_leaves_none(tmp_path, capsys, words) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    code = main(["touch", str(scene), "--plan", *words])
    without = capsys.readouterr()
    assert code == main(["touch", str(scene), "--out", str(tmp_path / "out"), "--plan", *words])
    assert capsys.readouterr() == without
    assert ("nobody" in without.out + without.err) == (code == 1) == ("nobody" in words)
    assert list(tmp_path.iterdir()) == [scene]
