"""Export of a stroke's signal: to files, sequencer strips and speakers, with a sentence on what each file lost.

Only signals whose bake is still valid are exported; `get_current_signal` checks that.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hnf_core.errors import FileError, SceneError
from hnf_core.export.provenance import SourceStroke, read_source_stroke, write_source_sidecar
from hnf_core.export.wav import encode_wav
from hnf_core.files import write_bytes
from hnf_core.signal import Signal

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..props.scene_settings import CHOICE_BY_NAME, get_actuator_profile
from ..state.session_state import STATE
from ..touch.bake_status import Freshness
from ..translations import tr
from .preview_state import PREVIEW
from .sound_device import compute_monitor_gain
from .strips_and_speakers import find_linked_strips, iter_strips, mark_linked, mute_others

if TYPE_CHECKING:
    from hnf_core.export.convert import ExportResult
    from hnf_core.export.formats import Format
    from hnf_core.export.options import ExportOptions
    from hnf_core.metrics.spectra import BandChange

NEGLIGIBLE_DB = 0.05
"""Level changes below this are reported as no change [dB]; the message states the figure."""
QUIET_DB = 40.0
"""Bands this far below the loudest are not reported [dB]."""


def describe_loss(exported: ExportResult) -> str:
    """Describe how level, most changed octave and duration of an exported file differ from the stroke's."""
    name, loss = exported.path.name, exported.loss
    if loss.exact:
        return tr("{file}: nothing is lost").format(file=name)
    level_db = _level_change_db(loss.before.rms, loss.after.rms)
    worst = _find_most_changed(loss.bands)
    longer_ms = 1000.0 * (loss.after.duration_s - loss.before.duration_s)
    band_db = 0.0 if worst is None or worst.change_db is None else worst.change_db
    if max(abs(level_db), abs(band_db)) < NEGLIGIBLE_DB and abs(longer_ms) < 0.05:
        return tr("{file}: no octave changed by 0.05 dB").format(file=name)
    if worst is None:
        return tr("{file}: no signal is left").format(file=name)
    template = tr("{file}: level {level} dB, most changed {low:.0f}–{high:.0f} Hz {band} dB, duration {ms} ms")
    high = min(worst.high_hz, loss.before.sample_rate_hz / 2.0)
    change = {"level": _format_signed(level_db), "band": _format_signed(band_db), "ms": _format_signed(longer_ms)}
    return template.format(file=name, low=worst.low_hz, high=high, **change)


def _format_signed(value: float) -> str:
    return f"{value + 0.0:+.1f}".replace("-", "−")


def _find_most_changed(bands: tuple[BandChange, ...]) -> BandChange | None:
    loudest = max((max(band.before, band.after) for band in bands), default=0.0)
    audible = [
        band for band in bands if band.before > loudest * 10.0 ** (-QUIET_DB / 10.0) and band.change_db is not None
    ]
    return max(audible, key=lambda band: abs(band.change_db or 0.0), default=None)


def _level_change_db(before: float, after: float) -> float:
    return 20.0 * math.log10(after / before) if before > 0.0 and after > 0.0 else 0.0


def get_current_signal(obj: Any, context: Any) -> Signal:
    """Return the signal of a stroke as `hnf touch` would write it now.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    context : bpy.types.Context
        The scene's status is refreshed first.

    Raises
    ------
    SceneError
        If the stroke's bake is missing or stale.
    StrokeError
        If the stroke cannot be read.
    """
    from ..state.status_tracker import refresh_status
    from .stroke_image import ImageStyle
    from .synthesis_thread import RenderCache, read_current_bake, synthesise_preview

    name = get_scene_name(context.scene, obj)
    refresh_status(context.scene, [name], context.view_layer)
    status, location = STATE.get_status(context.scene, obj), f"stroke '{name}'"
    if status is None or status.freshness not in (Freshness.FRESH, Freshness.FORCE):
        reason = status.why if status is not None else "it is not in this scene."
        # The other reasons contain a remedy already.
        remedies = {Freshness.UNKNOWN: "Leave Edit Mode first.", Freshness.UNBAKED: "Bake it first."}
        remedy = "" if status is None else remedies.get(status.freshness, "")
        raise SceneError(reason.removeprefix(f"{location}: "), where=location, remedy=remedy)
    current = read_current_bake(obj, context.scene)
    if current is None:
        raise SceneError("it is not baked.", where=location, remedy="Bake it first.")
    result = PREVIEW.results.get(obj.name)
    if result is not None and (result.stamp, result.name) == (current.stamp, current.name):
        return result.signal
    return synthesise_preview(current, ImageStyle(), RenderCache()).signal


def _mark_linked(strip: Any, obj: Any, scene: Any) -> None:
    from .controller import update_outdated_strips
    from .synthesis_thread import read_current_bake

    current = read_current_bake(obj, scene)
    mark_linked(strip, obj, scene, "" if current is None else current.stamp)
    update_outdated_strips(obj, scene)


def get_export_folder(scene: Any) -> Path:
    """Return the scene's export folder.

    Raises FileError if none is set, or if it is relative to a .blend that is not saved yet.
    """
    import bpy

    text = str(scene.hnf.export_folder)
    if text.startswith("//") and not bpy.data.filepath:
        raise FileError(
            f"the export folder '{text}' is relative to this .blend, which is not saved yet.",
            where="export",
            remedy="Save the file (Ctrl S), or choose a folder in the Export panel.",
        )
    if not text:
        raise FileError("no export folder is set.", where="export", remedy="Choose one in the Export panel.")
    return Path(bpy.path.abspath(text))


def export_stroke(obj: Any, context: Any, format_name: str) -> ExportResult:
    """Write a stroke's signal into the export folder, never over another stroke's file or one of unknown origin.

    Full scale is the largest acceleration of the scene's actuator. Formats that can contain a surface get the touched
    surface with its baked result.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    context : bpy.types.Context
        Gives the scene and its export settings.
    format_name : str
        Name of the format, as in `props.scene_settings.CHOICE_BY_NAME`.

    Returns
    -------
    ExportResult
        Path and loss.

    Raises
    ------
    SceneError, StrokeError
        See `get_current_signal`.
    FileError
        If the format cannot hold the signal.
    """
    from hnf_core.export.convert import export_signal
    from hnf_core.export.formats import format_of

    signal, form, blend = get_current_signal(obj, context), format_of(format_name), _get_blend_name(obj)
    path = _find_free_path(
        get_export_folder(context.scene),
        SourceStroke(obj.name, blend),
        f"{CHOICE_BY_NAME[format_name].stem}{form.suffix}",
    )
    return export_signal(signal, form, path, _make_options(obj, context, form), blend)


def export_action(obj: Any, context: Any) -> Path:
    """Write a stroke's action as a table into the export folder, never over a file that is not its own.

    Returns the path. Raises HnfError.
    """
    from hnf_core.action.action import write_action_csv

    from ..bridge.scene.object_size import get_metres_per_unit
    from ..bridge.stroke.surface_export import read_touched_surface

    scene, depsgraph = context.scene, context.evaluated_depsgraph_get()
    action = read_touched_surface(scene, depsgraph, get_metres_per_unit(scene), stroke=obj).action
    if action is None:
        raise SceneError("it touches no object of this scene.", where=f"stroke '{obj.name}'")
    author = SourceStroke(obj.name, _get_blend_name(obj))
    path = _find_free_path(get_export_folder(scene), author, "-action.csv")
    write_action_csv(path, action)
    write_source_sidecar(path, "action", author)
    return path


def _get_blend_name(obj: Any) -> str:
    """Return the name of the .blend that `obj` is in; "" if it is not saved yet."""
    import bpy

    return Path(bpy.data.filepath if obj.library is None else bpy.path.abspath(obj.library.filepath)).name


def _find_free_path(folder: Path, author: SourceStroke, ending: str) -> Path:
    """Return the path for the stroke `author` in `folder`, which is free or holds an earlier file of that stroke.

    A file of another .blend adds this .blend's name to the path; a file of another stroke, or of unknown origin, adds
    a number.
    """
    from ..touch.output_files import iter_numbered_stems, make_file_stem

    stem = make_file_stem(author.stroke)
    existing = read_source_stroke(folder / f"{stem}{ending}")
    if existing is not None and existing.blend and existing.blend != author.blend:
        stem = f"{stem}-{make_file_stem(Path(author.blend).stem) if author.blend else 'unsaved'}"
    paths = (folder / f"{numbered_stem}{ending}" for numbered_stem in iter_numbered_stems(stem))
    return next(path for path in paths if _is_free(path, author))


def _is_free(path: Path, author: SourceStroke) -> bool:
    source = read_source_stroke(path)
    return not path.exists() if source is None else source in (author, SourceStroke(author.stroke, ""))


def _make_options(obj: Any, context: Any, form: Format) -> ExportOptions:
    from hnf_core.export.options import DEFAULT_RANGE_HZ, ExportOptions

    from ..bridge.scene.object_size import get_metres_per_unit
    from ..bridge.stroke.surface_export import read_touched_surface

    profile, surface = get_actuator_profile(context.scene), None
    if form.surface:
        depsgraph = context.evaluated_depsgraph_get()
        surface = read_touched_surface(context.scene, depsgraph, get_metres_per_unit(context.scene), stroke=obj)
    return ExportOptions(
        profile.limits.full_scale_m_s2,
        profile.range_hz or DEFAULT_RANGE_HZ,
        surface=surface,
        full_scale_assumed=form.scaled and profile.assumes_full_scale,
    )


def add_strip(obj: Any, context: Any) -> Any:
    """Add a sound strip of the exported WAV at the stroke's start frame, replacing an earlier strip of the stroke.

    Its volume is the monitor gain.
    """
    import bpy

    from ..compat import sequencer_strips, show_in_sequencer

    path, scene = export_stroke(obj, context, "wav").path, context.scene
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = sequencer_strips(editor)
    holders = [(strip, holder) for strip, holder, _ in iter_strips(scene)]
    linked_strips = find_linked_strips(obj, scene, [strip for strip, _ in holders])
    previous_strips = [(strip, holder) for strip, holder in holders if strip in linked_strips]
    top_channel = max((int(strip.channel) for strip in strips), default=0) + 1
    sound_path = bpy.path.relpath(str(path)) if scene.hnf.export_folder.startswith("//") else str(path)
    frame = round(float(obj.hnf_stroke.start))
    try:
        strip = strips.new_sound(name=obj.name, filepath=sound_path, channel=top_channel, frame_start=frame)
    except RuntimeError as error:
        raise SceneError(
            f"Blender made no sound strip ({str(error).strip()}).",
            where=f"stroke '{obj.name}'",
            remedy=f"Its WAV is written: {path}.",
        ) from error
    channel = next((int(previous.channel) for previous, holder in previous_strips if holder == strips), top_channel)
    for previous, holder in previous_strips:
        holder.remove(previous)
    strip.channel, strip.name = channel, obj.name
    _mark_linked(strip, obj, scene)
    strip.volume = compute_monitor_gain(scene.hnf.monitor_gain_db)
    mute_others(obj, scene, strip)
    show_in_sequencer(getattr(context, "workspace", None), scene)
    return strip


def add_stroke_speaker(obj: Any, context: Any) -> Any:
    """Add a speaker that moves with the touched surface at the stroke's start, replacing an earlier one.

    Its sound is packed into the .blend. Works in Object Mode only. A speaker's volume is at most 1, so that a monitor
    gain above it raises the packed samples.
    """
    import bpy

    from ..bridge.scene.object_size import get_metres_per_unit
    from ..bridge.stroke.read_stroke import sample_timeline
    from ..touch.output_files import make_file_stem
    from .strips_and_speakers import add_speaker

    signal, scene = get_current_signal(obj, context), context.scene
    scale = get_metres_per_unit(scene)
    timeline = sample_timeline(obj, scene, scale)
    position = timeline.arc.point_at(timeline.position[:1])[0] / scale
    gain = compute_monitor_gain(scene.hnf.monitor_gain_db)
    if gain > 1.0:
        signal = replace(signal, samples=signal.samples * np.float32(gain))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{make_file_stem(obj.name)}.wav"
        write_bytes(path, encode_wav(signal, where=f"stroke '{obj.name}'"))
        sound = bpy.data.sounds.load(str(path), check_existing=False)
        sound.pack()
    for previous in find_linked_strips(
        obj, scene, [candidate for candidate in scene.objects if candidate.type == "SPEAKER"]
    ):
        data = previous.data
        bpy.data.objects.remove(previous)
        if data.users == 0:
            bpy.data.speakers.remove(data)
    surface = find_object(scene, STATE.get_statuses(scene)[get_scene_name(scene, obj)].object_name)
    speaker = add_speaker(sound, f"{obj.name} speaker", tuple(position), float(obj.hnf_stroke.start), surface)
    _mark_linked(speaker, obj, scene)
    speaker.data.volume = min(gain, 1.0)
    mute_others(obj, scene, speaker)
    return speaker
