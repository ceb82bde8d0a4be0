"""Property group Scene.hnf: settings of the Touch tab, with the export formats and actuator profiles to choose from.

Also here: queries for a scene's strokes and its actuator profile. The formats are implemented in
`hnf_core.export.formats`; a profile file is what `hnf actuators measure` writes.
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
    """Export format as the user chooses it in the Export panel.

    Attributes
    ----------
    format_name : str
        Key of `hnf_core.export.formats.FORMATS`.
    label, description : str
        Text of the menu item.
    scaled : bool
        Whether values are fractions of the actuator's full scale.
    stem : str
        Added to the file name if another format has the same suffix.
    """

    format_name: str
    label: str
    description: str
    scaled: bool = True
    stem: str = ""


FORMAT_CHOICES = (
    FormatChoice("wav", "WAV in m/s²", "10 kHz, 32-bit float, never normalized: nothing is lost", scaled=False),
    FormatChoice("wav8k", "WAV 8 kHz", "16 bit, for an actuator; 1 is the actuator's largest acceleration", stem="-8k"),
    FormatChoice("wav48k", "WAV 48 kHz", "16 bit, for a sound card and an amplifier; 1 is the largest acceleration",
                 stem="-48k"),
    FormatChoice("listen", "WAV to Listen To", "48 kHz, 16 bit, as loud as it goes without clipping: for ears, not for "
                 "an actuator", scaled=False, stem="-listen"),
    FormatChoice("haptic", ".haptic (Meta)", "Strength and frequency over time, for Meta Haptics; no waveform"),
    FormatChoice("ahap", ".ahap (Apple)", "Strength and sharpness over time, for iPhones; no waveform"),
    FormatChoice("android", "Android Waveform", "Strength over time, for VibrationEffect.createWaveform; no waveform",
                 stem="-android"),
    FormatChoice("android-xml", "Android 16 Envelope", "Intensity and sharpness over time, as Android's XML; no "
                 "waveform",
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
"""Value of Scene.hnf.actuator for a profile read from Scene.hnf.actuator_file."""
CHECK_INTERVAL_S = 2.0
"""Interval at which the profile file is checked for changes [s]; timers query it far more often."""

_profiles: dict[str, ActuatorProfile] = {}
"""Profiles by path."""


def read_file_profile(path: str) -> ActuatorProfile:
    """Read an actuator profile file; its path becomes the profile's name, by which the player reads it again.

    If it cannot be read, the profile is empty, `source` is the reason, and the player refuses it.
    """
    _profiles[path] = _read_profile(path, _read_mtime(path, int(time.monotonic() / CHECK_INTERVAL_S)))
    return _profiles[path]


def get_cached_profile(path: str) -> ActuatorProfile:
    """Return the actuator profile as `read_file_profile` last read it, without access to the disk; for panels."""
    return _profiles.get(path) or ActuatorProfile(path, _make_title(path), tr("Not read yet"))


@lru_cache(maxsize=4)
def _read_mtime(path: str, _when: int) -> int:
    try:
        return os.stat(path).st_mtime_ns
    except OSError:
        return 0


@lru_cache(maxsize=4)
def _read_profile(path: str, _mtime: int) -> ActuatorProfile:
    from hnf_core.actuators.profile import read_profile

    try:
        if not path.lower().endswith(".json"):
            raise FileError("no profile is chosen.", remedy="Choose the .json file that measuring your actuator gave.")
        return replace(read_profile(Path(path)), name=path, response=None)
    except HnfError as error:
        return ActuatorProfile(path, _make_title(path), str(error))


def _make_title(path: str) -> str:
    return Path(path).name or tr("Measured Actuator")


class HnfScene(bpy.types.PropertyGroup):  # type: ignore[misc]  # bpy has no types
    stroke_index: bpy.props.IntProperty(
        name="Active Stroke", description="The stroke shown in the panels below", default=0, min=0, override=OVERRIDABLE
    )
    metres_per_unit: bpy.props.FloatProperty(
        name="Meters per Unit",
        description="Length of one scene unit in meters; 0 uses the scene's own unit scale",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
        override=OVERRIDABLE,
    )
    monitor_gain_db: bpy.props.FloatProperty(
        name="Monitor Gain",
        description="Loudness of the preview on headphones in dB. Does not change exported files",
        default=0.0,
        min=-60.0,
        max=60.0,
        precision=1,
        override=OVERRIDABLE,
    )
    loop: bpy.props.BoolProperty(name="Loop", description="Repeat the stroke", default=False, override=OVERRIDABLE)
    follow_timeline: bpy.props.BoolProperty(
        name="Follow Timeline",
        description="Play each stroke at its frame while the timeline plays",
        default=True,
        override=OVERRIDABLE,
    )
    actuator: bpy.props.EnumProperty(
        name="Actuator",
        description="Actuator whose limits the preview compares the signal with",
        items=[
            *((name, profile.title, profile.source) for name, profile in PROFILES.items()),
            (USER_PROFILE_NAME, "My Actuator", "A device of your own: enter what its data sheet says"),
            (PROFILE_FROM_FILE, "Measured Actuator", "A profile in a .json file, made by measuring your actuator"),
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
        name="Largest Acceleration",
        description="Largest acceleration of your actuator within its range, in m/s² (1 g is 9.81 m/s²); 0: not known",
        default=0.0,
        min=0.0,
        soft_max=100.0,
        precision=1,
        override=OVERRIDABLE,
    )
    own_lowest_hz: bpy.props.FloatProperty(
        name="Lowest Frequency",
        description="Lowest frequency that your actuator is made for, in Hz",
        default=20.0,
        min=1.0,
        max=5000.0,
        precision=0,
        override=OVERRIDABLE,
    )
    own_highest_hz: bpy.props.FloatProperty(
        name="Highest Frequency",
        description="Highest frequency that your actuator is made for, in Hz",
        default=1000.0,
        min=1.0,
        max=5000.0,
        precision=0,
        override=OVERRIDABLE,
    )
    live_pen_n: bpy.props.FloatProperty(
        name="Live Force of the Pen",
        description="Normal force in newtons at full pen pressure, while a live touch follows the pen",
        default=3.0,
        min=0.01,
        max=FORCE_MAX_N,
        soft_max=5.0,
        precision=2,
        override=OVERRIDABLE,
    )
    live_mouse_n: bpy.props.FloatProperty(
        name="Live Force of the Mouse",
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
    """Return the actuator profile of a scene; the generic one if the name is unknown.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene with the setting.
    read_profile_file : callable
        Returns the profile of a file, given its path.
    """
    settings = scene.hnf
    if settings.actuator == USER_PROFILE_NAME:
        return make_user_profile(settings.own_peak_m_s2, settings.own_lowest_hz, settings.own_highest_hz)
    if settings.actuator == PROFILE_FROM_FILE:
        return read_profile_file(bpy.path.abspath(settings.actuator_file))
    return PROFILES.get(settings.actuator, GENERIC)


def get_shown_profile(scene: Any) -> ActuatorProfile:
    """Return the scene's actuator profile without access to the disk; for panels."""
    return get_actuator_profile(scene, get_cached_profile)


def list_strokes(scene: Any) -> list[Any]:
    """Return the scene's stroke objects, including muted ones, in the order of its objects."""
    return [obj for obj in scene.objects if obj.hnf_stroke.is_stroke]


def list_cached_strokes(scene: Any) -> list[Any]:
    """Return the scene's stroke objects from the cache; for panels and timers.

    Operators use `list_strokes`, since a script can make a stroke without a notification by Blender.
    """
    return STROKES.list_objects(scene)


def has_strokes(scene: Any) -> bool:
    """Return whether the scene has strokes; cheap enough for poll(). A negative result is cached for one redraw."""
    return bool(STROKES.list_indexed(scene) or STROKES.list_indexed(scene, REDRAW_LIFETIME_S))


def find_stroke(scene: Any, name: str) -> Any:
    """Return the scene's stroke with this full name (which includes a library's file), else with this name, or None."""
    strokes = list_strokes(scene)
    match = next((obj for obj in strokes if obj.name_full == name), None)
    return match if match is not None else next((obj for obj in strokes if obj.name == name), None)


def find_namesake(scene: Any, stroke: Any) -> Any:
    """Return another stroke of the scene with the same name, as a linked one may have, or None."""
    return next((obj for obj in list_cached_strokes(scene) if obj.name == stroke.name and obj != stroke), None)


def find_index(objects: Any, obj: Any) -> int:
    """Return the index of the very object `obj` in a collection, or −1.

    It is compared by identity, as a linked and a local object may share the name.
    """
    position = int(objects.find(obj.name))
    if position < 0 or objects[position] == obj:
        return position
    return next((index for index, candidate in enumerate(objects) if candidate == obj), -1)


def get_active_stroke(context: Any) -> Any:
    """Return the stroke that panels and operators refer to, or None.

    It is the active object if that is a stroke, else the stroke selected in the list, else the scene's only stroke.
    """
    scene = context.scene
    active = context.view_layer.objects.active
    if active is not None and active.hnf_stroke.is_stroke:
        return active
    listed = get_object_at(scene.objects, scene.hnf.stroke_index)
    if listed is not None and listed.hnf_stroke.is_stroke:
        return listed
    strokes = list_cached_strokes(scene)
    return strokes[0] if len(strokes) == 1 else None
