"""Controller of the preview: requests signals for changed strokes, stores results, plays them and updates the panels.

`OutputRouter` is the player of the selected output: speakers, an actuator's process, or Blender's sound with limits
applied offline. `refresh` brings a stroke's signal up to date; `update_facts` turns it into text for the panels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hnf_core.errors import HnfError
from hnf_core.units import frame_to_seconds

from ..actuator.sound import Player, Sound
from ..props.scene_settings import get_actuator_profile
from ..state.addon_settings import finish_guide
from ..state.session_state import STATE
from ..touch.bake_status import Freshness
from ..translations import tr
from .preview_state import PREVIEW, PreviewFacts
from .sound_device import OfflinePlayer, Speakers, compute_clipping_db

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hnf_core.actuators.output_prediction import Levels
    from hnf_core.actuators.profile import ActuatorProfile

    from .stroke_image import ImageStyle, Theme
    from .synthesis_thread import PreviewResult


class OutputRouter:
    """Player that plays on the output selected at each `play` call; only one output sounds at a time."""

    def __init__(self) -> None:
        self._speakers = Speakers()
        self._playing: Player = self._speakers

    def play(self, sound: Sound) -> None:
        player = self._select_player()
        if player is not self._playing:
            self._playing.stop()
            self._playing = player
            if player is self._speakers:
                self._forget_live_problem()
        player.play(sound)

    def follow_pen(self, client: Player) -> None:
        """Make `client` the one that sounds, whatever output is selected: a live touch begins there."""
        self._playing.stop()
        self._playing = client

    def change(self, sound: Sound) -> None:
        if self._playing.is_playing and self._select_player() is self._playing:
            self._playing.change(sound)
        else:
            self.play(sound)

    def stop(self) -> None:
        self._playing.stop()

    def pause(self) -> None:
        self._playing.pause()

    def resume(self) -> None:
        self._playing.resume()

    def update(self) -> None:
        """Stop sounds that have faded out and start what waited for them; called by the timer."""
        self._speakers.update()

    @property
    def is_playing(self) -> bool:
        return self._playing.is_playing

    @property
    def is_sounding(self) -> bool:
        return self._playing.is_sounding

    @property
    def is_paused(self) -> bool:
        return self._playing.is_paused

    @property
    def position_s(self) -> float:
        return self._playing.position_s

    def use_shared_device(self, shared: bool) -> bool:
        """Share Blender's own sound device while the timeline plays; return True if speakers are selected."""
        from ..actuator.actuator_state import SPEAKERS, get_selected_output, needs_offline_player

        self._speakers.use_shared_device(shared)
        return get_selected_output() == SPEAKERS or needs_offline_player(get_selected_output())

    def release(self) -> None:
        self._playing.release()
        self._speakers.release()
        self._playing = self._speakers

    def _forget_live_problem(self) -> None:
        """Forget why a live touch ended: the speakers play something else."""
        from ..actuator.player_client import PLAYER_CLIENT

        PLAYER_CLIENT.problem = ""

    def _select_player(self) -> Player:
        from ..actuator.actuator_state import SPEAKERS, get_selected_output, needs_offline_player

        target = get_selected_output()
        if target == SPEAKERS:
            return self._speakers
        if needs_offline_player(target):
            return self._playing if isinstance(self._playing, OfflinePlayer) else OfflinePlayer(self._speakers)
        from ..actuator.player_client import PLAYER_CLIENT

        return PLAYER_CLIENT


PLAYER = OutputRouter()
MAX_CACHED_LEVELS = 16
"""Number of cached level results."""
_levels: dict[tuple[str, ActuatorProfile], Levels] = {}
"""Levels by the signal's stamp and actuator profile."""
INVALID_STATES = (Freshness.STALE, Freshness.BROKEN)
"""Freshness of bakes whose preview no longer holds."""


def refresh(obj: Any, context: Any, *, wait: bool, first: bool = True) -> PreviewResult | None:
    """Bring the signal of a stroke object up to date, or request it.

    Parameters
    ----------
    obj : bpy.types.Object
        Stroke object.
    context : bpy.types.Context
        Gives the scene and the image style.
    wait : bool
        Synthesize here and now; otherwise request it from the thread, and `collect_results` stores it.
    first : bool
        Synthesize it before all other requested strokes.

    Returns
    -------
    PreviewResult or None
        The signal; None if it is not there yet or cannot be made, for which `PREVIEW.problems` has the reason.
    """
    from .synthesis_thread import RenderCache, SynthesisThread, read_current_bake, synthesise_preview

    name, style = obj.name, get_image_style(context, obj.name)
    try:
        current = read_current_bake(obj, context.scene)
    except HnfError as error:
        _set_problem(name, str(error))
        return None
    if current is None:
        _set_problem(name, "Not baked yet.")
        PREVIEW.results.pop(name, None)
        return None
    PREVIEW.problems.pop(name, None)
    result = PREVIEW.results.get(name)
    if result is not None and (result.stamp, result.style) == (current.stamp, style):
        PREVIEW.requested[name] = current.stamp, style
        return result
    if wait:
        try:
            result = synthesise_preview(current, style, RenderCache())
        except HnfError as error:
            _set_problem(name, str(error))
            return None
        PREVIEW.requested[name] = result.stamp, result.style
        store_result(name, result)
        return result
    if PREVIEW.requested.get(name) != (current.stamp, style):
        PREVIEW.requested[name] = current.stamp, style
        if PREVIEW.synthesis_thread is None:
            PREVIEW.synthesis_thread = SynthesisThread()
        PREVIEW.synthesis_thread.request(current, style, first=first)
    return None


def store_result(name: str, result: PreviewResult) -> None:
    """Store a stroke's signal, forget why it had none, and update its icon."""
    PREVIEW.results[name] = result
    PREVIEW.requested.setdefault(name, (result.stamp, result.style))
    PREVIEW.problems.pop(name, None)
    _update_icon(name)


def _update_icon(name: str) -> None:
    """Use the image of the shown signal as the stroke's icon."""
    from ..state.interface import to_bytes

    shown = PREVIEW.get_shown(name)
    if shown is not None:
        PREVIEW.images[name] = to_bytes(shown.image)
        _draw_icon(name, shown.style.theme)


def _draw_icon(name: str, theme: Theme) -> None:
    from ..state.interface import set_icon
    from .stroke_image import draw_playhead

    pixels = draw_playhead(PREVIEW.images[name], PREVIEW.playheads.get(name), theme)
    PREVIEW.icons[name] = set_icon(f"stroke {name}", pixels)  # A touch query's image has a name without a stroke.


def update_playhead(obj: Any, scene: Any) -> bool:
    """Move the playhead of a stroke's image to the moment that is heard, else to the current frame.

    Only the line is drawn anew, and only where it moves by a pixel. Returns whether it did.
    """
    from .stroke_image import find_column

    name, shown = obj.name, PREVIEW.get_shown(obj.name)
    if shown is None or name not in PREVIEW.images:
        return False
    duration_s = max(shown.signal.duration_s, 1e-6)
    if PREVIEW.sounding == name and PLAYER.is_sounding:
        seconds = PLAYER.position_s % duration_s
    else:
        render, start = scene.render, float(obj.hnf_stroke.start)
        seconds = frame_to_seconds(float(scene.frame_current_final), start, float(render.fps), float(render.fps_base))
    fraction = seconds / duration_s if -1e-6 <= seconds <= duration_s + 1e-6 else None
    before = PREVIEW.playheads.get(name)
    if (None if fraction is None else find_column(fraction)) == (None if before is None else find_column(before)):
        return False
    PREVIEW.playheads[name] = fraction
    _draw_icon(name, shown.style.theme)
    return True


def collect_results() -> set[str]:
    """Store the signals and problems of the synthesis thread; return the names of the strokes with a new signal.

    A signal that nobody waits for any more is discarded, and so is the problem of an earlier request. A stroke that
    failed is not played either once it is ready.
    """
    if PREVIEW.synthesis_thread is None:
        return set()
    from .synthesis_thread import Failure

    stored = set()
    for name, outcome in PREVIEW.synthesis_thread.pop_results().items():
        if name not in PREVIEW.requested:
            continue
        if not isinstance(outcome, Failure):
            store_result(name, outcome)
            stored.add(name)
        elif PREVIEW.requested[name][0] == outcome.stamp:
            _set_problem(name, outcome.why)
            if PREVIEW.play_when_ready == name:
                PREVIEW.play_when_ready = ""
    return stored


def play(name: str, scene: Any) -> None:
    """Play a stroke's shown signal from its start. Raises HnfError without a device."""
    _start_sound(name, scene, PLAYER.play)


def continue_playback(name: str, scene: Any) -> None:
    """Continue the playing stroke with its shown signal. Raises HnfError without a device."""
    _start_sound(name, scene, PLAYER.change)


def _start_sound(name: str, scene: Any, start: Callable[[Sound], None]) -> None:
    shown = PREVIEW.get_shown(name)
    if shown is None:
        return
    PREVIEW.sounding = ""
    PREVIEW.sound_problem = ""
    try:
        start(make_sound(shown.signal.samples, shown.signal.sample_rate, scene, loop=bool(scene.hnf.loop)))
    except HnfError as error:
        PREVIEW.sound_problem = str(error)  # stays in the panel, where Blender's own message fades
        raise
    PREVIEW.sounding = name
    finish_guide()


def make_sound(samples: NDArray[np.float32], rate: float, scene: Any, *, loop: bool = False) -> Sound:
    """Make a sound from samples (n,) [m/s²] with the scene's actuator profile and monitor gain."""
    return Sound(samples, rate, get_actuator_profile(scene), loop, float(scene.hnf.monitor_gain_db))


def toggle_pause() -> None:
    """Pause the playing sound, or resume the paused one."""
    if PLAYER.is_paused:
        PLAYER.resume()
    else:
        PLAYER.pause()


def stop() -> None:
    PLAYER.stop()
    PREVIEW.sounding = PREVIEW.play_when_ready = ""


def toggle_ab(name: str) -> bool:
    """Switch between reference A (a signal that was kept) and the newest signal; return False without a reference."""
    if name not in PREVIEW.references:
        return False
    PREVIEW.showing_reference ^= {name}
    _update_icon(name)
    return True


def get_problem(name: str, scene: Any) -> str:
    """Return why a stroke's preview is not valid any more; "" if it is."""
    status = STATE.get_statuses(scene).get(name)
    if status is not None and status.freshness in INVALID_STATES:
        return status.why
    return PREVIEW.problems.get(name, "")


def update_facts(name: str, scene: Any) -> PreviewFacts:
    """Make and store what the panels show of a stroke's signal."""
    shown, profile = PREVIEW.get_shown(name), get_actuator_profile(scene)
    requested = PREVIEW.requested.get(name)
    newest = PREVIEW.results.get(name)
    busy = (
        requested is not None
        and (newest is None or (newest.stamp, newest.style) != requested)
        and not get_problem(name, scene)
    )
    common = {
        "shows": "A" if name in PREVIEW.showing_reference else "now",
        "has_kept": name in PREVIEW.references,
        "busy": busy,
        "playing": PREVIEW.sounding == name and PLAYER.is_playing,
        "paused": PREVIEW.sounding == name and PLAYER.is_paused,
        "problem": get_problem(name, scene),
    }
    if shown is None:
        facts = PreviewFacts(name, **common)  # type: ignore[arg-type]
    else:
        levels = compute_levels(shown, profile)
        facts = PreviewFacts(
            name, shown.signal.duration_s, levels.peak, levels.rms, levels.headroom_db, shown.confidence,
            lines=(*describe_signal(shown, profile, scene.hnf.monitor_gain_db), *describe_outdated_strips(name)),
            **common,  # type: ignore[arg-type]
        )  # fmt: skip
    PREVIEW.facts[name] = facts
    return facts


def describe_signal(shown: PreviewResult, profile: ActuatorProfile, gain_db: float) -> list[str]:
    """Return lines of text on a signal's level, headroom, energy outside the actuator's band, clipping, warnings."""
    levels = compute_levels(shown, profile)
    template = tr("{seconds} s; peak {peak} m/s², RMS {rms} m/s²")
    lines = [
        template.format(seconds=f"{shown.signal.duration_s:.2f}", peak=f"{levels.peak:.3g}", rms=f"{levels.rms:.3g}")
    ]
    title = tr(profile.title)
    if levels.headroom_db is not None and levels.peak > 0.0 and profile.peak_m_s2 is not None:
        limit = f"{title} ({profile.peak_m_s2:.3g} m/s²)"
        headroom_db = levels.headroom_db
        template = (
            tr("{room} dB too strong for {limit}") if headroom_db < 0.0 else tr("{room} dB below the limit of {limit}")
        )
        lines.append(template.format(room=f"{abs(headroom_db):.1f}", limit=limit))
    sides = (
        tr("{share} of its energy lies below {edge} Hz, outside the range of {actuator}"),
        tr("{share} of its energy lies above {edge} Hz, outside the range of {actuator}"),
    )
    outside = [
        template.format(share=f"{fraction:.0%}", edge=f"{edge:g}", actuator=title)
        for fraction, template, edge in zip(
            (levels.below_share, levels.above_share), sides, profile.range_hz or (), strict=False
        )
        if fraction is not None and fraction >= 0.01
    ]
    clipped = compute_clipping_db(levels.peak, gain_db)
    template = tr("The preview clips by {over} dB: lower the monitor gain. The signal is not clipped")
    clipping_lines = [template.format(over=f"{clipped:.1f}")] if clipped else []
    return [*lines, *outside, *clipping_lines, *shown.warnings]


def update_outdated_strips(obj: Any, scene: Any) -> None:
    """Store the names of the stroke's strips and speakers that play an earlier signal."""
    from .strips_and_speakers import find_outdated_strips

    requested = PREVIEW.requested.get(obj.name)
    PREVIEW.outdated[obj.name] = [] if requested is None else find_outdated_strips(obj, scene, requested[0])


def describe_outdated_strips(name: str) -> list[str]:
    template = tr("'{name}' still plays the sound from before the last change: add it again (Export)")
    return [template.format(name=strip) for strip in PREVIEW.outdated.get(name, ())]


def compute_levels(shown: PreviewResult, profile: ActuatorProfile) -> Levels:
    """Return cached levels of a signal on an actuator; the panels ask for them many times a second."""
    from hnf_core.actuators.output_prediction import compute_levels

    key = (shown.stamp, profile)
    if key not in _levels:
        while len(_levels) >= MAX_CACHED_LEVELS:
            del _levels[next(iter(_levels))]
        _levels[key] = compute_levels(shown.signal, profile)
    return _levels[key]


def get_image_style(context: Any, name: str) -> ImageStyle:
    """Return the style of a stroke's image; its ghost is the signal that was kept to compare with."""
    from .stroke_image import ImageStyle

    kept = PREVIEW.references.get(name)
    limit = get_actuator_profile(context.scene).peak_m_s2
    return ImageStyle(_get_theme(context), limit, logarithmic=True, ghost=None if kept is None else kept.as_ghost)


def _get_theme(context: Any) -> Theme:
    """Return the dark or light theme, whichever fits the text color of Blender's buttons."""
    from .stroke_image import DARK, LIGHT

    themes = context.preferences.themes
    text = themes[0].user_interface.wcol_regular.text if len(themes) else (1.0, 1.0, 1.0)
    return DARK if sum(text[:3]) / 3.0 > 0.5 else LIGHT


def _set_problem(name: str, why: str) -> None:
    PREVIEW.problems[name] = why
    PREVIEW.requested.pop(name, None)
