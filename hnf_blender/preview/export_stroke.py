"""What an export cost, in a sentence of the artist's language.

A stroke's signal on its way out: to files, to the sequencer, to a speaker. Only what is true leaves.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hnf_core.errors import FileError, SceneError
from hnf_core.export.provenance import SourceStroke, read_source_stroke
from hnf_core.export.wav import encode_wav
from hnf_core.files import write_bytes
from hnf_core.signal import Signal

from ..bridge.scene.scene_names import find_object, get_scene_name
from ..props.scene_settings import CHOICE_BY_NAME, get_actuator_profile
from ..state.session_state import STATE
from ..touch.freshness import Freshness
from ..translations import tr
from .linked_strips import find_linked_strips, mark_linked
from .preview_state import PREVIEW
from .sound_device import compute_monitor_gain

if TYPE_CHECKING:
    from hnf_core.export.convert import ExportResult
    from hnf_core.export.formats import Format
    from hnf_core.export.options import ExportOptions
    from hnf_core.metrics.band_energy import BandChange

NEGLIGIBLE_DB = 0.05
"""Changes below it are told as none, in these very figures."""
QUIET_DB = 40.0
"""Bands this far below the loudest are nothing to tell of."""


def describe_loss(exported: ExportResult) -> str:
    """Of one file: how its level, its most changed octave and its duration differ from the stroke's."""
    name, loss = exported.path.name, exported.loss
    if loss.exact:
        return tr("{file}: nothing is lost").format(file=name)
    level = _level_change_db(loss.before.rms, loss.after.rms)
    worst = _find_most_changed(loss.bands)
    longer = 1000.0 * (loss.after.duration_s - loss.before.duration_s)
    band_db = 0.0 if worst is None or worst.change_db is None else worst.change_db
    if max(abs(level), abs(band_db)) < NEGLIGIBLE_DB and abs(longer) < 0.05:
        return tr("{file}: no octave changed by 0.05 dB").format(file=name)
    if worst is None:
        return tr("{file}: no signal is left").format(file=name)
    said = tr("{file}: level {level} dB, most changed {low:.0f}–{high:.0f} Hz {band} dB, duration {ms} ms")
    high = min(worst.high_hz, loss.before.sample_rate_hz / 2.0)
    change = {"level": _format_signed(level), "band": _format_signed(band_db), "ms": _format_signed(longer)}
    return said.format(file=name, low=worst.low_hz, high=high, **change)


def _format_signed(value: float) -> str:
    return f"{value + 0.0:+.1f}".replace("-", "−")


def _find_most_changed(bands: tuple[BandChange, ...]) -> BandChange | None:
    loudest = max((max(band.before, band.after) for band in bands), default=0.0)
    heard = [
        band for band in bands if band.before > loudest * 10.0 ** (-QUIET_DB / 10.0) and band.change_db is not None
    ]
    return max(heard, key=lambda band: abs(band.change_db or 0.0), default=None)


def _level_change_db(before: float, after: float) -> float:
    return 20.0 * math.log10(after / before) if before > 0.0 and after > 0.0 else 0.0


def get_current_signal(obj: Any, context: Any) -> Signal:
    """The signal of a stroke as `hnf touch` would write it now.

    Looks at the scene anew. Raises SceneError naming the stroke where its bake does not hold, StrokeError where it
    cannot be read.
    """
    from ..state.status_tracker import refresh_status
    from .stroke_image import ImageStyle
    from .synthesis_thread import RenderCache, read_current_bake, synthesise_preview

    name = get_scene_name(context.scene, obj)
    refresh_status(context.scene, [name], context.view_layer)
    status, where = STATE.get_status(context.scene, obj), f"stroke '{name}'"
    if status is None or status.freshness not in (Freshness.FRESH, Freshness.FORCE):
        why = status.why if status is not None else "it is not in this scene."
        # Other reasons say what to do.
        remedies = {Freshness.UNKNOWN: "Leave Edit Mode first.", Freshness.UNBAKED: "Bake it first."}
        remedy = "" if status is None else remedies.get(status.freshness, "")
        raise SceneError(why.removeprefix(f"{where}: "), where=where, remedy=remedy)
    now = read_current_bake(obj, context.scene)
    if now is None:
        raise SceneError("it is not baked.", where=where, remedy="Bake it first.")
    heard = PREVIEW.results.get(obj.name)
    if heard is not None and (heard.stamp, heard.name) == (now.stamp, now.name):
        return heard.signal
    return synthesise_preview(now, ImageStyle(), RenderCache()).signal


def _mark_linked(strip: Any, obj: Any, scene: Any) -> None:
    from .controller import update_outdated_strips
    from .synthesis_thread import read_current_bake

    now = read_current_bake(obj, scene)
    mark_linked(strip, obj, scene, "" if now is None else now.stamp)
    update_outdated_strips(obj, scene)


def get_export_folder(scene: Any) -> Path:
    """Where Scene.hnf says. Raises FileError where it is beside a file that is not saved yet."""
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
    """Write a stroke into the export folder in the format called word, in no other stroke's place; say what that cost.

    1 stands for the largest acceleration of the scene's actuator. Formats that have a place for a surface get it with
    what is baked on it. Raises SceneError and StrokeError as true_signal does, FileError where the format cannot hold
    the signal.
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


def _get_blend_name(obj: Any) -> str:
    """Name of the .blend that obj is in; "" where it is not saved yet."""
    import bpy

    return Path(bpy.data.filepath if obj.library is None else bpy.path.abspath(obj.library.filepath)).name


def _find_free_path(folder: Path, author: SourceStroke, ending: str) -> Path:
    """The file of maker's stroke in folder. Where another's is in its place, that one stays: another .blend's by this
    one's name put into ours, another stroke's by a number."""
    from ..touch.output_files import iter_numbered_stems, make_file_stem

    stem = make_file_stem(author.stroke)
    there = read_source_stroke(folder / f"{stem}{ending}")
    if there is not None and there.blend and there.blend != author.blend:
        stem = f"{stem}-{make_file_stem(Path(author.blend).stem) if author.blend else 'unsaved'}"
    paths = (folder / f"{each}{ending}" for each in iter_numbered_stems(stem))
    return next(path for path in paths if read_source_stroke(path) in (None, author, SourceStroke(author.stroke, "")))


def _make_options(obj: Any, context: Any, form: Format) -> ExportOptions:
    from hnf_core.export.options import DEFAULT_RANGE_HZ, ExportOptions

    from ..bridge.scene.unit_scale import get_metres_per_unit
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
    """A sound strip of the stroke at its start frame, its volume as the monitor's; in place of an earlier one of the
    same stroke. Its file is the exported WAV."""
    import bpy

    from ..compat import sequencer_strips, show_in_sequencer

    path, scene = export_stroke(obj, context, "wav").path, context.scene
    editor = scene.sequence_editor or scene.sequence_editor_create()
    strips = sequencer_strips(editor)
    earlier = find_linked_strips(obj, scene, strips)
    above = max((int(strip.channel) for strip in strips), default=0) + 1
    sound_path = bpy.path.relpath(str(path)) if scene.hnf.export_folder.startswith("//") else str(path)
    frame = round(float(obj.hnf_stroke.start))
    try:
        strip = strips.new_sound(name=obj.name, filepath=sound_path, channel=above, frame_start=frame)
    except RuntimeError as error:
        raise SceneError(
            f"Blender made no sound strip ({str(error).strip()}).",
            where=f"stroke '{obj.name}'",
            remedy=f"Its WAV is written: {path}.",
        ) from error
    channel = next((int(each.channel) for each in earlier), above)
    for each in earlier:
        strips.remove(each)
    strip.channel, strip.name = channel, obj.name
    _mark_linked(strip, obj, scene)
    strip.volume = compute_monitor_gain(scene.hnf.monitor_gain_db)
    show_in_sequencer(getattr(context, "workspace", None), scene)
    return strip


def add_stroke_speaker(obj: Any, context: Any) -> Any:
    """A Speaker where the stroke begins, moving with its surface, its sound packed into the .blend; in place of an
    earlier one of the same stroke. Object Mode only."""
    import bpy

    from ..bridge.scene.speakers import add_speaker
    from ..bridge.scene.unit_scale import get_metres_per_unit
    from ..bridge.stroke.read_stroke import sample_timeline
    from ..touch.output_files import make_file_stem

    signal, scene = get_current_signal(obj, context), context.scene
    scale = get_metres_per_unit(scene)
    timeline = sample_timeline(obj, scene, scale)
    place = timeline.arc.point_at(timeline.position[:1])[0] / scale
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{make_file_stem(obj.name)}.wav"
        write_bytes(path, encode_wav(signal, where=f"stroke '{obj.name}'"))
        sound = bpy.data.sounds.load(str(path), check_existing=False)
        sound.pack()
    for other in find_linked_strips(obj, scene, [each for each in scene.objects if each.type == "SPEAKER"]):
        data = other.data
        bpy.data.objects.remove(other)
        if data.users == 0:
            bpy.data.speakers.remove(data)
    surface = find_object(scene, STATE.get_statuses(scene)[get_scene_name(scene, obj)].object_name)
    speaker = add_speaker(sound, f"{obj.name} speaker", tuple(place), float(obj.hnf_stroke.start), surface)
    _mark_linked(speaker, obj, scene)
    speaker.data.volume = min(compute_monitor_gain(scene.hnf.monitor_gain_db), 1.0)
    return speaker
