"""A scene as a batch job: the bytes of the direct command, and a new run after an image changes."""

from __future__ import annotations

import os
from pathlib import Path

from outside_pictures import picture
from touch_scene import line_stroke, ridge_plate, save_scene, touch

from hnf_core.batch.attempt import RUN_FILE_NAME, Request, State, run_request
from hnf_core.batch.staging import compute_digest, compute_version, is_fresh, read_record


def test_a_batch_job_equals_the_command_and_tracks_its_images(tmp_path: Path) -> None:
    ridge_plate()
    line_stroke("Along")
    beside = tmp_path / "wood.png"
    picture(beside)
    os.utime(beside, (1e9, 1e9))
    scene, folder = save_scene(tmp_path / "cup.blend"), tmp_path / "out"
    folder.mkdir()
    (folder / RUN_FILE_NAME).write_text("run")
    order = Request(
        "cup",
        ("touch", scene.name),
        ".",
        {str(scene): compute_digest(scene)},
        str(tmp_path),
        str(folder),
        compute_version(),
        "run",
    )
    outcome = run_request(order)
    assert outcome.state is State.DONE, outcome.why
    code, report = touch(scene, tmp_path / "direct")
    assert code == 0
    (stroke,) = report["strokes"]
    assert (folder / "cup" / stroke["wav"]).read_bytes() == (tmp_path / "direct" / stroke["wav"]).read_bytes()
    record = read_record(folder / "cup")
    assert record is not None
    assert list(record.found) == [str(beside)] == report["files"]
    assert is_fresh(record, order.key, folder / "cup")
    beside.write_bytes(beside.read_bytes() + b"\0")
    assert not is_fresh(record, order.key, folder / "cup")
    assert any((folder / "cup" / "cache").iterdir())  # what the next attempt begins with
