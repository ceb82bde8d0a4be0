"""What a run says at the end: where to look and listen, in words; the counts are for the report."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import bpy
import numpy as np
import pytest
from builders import add_plane, float_image
from touch_scene import PLATE, line_stroke, ridge_plate, save_scene, touch

from hnf_blender.cli import main
from hnf_blender.touch import output_files
from hnf_blender.touch.report import REPORT_NAME, WRITE_SHARE, Report, ReportWriter
from hnf_blender.touch.run import format_closing
from hnf_core.cli.commands import get_command_prefix
from hnf_core.export.wav import read_wav


def test_the_end_says_where_to_look_listen_and_go_on(tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", [".venv/bin/hnf", "touch"])
    ridge_plate()
    line_stroke("Along")
    line_stroke("Back", along=(-1.0, 0.0, 0.0))
    scene, out = save_scene(tmp_path / "scene.blend"), tmp_path / "out"
    capsys.readouterr()
    assert touch(scene, out)[0] == 0
    said = capsys.readouterr().out
    assert f"Done: 2 strokes in {out}. It took " in said
    for file in ("along.png", "scene_touched.blend", "report.json"):
        assert str(out / file) in said
        assert (out / file).is_file()
    for internal in ("rays", "network", "reliefs"):
        assert internal not in said
    # The line that it offers does what it says.
    listen = next(line for line in said.splitlines() if line.startswith("  Listen"))
    _, hnf, *words = shlex.split(listen)
    assert hnf == ".venv/bin/hnf"
    assert main(words) == 0
    heard = read_wav(out / "along-listen.wav")
    assert heard.sample_rate == 48_000
    assert np.abs(heard.samples).max() == pytest.approx(np.abs(read_wav(out / "along.wav").samples).max(), rel=0.05)
    capsys.readouterr()
    assert touch(scene, out)[0] == 0
    again = capsys.readouterr().out
    assert "Nothing had changed" in again
    assert not re.search(r"\b0 ", again)


def test_a_run_that_made_nothing_says_only_why(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    capsys.readouterr()
    assert touch(scene, tmp_path / "out", "--stroke", "rub-slow", "--on", f"{PLATE}:Glaze")[0] == 1
    told = capsys.readouterr()
    assert told.out == ""
    assert "it has no material slot 'Glaze'. Its slots: 0 Plate plastic." in told.err
    assert told.err.count("\n") == 1


def test_a_probe_is_one_place(tmp_path, capsys) -> None:
    ridge_plate()
    scene = save_scene(tmp_path / "scene.blend")
    assert touch(scene, tmp_path / "out", "--at", f"{PLATE}:0.01,0.02")[0] == 0
    said = capsys.readouterr().out
    assert f"Done: 1 place in {tmp_path / 'out'}. It took 2 rendered images." in said
    assert "Listen" not in said


def test_nothing_touched_needs_no_closing_words() -> None:
    assert format_closing(Report("x.blend", 1.0, "--scale"), Path("out")) == []


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (".venv/bin/hnf", [".venv/bin/hnf"]),
        ("/usr/bin/blender", ["/usr/bin/blender", "-b", "--command", "hnf"]),
        ("-c", ["hnf"]),
    ],
)
def test_lines_to_paste_begin_as_the_person_began(first, words) -> None:
    assert get_command_prefix([first, "touch"]) == words


@pytest.mark.parametrize("picture", ["grey", "none"])
def test_a_picture_does_not_deny_an_unread_relief(stroke_properties, tmp_path, monkeypatch, picture):
    plate = add_plane("Sheet", 0.05)
    material = bpy.data.materials.new("Sheet")
    material.use_nodes = True
    plate.data.materials.append(material)
    if picture == "grey":  # a height map in a Normal Map node
        tree = material.node_tree
        node, normal = tree.nodes.new("ShaderNodeTexImage"), tree.nodes.new("ShaderNodeNormalMap")
        node.image = float_image("grey", np.random.default_rng(1).uniform(0.2, 0.4, (64, 64, 1)).repeat(3, axis=2))
        tree.links.new(node.outputs[0], normal.inputs["Color"])
        tree.links.new(normal.outputs[0], tree.nodes["Principled BSDF"].inputs["Normal"])
    told = []
    monkeypatch.setattr(output_files, "write_stroke_figure", lambda path, *, facts, **_: told.append(facts))
    touch(save_scene(tmp_path / "sheet.blend"), tmp_path / "out")
    (facts,) = told
    denied = "no bump, normal or displacement in the shader" in facts["Height"]
    assert denied == (picture == "none")
    assert ("shows no relief that can be read" in facts["Height"]) == (picture == "grey")


def test_a_report_on_the_way_takes_a_small_share_of_time(tmp_path) -> None:
    now_s = 0.0

    def tell_time() -> float:  # each look at it takes 0.1 s, and so does each report
        nonlocal now_s
        now_s += 0.1
        return now_s

    report = Report("scene.blend", 1.0, "its unit scale")
    writer, written, looks = ReportWriter(report, tmp_path, tell_time), [], 1000
    for number in range(looks):
        report.warnings = [str(number)]
        writer.write()
        told = (tmp_path / REPORT_NAME).read_text(encoding="utf-8")
        if not written or written[-1] != told:
            written.append(told)
    assert '"0"' in written[0]  # the first at once
    assert 0.8 < 0.1 * len(written) / (WRITE_SHARE * now_s) <= 1.0 + 0.1 / (WRITE_SHARE * now_s)
