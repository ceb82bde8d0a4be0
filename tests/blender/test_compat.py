"""Differences between Blender versions, as handled by compat."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import threading
import time
import warnings
from pathlib import Path

import bpy
import pytest
from builders import add_plane

from hnf_blender import compat


def test_f_curves_are_those_of_the_datablock_itself():
    plane = add_plane()
    assert compat.fcurves_of(plane) == []
    camera = bpy.data.cameras.new("Camera")
    holder = bpy.data.objects.new("Holder", camera)
    holder.keyframe_insert("location", frame=1)
    camera.keyframe_insert("lens", frame=1)  # from 4.4 on in the same action, in another slot
    assert sorted({curve.data_path for curve in compat.fcurves_of(holder)}) == ["location"]
    assert len(compat.fcurves_of(holder)) == 3
    assert [curve.data_path for curve in compat.fcurves_of(camera)] == ["lens"]


def test_only_an_unusual_working_space_has_a_name():
    assert compat.working_space() == ""
    if compat.version() >= (5, 0, 0):
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.2020", convert_colors=False)
        assert compat.working_space() == "Linear Rec.2020"
        bpy.ops.wm.set_working_color_space(working_space="Linear Rec.709", convert_colors=False)
    assert compat.working_space() == ""


def test_a_format_has_its_name_here():
    render = bpy.context.scene.render
    compat.use_multilayer_exr(render)
    assert render.image_settings.file_format == "OPEN_EXR_MULTILAYER"


@pytest.mark.parametrize("kind", ["materials", "worlds"])
def test_nodes_can_be_switched_on(kind):
    block = getattr(bpy.data, kind).new("x")
    compat.switch_nodes_on(block)
    assert compat.use_nodes(block)
    assert len(block.node_tree.nodes) > 0


def test_nobody_else_asks_whether_a_material_has_nodes():
    """use_nodes is always on from 5.0, and asking for it is deprecated."""
    asking = [
        path.name
        for path in Path(compat.__file__).parent.rglob("*.py")
        if path.name != "compat.py" and re.search(r"material\.use_nodes", path.read_text(encoding="utf-8"))
    ]
    assert asking == []


def test_a_relative_export_folder_gives_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bpy.context.scene.hnf.export_folder = "//elsewhere"
    assert bpy.context.scene.hnf.export_folder == "//elsewhere"


BESIDE_A_THREAD = """
import threading
import bpy
import numpy as np
from hnf_blender import compat

is_ended = False


def work():
    while not is_ended:
        with compat.WORK_LOCK:
            values = np.arange(100_000.0) + 1.0
            [str(index) for index in range(200)]


thread = threading.Thread(target=work)
thread.start()
for count in range(500):
    with compat.override_context(window=bpy.context.window_manager.windows[0]):
        bpy.ops.ed.undo_push(message=str(count))
is_ended = True
thread.join()
print("ended")
"""


def test_an_override_survives_a_thread_at_work():
    """Without the lock Blender 5.0 crashes within some hundred calls."""
    command = [sys.executable, "-c", BESIDE_A_THREAD]
    ended = subprocess.run(command, cwd=Path(compat.__file__).parents[1], capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout.splitlines()[-1:]) == (0, ["ended"]), ended.stderr


def find_unlocked_operators(text: str) -> list[int]:
    """Return the lines of operators that are called under Blender's own override."""
    overrides = [
        node
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.With) and any("temp_override" in ast.unparse(item) for item in node.items)
    ]
    calls = [node for override in overrides for node in ast.walk(override) if isinstance(node, ast.Call)]
    return sorted({call.lineno for call in calls if "bpy.ops." in ast.unparse(call.func)})


def test_every_operator_under_an_override_has_the_lock():
    breach = "with bpy.context.temp_override(window=window):\n    bpy.ops.ed.undo()\n"
    assert find_unlocked_operators(breach) == [2]
    assert find_unlocked_operators(breach.replace("bpy.context.temp_", "compat.").replace("(w", "_context(w")) == []
    package = Path(compat.__file__).parent
    found = {path.name: find_unlocked_operators(path.read_text(encoding="utf-8")) for path in package.rglob("*.py")}
    assert {name: lines for name, lines in found.items() if lines} == {}


THREADS_THAT_WAIT = {
    "jobs/child_job.py": "reads the output of a process, or waits for its end",
    "actuator/player_process.py": "reads and writes the pipes of a process, or waits for its end",
    "ops/learn_ops.py": "waits for the external Python, a process",
    "supervisor.py": "waits for signals, beside a command that is a process",
}
"""Module → what its threads do instead of computing."""


def is_thread(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func) in {"Thread", "threading.Thread"}


def find_unlocked_threads(text: str) -> list[int]:
    """Return the lines where threads are started in a module that never takes the lock."""
    tree = ast.parse(text)
    locked = any(
        isinstance(node, ast.With) and any("WORK_LOCK" in ast.unparse(item) for item in node.items)
        for node in ast.walk(tree)
    )
    return [] if locked else [node.lineno for node in ast.walk(tree) if is_thread(node)]


def test_every_thread_takes_the_lock_or_only_waits():
    breach = "thread = threading.Thread(target=work)\nthread.start()\n"
    assert find_unlocked_threads(breach) == [1]
    assert find_unlocked_threads("with compat.WORK_LOCK:\n    work()\n" + breach) == []
    package = Path(compat.__file__).parent
    found = {
        path.relative_to(package).as_posix(): find_unlocked_threads(path.read_text(encoding="utf-8"))
        for path in package.rglob("*.py")
    }
    assert sorted(name for name, lines in found.items() if lines) == sorted(THREADS_THAT_WAIT)


class WorkLog:
    """Threads that take a lock, and the order in which they got it."""

    def __init__(self, lock: compat.WorkLock) -> None:
        self.lock, self.order = lock, []
        self._threads = []

    def start(self, name: str, waiting: str) -> None:
        """Start a thread that notes its `name`, once it waits among the lock's threads or operators."""
        held = self.lock if waiting == "_threads" else self.lock.lock_for_operator()
        queue = getattr(self.lock, waiting)
        count = len(queue)

        def work() -> None:
            with held:
                self.order.append(name)

        self._threads.append(threading.Thread(target=work))
        self._threads[-1].start()
        while len(queue) == count:
            time.sleep(0.001)

    def join(self) -> list[str]:
        for thread in self._threads:
            thread.join()
        return self.order


def test_an_operator_goes_before_the_threads_that_wait():
    log = WorkLog(compat.WorkLock())
    with log.lock:
        log.start("first", "_threads")
        log.start("second", "_threads")
        assert not log.lock.is_wanted
        log.start("operator", "_operators")
        assert log.lock.is_wanted
    assert log.join() == ["operator", "first", "second"]
    assert not log.lock.is_wanted


def test_a_thread_gives_way_between_two_steps():
    log = WorkLog(compat.WorkLock())
    with log.lock:
        log.lock.give_way()  # nobody waits
        log.start("preview", "_threads")
        log.start("operator", "_operators")
        log.lock.give_way()
        log.order.append("next step")
    assert log.join() == ["operator", "preview", "next step"]


def test_an_interrupted_wait_leaves_the_lock_to_others(monkeypatch):
    class Interrupted(threading.Event().__class__):
        def wait(self, timeout=None):
            raise KeyboardInterrupt

    lock = compat.WorkLock()
    with lock:
        with monkeypatch.context() as patch:
            patch.setattr(threading, "Event", Interrupted)
            with pytest.raises(KeyboardInterrupt), lock.lock_for_operator():
                pass
        assert not lock.is_wanted
    with lock.lock_for_operator():
        pass
