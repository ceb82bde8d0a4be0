"""A scene as a job of a batch: the direct command's bytes, and made again where a picture changes."""

from __future__ import annotations

import os
from pathlib import Path

from outside_pictures import picture
from touch_scene import line_stroke, ridge_plate, save_scene, touch

from hnf_core.batch.attempt import RUN_NAME, attempt_order
from hnf_core.batch.inputs import digest, version
from hnf_core.batch.order import Order, State
from hnf_core.batch.record import holds, read_record


def test_a_touched_scene_is_the_direct_commands_and_its_pictures_are_inputs(tmp_path: Path) -> None:
    ridge_plate()
    line_stroke("Along")
    beside = tmp_path / "wood.png"
    picture(beside)
    os.utime(beside, (1e9, 1e9))
    scene, folder = save_scene(tmp_path / "cup.blend"), tmp_path / "out"
    folder.mkdir()
    (folder / RUN_NAME).write_text("run")
    order = Order(
        "cup", ("touch", scene.name), ".", {str(scene): digest(scene)}, str(tmp_path), str(folder), version(), "run"
    )
    outcome = attempt_order(order)
    assert outcome.state is State.DONE, outcome.why
    code, report = touch(scene, tmp_path / "direct")
    assert code == 0
    (stroke,) = report["strokes"]
    assert (folder / "cup" / stroke["wav"]).read_bytes() == (tmp_path / "direct" / stroke["wav"]).read_bytes()
    record = read_record(folder / "cup")
    assert record is not None
    assert list(record.found) == [str(beside)] == report["files"]
    assert holds(record, order.key, folder / "cup")
    beside.write_bytes(beside.read_bytes() + b"\0")
    assert not holds(record, order.key, folder / "cup")
    assert any((folder / "cup" / "cache").iterdir())  # what the next attempt begins with
