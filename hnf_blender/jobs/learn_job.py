"""Job that learns a haptic material: trains in an external Python, then assigns the material file to a slot.

`check_python` finds out whether a Python can train; nothing is ever installed into it.
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

from hnf_core.datasets.registry import LICENCES
from hnf_core.diagnostics import MIN_TRAINING_PYTHON, TRAINING_PACKAGES
from hnf_core.errors import FileError, HnfError
from hnf_core.field.weights import build_learned_material, load_material_field
from hnf_core.files import content_hash
from hnf_core.json_io import encode_json
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
    make_python_command,
    remove_job_folder,
)

CHECK_TIMEOUT_S = 60.0
"""Time limit of the check [s]; a first import of torch reads a gigabyte."""
CHECK_PREFIX = "@hnf python "
"""Marks the line of output with the result of the check."""
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
"""Script that imports the packages and prints their versions as JSON."""


def check_python(path: str, timeout_s: float = CHECK_TIMEOUT_S) -> ExternalPython:
    """Run a Python and return its version and packages; waits for `timeout_s` seconds at most and never raises."""
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
        output, _ = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        kill_process_group(process.pid)
        process.communicate()
        return _make_unusable(path, tr("It gave no answer within {seconds} s").format(seconds=f"{timeout_s:g}"))
    return _parse_output(path, output.decode("utf-8", "replace"))


def make_clean_environment() -> Mapping[str, str]:
    """Return the environment without the variables that configure Blender's Python."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}


def _parse_output(path: str, output: str) -> ExternalPython:
    line = next((output_line for output_line in output.splitlines() if output_line.startswith(CHECK_PREFIX)), "")
    try:
        result = json.loads(line.removeprefix(CHECK_PREFIX))
        version = tuple(int(number) for number in result["version"])
        versions = {name: str(result["found"][name]) for name in TRAINING_PACKAGES}
    except (ValueError, KeyError, TypeError):
        return _make_unusable(path, tr("It is not a Python"))
    version_text = ".".join(map(str, version))
    available = tuple((name, package_version) for name, package_version in versions.items() if package_version)
    lacking = tuple(name for name, package_version in versions.items() if not package_version)
    if version < MIN_TRAINING_PYTHON:
        minimum = ".".join(map(str, MIN_TRAINING_PYTHON))
        problem = tr("It is Python {version}, and {least} or newer is needed").format(
            version=version_text, least=minimum
        )
        return ExternalPython(path, version_text, available, lacking, problem)
    if not lacking:
        return ExternalPython(path, version_text, available, lacking, "")
    return ExternalPython(
        path, version_text, available, lacking, tr("It lacks {packages}").format(packages=", ".join(lacking)),
        format_install_command(path, lacking),
    )  # fmt: skip


def format_install_command(path: str, missing: tuple[str, ...]) -> str:
    """Return the command that installs missing packages, to be run by the user in a terminal."""
    return " ".join([f'"{path}" -m pip install', *(f'"{TRAINING_PACKAGES[name]}"' for name in missing)])


def _make_unusable(path: str, problem: str) -> ExternalPython:
    return ExternalPython(path, "", (), (), problem)


LEARNING_KILLED_REMEDY = "Nothing was changed. Learn it again with the same choices to resume. If it happens again, "
LEARNING_KILLED_REMEDY += "close other programs (memory)."


@dataclass(frozen=True)
class MaterialSlot:
    """Blender material slot that the learned material is assigned to; object_name "" means none."""

    object_name: str = ""
    slot: int = 0


class LearnJob(ChildJob):
    """Job that learns a haptic material from recordings in an external Python."""

    process_name = "The process that learned"
    killed_remedy = LEARNING_KILLED_REMEDY

    def __init__(self, python: str, lesson: LearnRequest, slot: MaterialSlot) -> None:
        """Start the process. Raises HnfError if that fails; nothing is left behind then.

        Parameters
        ----------
        python : str
            Path of the external Python.
        lesson : LearnRequest
            Data and settings of the training.
        slot : MaterialSlot
            Slot that gets the material.
        """
        self.started = time.monotonic()
        self._lesson, self._slot = lesson, slot
        self._training_since: float | None = None
        self.out = make_weights_path(lesson)
        self.folder = make_job_folder()
        command = make_python_command("learn", encode_json(lesson), str(self.out), python=python)
        program = ChildProgram(
            command, "the external Python", "Check it in the add-on's preferences.", make_clean_environment()
        )  # fmt: skip
        try:
            self._child = ChildProcess(self.folder, program)
        except BaseException:
            self.clean_up()
            raise
        self._update_status(Step("starting", 0, 1))

    def cancel(self) -> LastJob:
        """Cancel the job; the training's checkpoint remains for another run with the same settings."""
        message = tr("Learning canceled. Nothing was changed; run it again with the same choices to resume.")
        return self._finish(LastJob(True, message))

    def clean_up(self) -> None:
        """End the process and remove its partial files, except the training's checkpoint."""
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
        material_path = (
            get_learned_folder() / f"{_sanitise_file_name(definition.name)} ({self._lesson.kind}){HNF_SUFFIX}"
        )
        write_hnf(material_path, definition)
        self.out.unlink(missing_ok=True)
        material_field = load_material_field(definition)
        training_data = "" if material_field is None else material_field.metadata.get("training_data", "")
        details = tuple(text for text in (LICENCES[self._lesson.kind], training_data) if text)
        return LastJob(True, assign_to_slot(definition, self._slot, material_path), details, written=1)

    def _update_status(self, step: Step) -> None:
        now, left_s = time.monotonic(), None
        if step.stage == STAGE_TRAINING:
            self._training_since = self._training_since or now
            if step.done > 1:  # The first epoch's duration is unknown until it ends.
                left_s = (now - self._training_since) / step.done * (step.total - 1 - step.done)
        STATE.job = JobStatus(step.stage, step.done, step.total, now - self.started, left_s)


def learn_blocking(python: str, lesson: LearnRequest, slot: MaterialSlot) -> LastJob:
    """Learn a haptic material and wait for it. Raises HnfError if it cannot be started or fails."""
    job = LearnJob(python, lesson, slot)
    while (outcome := job.tick()) is None:
        time.sleep(0.05)
    if not outcome.ok:
        raise HnfError(outcome.message)
    return outcome


def make_weights_path(lesson: LearnRequest) -> Path:
    """Return the path of the trained weights, in whose folder the checkpoint is; equal requests give equal paths."""
    return get_learned_folder() / f"{content_hash(repr(sorted(asdict(lesson).items())))}.safetensors"


def assign_to_slot(definition: MaterialFile, slot: MaterialSlot, material_path: Path) -> str:
    """Assign a learned material to a slot and return a sentence for the user.

    If the slot does not exist, or the user chose another haptic material for it, a new Blender material is created
    instead.

    Parameters
    ----------
    definition : MaterialFile
        Learned material.
    slot : MaterialSlot
        Slot to assign it to.
    material_path : Path
        File of the material, named in the sentence.
    """
    from ..bridge.scene.material_definition import assign_definition, create_material

    obj = _find_assignable_object(slot)
    if obj is not None:
        material = assign_definition(obj, slot.slot, definition)
        template = tr("{object}: material '{material}' now feels like {name}, as learned")
        sentence = template.format(object=obj.name, material=material.name, name=definition.name)
    else:
        material = create_material(definition)
        material.use_fake_user = True  # No slot uses it yet, and it must survive saving.
        sentence = tr("Learned: new material '{material}'. Put it in a slot, or open {file}").format(
            material=material.name, file=material_path
        )
    STATE.dirty_names.add(material.name)
    return sentence


def _find_assignable_object(slot: MaterialSlot) -> Any:
    """Return the slot's object if the slot exists and can be assigned a material, else None."""
    import bpy

    from ..props.material_settings import DEFINITION_PROPERTY

    obj = bpy.data.objects.get(slot.object_name) if slot.object_name else None
    if obj is None or not hasattr(obj.data, "materials") or obj.data.library is not None or not obj.is_editable:
        return None
    slots = obj.material_slots
    if slot.slot > max(len(slots) - 1, 0):
        return None
    current = slots[slot.slot].material if slot.slot < len(slots) else None
    if current is None:
        return obj
    is_chosen = bool(current.hnf_touch.library) or DEFINITION_PROPERTY in current
    return None if is_chosen or not current.is_editable or current.override_library is not None else obj


def _remove_leftovers(folder: Path, out: Path) -> None:
    remove_job_folder(folder)
    for leftover in out.parent.glob(f".{out.stem}*"):
        leftover.unlink(missing_ok=True)


def _sanitise_file_name(name: str) -> str:
    return (
        "".join(character if character.isalnum() or character in " -_." else "_" for character in name).strip(". ")
        or "material"
    )
