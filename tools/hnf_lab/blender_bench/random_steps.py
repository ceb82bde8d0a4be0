"""Random steps of a user in one Blender after another, with what must hold after each of them.

    python -m hnf_lab.blender_bench.random_steps [--steps 500] [--seeds 20] [--first 0] [--json FILE]

A step draws, bakes, undoes, redoes, moves, turns, renames, hides, copies, deletes, appends, links, saves, reloads,
switches scene or mode, changes settings and keys, adds strips and speakers, plays. Afterwards nothing may have raised,
the tab can be drawn, every status is that of a fresh look, every stroke is heard at most once, and an undo brings back
what was kept. One process runs one seed, so that a crash of Blender is a fault too.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

import hnf_blender
from hnf_blender import handlers, preview, props
from hnf_blender.bridge.scene.stored_data import TOKEN_ATTRIBUTE, get_property
from hnf_blender.compat import fcurves_of
from hnf_blender.preview.preview_state import PREVIEW
from hnf_blender.preview.strips_and_speakers import find_sounding, list_audible
from hnf_blender.preview.timeline_playback import list_placed_signals
from hnf_blender.props.object_cache import CHANGES
from hnf_blender.registration import add_handlers, remove_handlers
from hnf_blender.state import status_tracker
from hnf_blender.state.session_state import STATE
from hnf_blender.state.status_tracker import refresh_status
from hnf_blender.touch.stroke_bake import BAKE_PROPERTY
from hnf_core.files import write_text

from .scenes import draw_tab, open_test_file
from .user_steps import FRAMES, STEPS, UNDONE, RefusedError, add_surface

LOOKS = 200
"""Ticks within which the statuses settle."""
SETTLED_TICKS = 4
"""Ticks without news: of changes that nobody reports, eight strokes are compared a tick."""
MIX_EVERY = 10
"""Steps between two comparisons with what Blender itself mixes."""
AUDIBLE = 1e-4
"""Sample value that counts as sound (1 = full scale)."""
SEED_LIMIT_S = 3600.0
DONE = "@done "
"""Beginning of the line in which a process tells its outcome."""


@dataclass
class Outcome:
    """Outcome of one seed: steps taken by kind, and the faults found, one line each."""

    seed: int
    steps: Counter[str] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    seconds: float = 0.0


class Walk:
    """Random walk through an open test file, in this process."""

    def __init__(self, seed: int, folder: Path) -> None:
        self.random, self.folder, self.outcome = random.Random(seed), folder, Outcome(seed)
        self.past: list[dict[str, object] | None] = []
        self.place, self.log = 0, list[str]()

    # ---- what is there

    @property
    def scene(self) -> Any:
        return bpy.context.window_manager.windows[0].scene

    @property
    def layer(self) -> Any:
        return bpy.context.window_manager.windows[0].view_layer

    def strokes(self) -> list[Any]:
        return [obj for obj in self.scene.objects if obj.hnf_stroke.is_stroke]

    def surfaces(self) -> list[Any]:
        return [obj for obj in self.scene.objects if obj.type == "MESH"]

    def choose(self, items: Sequence[Any]) -> Any:
        if not items:
            raise RefusedError("nothing to choose from")
        return self.random.choice(items)

    def choose_local(self, items: Sequence[Any]) -> Any:
        return self.choose([item for item in items if item.library is None])

    def choose_editable(self, objects: Sequence[Any]) -> Any:
        """Choose what a person could edit: neither linked nor hidden."""
        seen = [obj for obj in objects if obj.name in self.layer.objects and obj.visible_get(view_layer=self.layer)]
        return self.choose_local([obj for obj in seen if obj.data.library is None])

    def activate(self, obj: Any) -> Any:
        """Make an object the active and only selected one."""
        if obj.name not in self.layer.objects or obj.hide_get() or not obj.visible_get(view_layer=self.layer):
            raise RefusedError("hidden")
        for other in self.layer.objects.selected:
            other.select_set(False, view_layer=self.layer)
        obj.select_set(True, view_layer=self.layer)
        self.layer.objects.active = obj
        return obj

    # ---- one step

    def run(self, steps: int) -> Outcome:
        """Take the steps; the first fault of a step is noted, and the walk goes on."""
        began = time.monotonic()
        self.begin()
        kinds, weights = zip(*STEPS.items(), strict=True)
        for number in range(steps):
            step = self.random.choices(kinds, weights)[0]
            name = step.__name__
            print(f"{number} {name}", flush=True)
            try:
                wait_for_preview()
                self.take(step)
                if step not in UNDONE:
                    self.push(name)
                self.log.append(name)
                self.outcome.steps[name] += 1
                self.check(number)
            except RefusedError:
                self.outcome.steps["refused"] += 1
                if self.past[self.place] not in (None, self.read_state()):
                    self.push("refused halfway")
            except Exception:
                line = traceback.format_exc(limit=-3).strip().replace("\n", " | ")
                self.fault(number, f"{name} raised: {line}")
        self.outcome.seconds = time.monotonic() - began
        return self.outcome

    def take(self, step: Callable[[Walk], None]) -> None:
        """Take a step in the window. Raises RefusedError for what Blender or the add-on refuses in a sentence."""
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            try:
                step(self)
            except RuntimeError as error:
                if "Traceback" in str(error):
                    raise
                raise RefusedError(str(error)) from error

    def fault(self, number: int, what: str) -> None:
        text = f"step {number} after {', '.join(self.log[-6:])}: {what}"
        print(f"FAULT {text}", flush=True)
        self.outcome.faults.append(text)

    def begin(self) -> None:
        self.scene.frame_end = FRAMES
        add_surface(self)
        self.settle()
        bpy.ops.wm.save_as_mainfile(filepath=str(self.folder / "begun.blend"))
        self.forget_the_past()

    # ---- what must hold

    def settle(self) -> None:
        """Let the add-on's timers run until they have no more to do, as a window does while nobody touches it."""
        self.layer.update()
        calm = 0
        for _ in range(LOOKS):
            handlers.tick()
            idle = all(each.is_idle for each in status_tracker._trackers.values())
            calm = calm + 1 if idle and not STATE.dirty_names else 0
            if calm == SETTLED_TICKS:
                break
        windows = list(bpy.context.window_manager.windows)
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            preview.update_scenes(windows)
            thread, snapshot = PREVIEW.synthesis_thread, preview._snapshots.get(self.scene.name_full)
            if (thread is None or not thread.is_busy) and (snapshot is None or not snapshot.pending):
                break
            time.sleep(0.005)
        preview.update_scenes(windows)

    def check(self, number: int) -> None:
        self.settle()
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            draw_tab(self.scene, self.layer)
            for what in (*self.find_contradictions(), *self.find_doubled(number)):
                self.fault(number, what)

    def find_contradictions(self) -> Iterator[str]:
        """Yield each status that a fresh look contradicts, and each that is an internal error."""
        told = dict(STATE.get_statuses(self.scene))
        refresh_status(self.scene, view_layer=self.layer)
        fresh = STATE.get_statuses(self.scene)
        for name in sorted(told.keys() | fresh.keys()):
            before, now = told.get(name), fresh.get(name)
            if now is not None and "internal error" in now.why:
                yield f"status of '{name}': {now.why}"
            if (before and before[:2]) != (now and now[:2]):
                yield f"status of '{name}' is {before and before[:2]}, a fresh look says {now and now[:2]}"

    def find_doubled(self, number: int) -> Iterator[str]:
        """Yield each stroke that the timeline plays beside its own strip or speaker; now and then ask Blender's mix."""
        placed = {id(each.samples) for each in list_placed_signals(self.scene)}
        for stroke in self.strokes():
            shown = PREVIEW.get_shown(stroke.name)
            sounding = find_sounding(stroke, self.scene)
            if sounding and shown is not None and id(shown.signal.samples) in placed:
                yield f"'{stroke.name}' is heard from the timeline and from {[each.name for each in sounding]}"
        if number % MIX_EVERY == 0 and not list_audible(self.scene) and self.has_audible_mix():
            yield "Blender sounds a strip or speaker that is taken for silent"

    def has_audible_mix(self) -> bool:
        """Return whether Blender's own mix of the scene has any sound in it. Without sound support it has none."""
        path = self.folder / "mix.wav"
        try:
            aud = importlib.import_module("aud")
            bpy.ops.sound.mixdown(filepath=str(path), container="WAV", codec="PCM", format="F32")
        except (ImportError, RuntimeError):
            return False
        return bool(np.abs(aud.Sound(str(path)).data()).max(initial=0.0) > AUDIBLE)

    # ---- undo

    def read_state(self) -> dict[str, object]:
        """Return what an artist would miss: strokes with their curves, keys, settings and bakes; choices; tokens.

        Linked data are another file's: Blender's undo of a link leaves them in the file, without a user.
        """
        kept: dict[str, object] = {}
        for obj in bpy.data.objects:
            if obj.hnf_stroke.is_stroke and obj.library is None:
                keys = [
                    (curve.data_path, [tuple(key.co) for key in curve.keyframe_points]) for curve in fcurves_of(obj)
                ]
                group, surface = obj.hnf_stroke, obj.hnf_stroke.surface
                settings = (group.mute, group.seed, group.law, group.probe, group.material, surface and surface.name)
                baked = get_property(obj, BAKE_PROPERTY)
                kept[f"stroke {obj.name_full}"] = (
                    sorted(keys),
                    settings,
                    None if baked is None else hash(bytes(baked)),
                )
        for mesh in (each for each in bpy.data.meshes if each.library is None):
            kept[f"mesh {mesh.name_full}"] = TOKEN_ATTRIBUTE in mesh.attributes
        for material in (each for each in bpy.data.materials if each.library is None):
            kept[f"choice {material.name_full}"] = material.hnf_touch.library
        return kept

    def forget_the_past(self) -> None:
        """Begin a new history: a file was opened, or what the next undo gives back is not known."""
        wait_for_preview()
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.ed.undo_push(message="begin")
        self.past, self.place = [self.read_state()], 0

    def push(self, message: str) -> None:
        wait_for_preview()
        with bpy.context.temp_override(window=bpy.context.window_manager.windows[0]):
            bpy.ops.ed.undo_push(message=message)
        del self.past[self.place + 1 :]
        self.past.append(self.read_state() if in_object_mode() else None)
        self.place += 1

    def travel(self, way: int) -> None:
        """Undo or redo, and compare with what was kept then."""
        if not 0 <= self.place + way < len(self.past):
            raise RefusedError("no step there")
        left = self.past[self.place]
        (bpy.ops.ed.undo if way < 0 else bpy.ops.ed.redo)()
        self.place += way
        expected, found = self.past[self.place], self.read_state()
        if left is None or expected is None:
            # What else was changed in another mode, Blender keeps on every way back.
            self.past = [None] * len(self.past)
            self.past[self.place] = found if in_object_mode() else None
        elif expected != found:
            wrong = sorted(key for key in expected.keys() | found.keys() if expected.get(key) != found.get(key))
            self.past[self.place] = found
            raise AssertionError(f"{'undo' if way < 0 else 'redo'} brings back another {wrong}")


def wait_for_preview() -> None:
    """Bring the scene up to date, which may ask for a preview, and wait until no thread makes one.

    A script's operator with an overridden context must not run beside another thread (`compat.override_context`): 7 of
    8 walks of 500 steps crashed in undo_push. A step may itself wait for a preview, so that no lock is held here.
    """
    bpy.context.view_layer.update()
    until = time.monotonic() + 30.0
    while PREVIEW.synthesis_thread is not None and PREVIEW.synthesis_thread.is_busy and time.monotonic() < until:
        time.sleep(0.002)


def in_object_mode() -> bool:
    """Return whether nothing is in another mode, in which Blender's undo knows the edited data alone."""
    return all(obj.mode == "OBJECT" for obj in bpy.data.objects)


@contextmanager
def switch_addon_on() -> Iterator[None]:
    """Switch the whole add-on on with the handlers that it has in a window; timers are driven by the walk."""
    if hasattr(bpy.types.Object, "hnf_stroke"):
        props.unregister()
    hnf_blender.register()
    listed = (*handlers.HANDLERS, *preview.HANDLERS)
    add_handlers(listed)
    CHANGES.is_notified = True
    try:
        yield
    finally:
        CHANGES.is_notified = False
        remove_handlers(listed)
        hnf_blender.unregister()


def walk_one(seed: int, steps: int) -> Outcome:
    """Take the steps of one seed in this process, in a file and a folder of its own."""
    with open_test_file(), tempfile.TemporaryDirectory() as folder, switch_addon_on():
        return Walk(seed, Path(folder)).run(steps)


def run_apart(seed: int, steps: int) -> Outcome:
    """Take the steps of one seed in a process of its own; what ends it too early, or it prints, is a fault."""
    command = [sys.executable, "-m", __spec__.name if __spec__ else __name__, "--one", str(seed), "--steps", str(steps)]
    began = time.monotonic()
    try:
        run = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors="replace", timeout=SEED_LIMIT_S,
        )  # fmt: skip
        output, code = run.stdout, run.returncode
    except subprocess.TimeoutExpired as error:
        output, code = bytes(error.stdout or b"").decode("utf-8", "replace"), -9
    lines = output.splitlines()
    told = next((line for line in reversed(lines) if line.startswith(DONE)), "")
    facts: dict[str, Any] = json.loads(told.removeprefix(DONE)) if told else {"steps": {}, "faults": []}
    outcome = Outcome(seed, Counter(facts["steps"]), list(facts["faults"]), time.monotonic() - began)
    if not told:
        outcome.faults.append(f"ended with code {code} after: {' / '.join(lines[-4:])}")
    for at, line in enumerate(lines):
        if line.startswith("Traceback"):
            outcome.faults.append(f"printed: {' | '.join(lines[max(0, at - 2) : at + 12])}")
    return outcome


def to_json(outcome: Outcome) -> dict[str, object]:
    """Convert an outcome to JSON."""
    return {**vars(outcome), "steps": dict(outcome.steps)}


def format_table(outcomes: Sequence[Outcome]) -> str:
    """Format the outcomes as Markdown: a row a seed, and a line for each fault."""
    rows = ["| seed | steps | refused | bakes | undo and redo | faults | min |", "|---|---|---|---|---|---|---|"]
    for each in outcomes:
        taken = each.steps.total() - each.steps["refused"]
        travelled = each.steps["undo"] + each.steps["redo"]
        rows.append(
            f"| {each.seed} | {taken} | {each.steps['refused']} | {each.steps['bake']} | {travelled} | "
            f"{len(each.faults)} | {each.seconds / 60.0:.1f} |"
        )
    return "\n".join([*rows, *(f"* seed {each.seed}, {fault}" for each in outcomes for fault in each.faults)])


def main() -> int:
    """Run the command; return 1 if there is a fault."""
    parser = argparse.ArgumentParser(description="Random steps of a user, and what must hold after each.")
    parser.add_argument("--steps", type=int, default=500)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--one", type=int, help="only this seed, in this process")
    parser.add_argument("--json", type=Path, help="write the outcomes there")
    options = parser.parse_args()
    if options.one is not None:
        outcome = walk_one(options.one, options.steps)
        print(DONE + json.dumps(to_json(outcome)), flush=True)
        return 1 if outcome.faults else 0
    outcomes = []
    for seed in range(options.first, options.first + options.seeds):
        outcomes.append(run_apart(seed, options.steps))
        print(format_table(outcomes[-1:]).partition("\n")[2].partition("\n")[2], flush=True)
        if options.json is not None:
            write_text(options.json, json.dumps([to_json(each) for each in outcomes], indent=1) + "\n")
    print(format_table(outcomes))
    return 1 if any(each.faults for each in outcomes) else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    os._exit(code)  # Blender 4.5's module hangs in the process's exit (tools/pytest_in_bpy.py)
