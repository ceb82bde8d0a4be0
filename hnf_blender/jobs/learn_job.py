"""A Python outside Blender, named by the artist: whether it can train. It is asked; nothing is installed into it.

Learning a material: the trainer runs under a Python outside Blender, and what it learned is given to a slot.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from hnf_core.child_process import CORE_FOLDER
from hnf_core.datasets.registry import LICENCES
from hnf_core.diagnostics import MIN_TRAINING_PYTHON, TRAINING_PACKAGES
from hnf_core.errors import FileError, HnfError
from hnf_core.field.weights import build_learned_material, load_material_field
from hnf_core.files import content_hash
from hnf_core.material.hnf_file import HNF_SUFFIX, MaterialFile, write_hnf
from hnf_core.training.learn import STAGE_TRAINING, LearnRequest

from ..state.addon_settings import get_learned_folder
from ..state.job_results import ExternalPython
from ..state.session_state import STATE, JobStatus, LastJob
from ..translations import tr
from .child_job import (
    PROCESS_GROUP_OPTIONS,
    ChildJob,
    ChildProcess,
    ChildProgram,
    Failed,
    Finished,
    Message,
    Step,
    kill_process_group,
    make_job_folder,
    remove_job_folder,
    to_json,
)

CHECK_TIMEOUT_S = 60.0
"""A first import of torch reads a gigabyte."""
CHECK_PREFIX = "@hnf python "
CHECK_SCRIPT = f"""
import importlib, json, sys
found = {{}}
for name in sys.argv[1:]:
    try:
        found[name] = str(getattr(importlib.import_module(name), "__version__", "?"))
    except BaseException as error:
        found[name] = ""
print({CHECK_PREFIX!r} + json.dumps({{"version": list(sys.version_info[:3]), "found": found}}))
"""


def check_python(path: str, timeout_s: float = CHECK_TIMEOUT_S) -> ExternalPython:
    """Run it and ask. Waits for the answer, timeout_s at most; never raises."""
    if not Path(path).is_file():
        return _make_unusable(path, tr("There is no such file"))
    try:
        process = subprocess.Popen(
            [path, "-c", CHECK_SCRIPT, *TRAINING_PACKAGES],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=make_clean_environment(),
            **PROCESS_GROUP_OPTIONS,
        )
    except (OSError, ValueError) as error:
        return _make_unusable(
            path, tr("It cannot be started ({why})").format(why=getattr(error, "strerror", None) or error)
        )
    try:
        said, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        kill_process_group(process.pid)
        process.communicate()
        return _make_unusable(path, tr("It gave no answer within {seconds} s").format(seconds=f"{timeout_s:g}"))
    return _parse_output(path, said.decode("utf-8", "replace"))


def make_clean_environment() -> Mapping[str, str]:
    """Without what Blender, or whoever started it, tells its own Python."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _parse_output(path: str, output: str) -> ExternalPython:
    line = next((each for each in output.splitlines() if each.startswith(CHECK_PREFIX)), "")
    try:
        answer = json.loads(line.removeprefix(CHECK_PREFIX))
        version = tuple(int(part) for part in answer["version"])
        versions = {name: str(answer["found"][name]) for name in TRAINING_PACKAGES}
    except (ValueError, KeyError, TypeError):
        return _make_unusable(path, tr("It is not a Python"))
    text = ".".join(map(str, version))
    found = tuple((name, known) for name, known in versions.items() if known)
    missing = tuple(name for name, known in versions.items() if not known)
    if version < MIN_TRAINING_PYTHON:
        least = ".".join(map(str, MIN_TRAINING_PYTHON))
        problem = tr("It is Python {version}, and {least} or newer is needed").format(version=text, least=least)
        return ExternalPython(path, text, found, missing, problem)
    if not missing:
        return ExternalPython(path, text, found, missing, "")
    return ExternalPython(
        path, text, found, missing, tr("It lacks {packages}").format(packages=", ".join(missing)),
        format_install_command(path, missing),
    )  # fmt: skip


def format_install_command(path: str, missing: tuple[str, ...]) -> str:
    """What a person types into a terminal; the add-on never does."""
    return " ".join([f'"{path}" -m pip install', *(f'"{TRAINING_PACKAGES[name]}"' for name in missing)])


def _make_unusable(path: str, problem: str) -> ExternalPython:
    return ExternalPython(path, "", (), (), problem)


WORKER = Path(__file__).with_name("learn_worker.py")
LEARNING_KILLED_REMEDY = "Nothing was changed. Learn it again with the same choices to resume. If it happens again, "
LEARNING_KILLED_REMEDY += "close other programs (memory)."


@dataclass(frozen=True)
class MaterialSlot:
    """Where a learned material belongs. object_name: "" = nowhere yet. slot: counted from 0."""

    object_name: str = ""
    slot: int = 0


class LearnJob(ChildJob):
    """A material being learned in a child process."""

    process_name = "The process that learned"
    killed_remedy = LEARNING_KILLED_REMEDY

    def __init__(self, python: str, lesson: LearnRequest, slot: MaterialSlot) -> None:
        """Starts. Raises HnfError; nothing is left behind then."""
        self.started = time.monotonic()
        self._lesson, self._slot = lesson, slot
        self._training_since: float | None = None
        self.out = make_weights_path(lesson)
        self.folder = make_job_folder()
        words = [python, str(WORKER), CORE_FOLDER, to_json(lesson), str(self.out)]
        program = ChildProgram(
            words, "the external Python", "Check it in the add-on's preferences.", make_clean_environment()
        )  # fmt: skip
        try:
            self._child = ChildProcess(self.folder, program)
        except BaseException:
            self.clean_up()
            raise
        self._update_status(Step("starting", 0, 1))

    def cancel(self) -> LastJob:
        """Stop now; nothing is changed, and what was learned so far waits for the same choices."""
        said = tr("Learning cancelled. Nothing was changed; run it again with the same choices to resume.")
        return self._finish(LastJob(True, said))

    def clean_up(self) -> None:
        """Nothing half written is left: of training the checkpoint alone, which was renamed into place whole."""
        if self._child is not None:
            self._child.kill(on_exit=partial(_remove_leftovers, self.folder, self.out))
            self._child = None
        _remove_leftovers(self.folder, self.out)
        STATE.job = None

    def _on_message(self, message: Message, child: ChildProcess) -> LastJob | None:
        if isinstance(message, Failed):
            return LastJob(False, message.why, child.last_lines)
        if isinstance(message, Finished):
            return self._assign_result()
        if isinstance(message, Step):
            self._update_status(message)
        return None

    def _assign_result(self) -> LastJob:
        try:
            definition = build_learned_material(self.out.read_bytes(), str(self.out))
        except OSError as error:
            raise FileError(
                f"cannot be read ({error.strerror}).", where=str(self.out), remedy="Learn it again."
            ) from error
        kept = get_learned_folder() / f"{_sanitise_file_name(definition.name)} ({self._lesson.kind}){HNF_SUFFIX}"
        write_hnf(kept, definition)
        self.out.unlink(missing_ok=True)
        learned = load_material_field(definition)
        told = "" if learned is None else learned.metadata.get("training_data", "")
        details = tuple(text for text in (LICENCES[self._lesson.kind], told) if text)
        return LastJob(True, assign_to_slot(definition, self._slot, kept), details, written=1)

    def _update_status(self, step: Step) -> None:
        now, left = time.monotonic(), None
        if step.stage == STAGE_TRAINING:
            self._training_since = self._training_since or now
            if step.done > 1:  # the first epoch's share of the time is not known before it is over
                left = (now - self._training_since) / step.done * (step.total - 1 - step.done)
        STATE.job = JobStatus(step.stage, step.done, step.total, now - self.started, left)


def learn_blocking(python: str, lesson: LearnRequest, slot: MaterialSlot) -> LastJob:
    """Wait for all of it. Raises HnfError where it cannot be begun or fails."""
    learning = LearnJob(python, lesson, slot)
    while (ended := learning.tick()) is None:
        time.sleep(0.05)
    if not ended.ok:
        raise HnfError(ended.message)
    return ended


def make_weights_path(lesson: LearnRequest) -> Path:
    """Where the weights of a lesson are written, the checkpoint beside them: equal choices, equal place."""
    return get_learned_folder() / f"{content_hash(repr(sorted(asdict(lesson).items())))}.safetensors"


def assign_to_slot(definition: MaterialFile, slot: MaterialSlot, material_path: Path) -> str:
    """Make definition what the slot feels like, where nobody said anything else of it; a new Blender material that
    looks like nothing yet where somebody did, or where there is no such slot. Returns a sentence."""
    from ..bridge.scene.material_definition import assign_definition, create_material

    obj = _find_assignable_object(slot)
    if obj is not None:
        material = assign_definition(obj, slot.slot, definition)
        said = tr("{object}: material '{material}' now feels like {name}, as learned")
        text = said.format(object=obj.name, material=material.name, name=definition.name)
    else:
        material = create_material(definition)
        material.use_fake_user = True  # it belongs to no slot yet, and is to outlive a save
        text = tr("Learned: new material '{material}'. Put it in a slot, or open {file}").format(
            material=material.name, file=material_path
        )
    STATE.dirty_names.add(material.name)
    return text


def _find_assignable_object(slot: MaterialSlot) -> Any:
    """The object, where its slot can be given to; else None."""
    import bpy

    from ..props.material_settings import DEFINITION_PROPERTY

    obj = bpy.data.objects.get(slot.object_name) if slot.object_name else None
    if obj is None or not hasattr(obj.data, "materials") or obj.data.library is not None or not obj.is_editable:
        return None
    slots = obj.material_slots
    if slot.slot > max(len(slots) - 1, 0):
        return None
    held = slots[slot.slot].material if slot.slot < len(slots) else None
    if held is None:
        return obj
    is_said = bool(held.hnf_touch.library) or DEFINITION_PROPERTY in held
    return None if is_said or not held.is_editable or held.override_library is not None else obj


def _remove_leftovers(folder: Path, out: Path) -> None:
    remove_job_folder(folder)
    for half in out.parent.glob(f".{out.stem}*"):
        half.unlink(missing_ok=True)


def _sanitise_file_name(name: str) -> str:
    return "".join(each if each.isalnum() or each in " -_." else "_" for each in name).strip(". ") or "material"
