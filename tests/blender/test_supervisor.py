"""A command at a shell says in one line on which file Blender broke down; else it ends as if unsupervised."""

from __future__ import annotations

import os
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest
from builders import add_sphere

from hnf_blender.supervisor import SLOW_READ_NOTE
from hnf_core.files import is_process_alive

ROOT = Path(__file__).parents[2]
PROGRAM = """
import ctypes, os, signal, sys, time
from pathlib import Path
from hnf_blender import supervisor
from hnf_core.files import make_run_folder

supervisor.SLOW_READ_S = 0.2

def run():
    folder = make_run_folder("touch")
    print(os.getpid(), flush=True)
    {}
    folder.cleanup()
    return 0

sys.exit(supervisor.run_supervised(run))
"""
READING = "with supervisor.announce_read(Path('bad.blend')): "
READ = READING + "pass\n    "
CRASH = "ctypes.string_at(0)"

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork")


def start(body: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-c", PROGRAM.format(body)]
    # With it Python itself would print a traceback first.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONFAULTHANDLER"}
    return subprocess.Popen(
        words, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("body", "code", "said"),
    [
        ("return 0", 0, ""),
        ("return 2", 2, ""),
        ("sys.exit(3)", 3, ""),
        (READING + CRASH, 1, "hnf: bad.blend: is damaged: Blender broke down when it read it (SIGSEGV). Export"),
        (READING + "os.abort()", 1, "(SIGABRT)"),
        (READING + "os.kill(os.getpid(), signal.SIGKILL)", 1, "hnf: bad.blend: the system ended Blender while"),
        (READ + CRASH, 1, "hnf: bad.blend: Blender broke down (SIGSEGV). Run it again"),
        (READ + "os.kill(os.getpid(), signal.SIGKILL)", -9, ""),
        (CRASH, 1, "hnf: Blender broke down (SIGSEGV)."),
        ("os.kill(os.getpid(), signal.SIGTERM)", -15, ""),
        (READING + "time.sleep(1.0)", 0, f"note: {SLOW_READ_NOTE.format('bad.blend')}"),
        (READ + "time.sleep(1.0)", 0, ""),
    ],
)
def test_how_a_command_ended_is_said_in_one_line(body: str, code: int, said: str, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    process = start(body)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == code, errors
    assert len(errors.splitlines()) == bool(said)
    assert said in errors
    if "Blender broke down" in said:
        assert not list(tmp_path.iterdir())


INTERRUPTED = """try:
        print("begun", flush=True)
        time.sleep(60.0)
    except KeyboardInterrupt: time.sleep(0.2)
    print("stopped once")
    return 1"""


@pytest.mark.parametrize("send", [os.kill, os.killpg], ids=["process", "group"])
def test_an_interrupt_reaches_the_command_once(send) -> None:
    process = start(INTERRUPTED)
    assert process.stdout is not None
    while process.stdout.readline() != "begun\n":
        assert process.poll() is None
    send(process.pid, signal.SIGINT)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, output, errors) == (1, "stopped once\n", "")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_what_ends_the_supervisor_ends_the_command(number: signal.Signals) -> None:
    if number == signal.SIGKILL and sys.platform != "linux":
        pytest.skip("only Linux tells a process that its parent was killed")
    process = start("time.sleep(60.0)")
    assert process.stdout is not None
    command = int(process.stdout.readline())
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)  # the command has closed its end too
    assert (process.returncode, errors) == (-number, "")
    deadline = time.monotonic() + 60.0
    while is_process_alive(command) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not is_process_alive(command)


def save_confused_scene(path: Path) -> None:
    """A .blend whose object says that its mesh is what is a material."""
    ball = add_sphere("Ball", 0.05, 8, 6)
    ball.data.materials.append(bpy.data.materials.new("Leather"))
    bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=False)
    data = bytearray(path.read_bytes())
    # Code, size and former address of a block; Blender 5.0 made the head longer.
    head, at = (struct.Struct("<4s4xQq8x"), 17) if data[7:9] == b"17" else (struct.Struct("<4siQ8x"), 12)
    blocks = {}
    while at < len(data):
        code, *numbers = head.unpack_from(data, at)
        size, address = reversed(numbers) if head.size > 24 else numbers
        at += head.size
        blocks.setdefault(code.rstrip(b"\0"), (at, size, address))
        at += size
    start, size, _ = blocks[b"OB"]
    pointer = data.index(struct.pack("<Q", blocks[b"ME"][2]), start, start + size)
    struct.pack_into("<Q", data, pointer, blocks[b"MA"][2])
    path.write_bytes(data)


@pytest.mark.parametrize("words", [("touch", "--plan"), ("touch", "--json"), ("views",)], ids=" ".join)
def test_a_file_on_which_blender_breaks_down_is_named(words: tuple[str, ...], tmp_path, monkeypatch) -> None:
    scene, verb, options = tmp_path / "confused.blend", words[0], words[1:]
    save_confused_scene(scene)
    (tmp_path / "temporary").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    program = "import sys; from hnf_blender.cli import main; sys.exit(main())"
    order = [sys.executable, "-c", program, verb, str(scene), "--out", str(tmp_path / "out"), *options]
    run = subprocess.run(order, cwd=ROOT, capture_output=True, text=True)
    assert run.returncode == 1, run.stderr
    assert "{" not in run.stdout
    (line,) = run.stderr.splitlines()
    assert line.startswith(f"hnf: {scene}: is damaged: Blender broke down when it read it (SIG")
    assert "Export or download it again" in line
    assert not list((tmp_path / "temporary").iterdir())
