"""Formats that strokes leave in, as artists choose them; what they do stands in hnf_core.export.formats.

An actuator's profile in a file beside the scene, such as `hnf actuators measure` writes.

Scene.hnf: what the Touch tab keeps with the scene.
"""

# No `from __future__ import annotations`: Blender reads these annotations as values.

import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import bpy

from hnf_core.actuators.profile import GENERIC, PROFILES, USER_PROFILE_NAME, ActuatorProfile, make_user_profile
from hnf_core.errors import FileError, HnfError

from ..compat import beside_the_file
from ..translations import tr
from .material_settings import OVERRIDABLE, register_pointer, unregister_pointer
from .object_cache import REDRAW_LIFETIME_S, STROKES, get_object_at
from .stroke_settings import FORCE_MAX_N


class FormatChoice(NamedTuple):
    """word: in hnf_core.export.formats.FORMATS. scaled: its numbers are shares of the actuator's full scale. stem: what
    is added to the name of its files, where another format has the same suffix."""

    format_name: str
    label: str
    description: str
    scaled: bool = True
    stem: str = ""


FORMAT_CHOICES = (
    FormatChoice("wav", "WAV in m/s²", "10 kHz, 32-bit float, never normalised: nothing is lost", scaled=False),
    FormatChoice("wav8k", "WAV 8 kHz", "16 bit, for an actuator; 1 is the actuator's largest acceleration", stem="-8k"),
    FormatChoice("wav48k", "WAV 48 kHz", "16 bit, for a sound card and an amplifier; 1 is the largest acceleration",
                 stem="-48k"),
    FormatChoice("listen", "WAV to Listen to", "48 kHz, 16 bit, as loud as it goes without clipping: for ears, not for "
                 "an actuator", scaled=False, stem="-listen"),
    FormatChoice("haptic", ".haptic (Meta)", "Strength and frequency over time, for Meta Haptics; no waveform"),
    FormatChoice("ahap", ".ahap (Apple)", "Strength and sharpness over time, for iPhones; no waveform"),
    FormatChoice("android", "Android Waveform", "Strength over time, for VibrationEffect.createWaveform; no waveform",
                 stem="-android"),
    FormatChoice("hjif", ".hjif (MPEG)", "The vibration along the stroke and the vertices that it lies on; their mesh "
                 "is written beside it, as GLB"),
    FormatChoice("glb", "GLB (glTF)", "The touched mesh with what is baked on it (MPEG_haptic_material) and the signal",
                 scaled=False),
    FormatChoice("csv", "CSV", "A table of time and acceleration in m/s²", scaled=False),
    FormatChoice("npz", "NPZ", "numpy arrays, in m/s²", scaled=False),
)  # fmt: skip
CHOICE_BY_NAME = {choice.format_name: choice for choice in FORMAT_CHOICES}
FORMAT_ITEMS = [(choice.format_name, choice.label, choice.description) for choice in FORMAT_CHOICES]


PROFILE_FROM_FILE = "file"
"""Of Scene.hnf.actuator: the profile is in Scene.hnf.actuator_file."""
CHECK_INTERVAL_S = 2.0
"""Timers ask many times a second; the disk is asked this often whether the file has changed."""

_profiles: dict[str, ActuatorProfile] = {}
"""By path."""


def read_file_profile(path: str) -> ActuatorProfile:
    """Its name is the path: by that it is read again, with its response, where it is played. Where it cannot be read
    nothing is known of it, and source says why; playing on it is refused."""
    _profiles[path] = _read_profile(path, _read_mtime(path, int(time.monotonic() / CHECK_INTERVAL_S)))
    return _profiles[path]


def get_cached_profile(path: str) -> ActuatorProfile:
    """For panels, which ask no disk: as profile_in_file() found it last. A timer asks for what windows show."""
    return _profiles.get(path) or ActuatorProfile(path, _make_title(path), tr("Not read yet"))


@lru_cache(maxsize=4)
def _read_mtime(path: str, _when: int) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=4)
def _read_profile(path: str, _mtime: int) -> ActuatorProfile:
    from hnf_core.actuators.profile_json import read_profile

    try:
        if not path.lower().endswith(".json"):
            raise FileError("no profile is chosen.", remedy="Choose the .json file that measuring your actuator gave.")
        return replace(read_profile(Path(path)), name=path, response=None)
    except HnfError as error:
        return ActuatorProfile(path, _make_title(path), str(error))


def _make_title(path: str) -> str:
    return Path(path).name or tr("Measured actuator")


class HnfScene(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    stroke_index: bpy.props.IntProperty(
        name="Active stroke", description="The stroke shown in the panels below", default=0, min=0, override=OVERRIDABLE
    )
    metres_per_unit: bpy.props.FloatProperty(
        name="Metres per unit",
        description="Length of one scene unit in metres; 0 uses the scene's own unit scale",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
        override=OVERRIDABLE,
    )
    monitor_gain_db: bpy.props.FloatProperty(
        name="Monitor gain",
        description="Loudness of the preview on headphones in dB. Does not change exported files",
        default=0.0,
        min=-60.0,
        max=60.0,
        precision=1,
        override=OVERRIDABLE,
    )
    loop: bpy.props.BoolProperty(name="Loop", description="Repeat the stroke", default=False, override=OVERRIDABLE)
    follow_timeline: bpy.props.BoolProperty(
        name="Follow the timeline",
        description="Play each stroke at its frame while the timeline plays",
        default=True,
        override=OVERRIDABLE,
    )
    actuator: bpy.props.EnumProperty(
        name="Actuator",
        description="Actuator whose limits the preview compares the signal with",
        items=[
            *((name, profile.title, profile.source) for name, profile in PROFILES.items()),
            (USER_PROFILE_NAME, "My actuator", "A device of your own: enter what its data sheet says"),
            (PROFILE_FROM_FILE, "Measured actuator", "A profile in a .json file, made by measuring your actuator"),
        ],
        default=GENERIC.name,
        override=OVERRIDABLE,
    )
    actuator_file: bpy.props.StringProperty(
        name="Profile",
        description="File of the measured actuator's profile. Playback corrects for this actuator's response",
        default="",
        subtype="FILE_PATH",
        options=beside_the_file(),
        override=OVERRIDABLE,
    )
    own_peak_m_s2: bpy.props.FloatProperty(
        name="Largest acceleration",
        description="Largest acceleration of your actuator within its range, in m/s² (1 g is 9.81 m/s²); 0: not known",
        default=0.0,
        min=0.0,
        soft_max=100.0,
        precision=1,
        override=OVERRIDABLE,
    )
    own_lowest_hz: bpy.props.FloatProperty(
        name="Lowest frequency",
        description="Lowest frequency that your actuator is made for, in Hz",
        default=20.0,
        min=1.0,
        max=5000.0,
        precision=0,
        override=OVERRIDABLE,
    )
    own_highest_hz: bpy.props.FloatProperty(
        name="Highest frequency",
        description="Highest frequency that your actuator is made for, in Hz",
        default=1000.0,
        min=1.0,
        max=5000.0,
        precision=0,
        override=OVERRIDABLE,
    )
    live_pen_n: bpy.props.FloatProperty(
        name="Live force of the pen",
        description="Normal force in newtons at full pen pressure, while a live touch follows the pen",
        default=3.0,
        min=0.01,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=2,
        override=OVERRIDABLE,
    )
    live_mouse_n: bpy.props.FloatProperty(
        name="Live force of the mouse",
        description="Normal force in newtons while a live touch follows a mouse (no pressure)",
        default=1.0,
        min=0.01,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=2,
        override=OVERRIDABLE,
    )
    export_format: bpy.props.EnumProperty(
        name="Format", description="File format of exported strokes", items=FORMAT_ITEMS, override=OVERRIDABLE
    )
    export_folder: bpy.props.StringProperty(
        name="Folder",
        description="Folder that exports are written to",
        default="//touch",
        subtype="DIR_PATH",
        options=beside_the_file(),
        override=OVERRIDABLE,
    )


def register() -> None:
    register_pointer(bpy.types.Scene, "hnf", HnfScene)


def unregister() -> None:
    unregister_pointer(bpy.types.Scene, "hnf", HnfScene)


def get_actuator_profile(
    scene: Any, read_profile_file: Callable[[str], ActuatorProfile] = read_file_profile
) -> ActuatorProfile:
    """The scene's actuator; the generic one where its name is not known. in_file: how a file's profile is found."""
    settings = scene.hnf
    if settings.actuator == USER_PROFILE_NAME:
        return make_user_profile(settings.own_peak_m_s2, settings.own_lowest_hz, settings.own_highest_hz)
    if settings.actuator == PROFILE_FROM_FILE:
        return read_profile_file(bpy.path.abspath(settings.actuator_file))
    return PROFILES.get(settings.actuator, GENERIC)


def get_shown_profile(scene: Any) -> ActuatorProfile:
    """actuator_of() for panels: a file's profile as it was last read."""
    return get_actuator_profile(scene, get_cached_profile)


def list_strokes(scene: Any) -> list[Any]:
    """The scene's stroke objects, muted ones too, in the order of its objects."""
    return [obj for obj in scene.objects if obj.hnf_stroke.is_stroke]


def list_cached_strokes(scene: Any) -> list[Any]:
    """strokes_of(), remembered while Blender tells of no change: for panels and timers, which ask all the time. A
    script may make a stroke of which Blender tells nothing, so operators look anew."""
    return STROKES.list_objects(scene)


def has_strokes(scene: Any) -> bool:
    """For poll(): cheap where there are some; that there are none is believed for the time of a redraw."""
    return bool(STROKES.list_indexed(scene) or STROKES.list_indexed(scene, REDRAW_LIFETIME_S))


def find_stroke(scene: Any, name: str) -> Any:
    """The scene's stroke of this full name, which for a linked one names its file too; else of this name; or None."""
    strokes = list_strokes(scene)
    full = next((obj for obj in strokes if obj.name_full == name), None)
    return full if full is not None else next((obj for obj in strokes if obj.name == name), None)


def find_namesake(scene: Any, stroke: Any) -> Any:
    """Another stroke of the scene with this one's name, which one linked from another file may have; or None."""
    return next((obj for obj in list_cached_strokes(scene) if obj.name == stroke.name and obj != stroke), None)


def find_index(objects: Any, obj: Any) -> int:
    """Where obj is in a collection of objects; -1: nowhere. Its name alone may find another one's, linked or local."""
    at = int(objects.find(obj.name))
    if at < 0 or objects[at] == obj:
        return at
    return next((index for index, each in enumerate(objects) if each == obj), -1)


def get_active_stroke(context: Any) -> Any:
    """The stroke that panels and operators speak of, or None: the active object where it is one, else the one picked
    in the list, else the only one there is."""
    scene = context.scene
    active = context.view_layer.objects.active
    if active is not None and active.hnf_stroke.is_stroke:
        return active
    picked = get_object_at(scene.objects, scene.hnf.stroke_index)
    if picked is not None and picked.hnf_stroke.is_stroke:
        return picked
    strokes = list_cached_strokes(scene)
    return strokes[0] if len(strokes) == 1 else None
