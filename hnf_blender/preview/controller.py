"""The player that the artist chose: speakers, an actuator, or a sound card with an actuator behind it where nothing but
Blender's own sound is there.

The preview at work: asks for signals when strokes change, takes them when they are there, tells the panels.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..actuator.sound import Player, Sound
from ..props.scene_settings import get_actuator_profile
from ..state.session_state import STATE
from ..touch.freshness import Freshness
from ..translations import tr
from .preview_state import PREVIEW, PreviewFacts
from .sound_device import Speakers, compute_clipping_db

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hnf_core.actuators.output_prediction import Levels
    from hnf_core.actuators.profile import ActuatorProfile

    from .stroke_image import ImageStyle, Theme
    from .synthesis_thread import PreviewResult


class OutputRouter:
    """A Player that asks at every play() which output is chosen. Only one of them sounds."""

    def __init__(self) -> None:
        self._speakers = Speakers()
        self._playing: Player = self._speakers

    def play(self, sound: Sound) -> None:
        wanted = self._select_player()
        if wanted is not self._playing:
            self._playing.stop()
            self._playing = wanted
        wanted.play(sound)

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
        """Called now and then: what has faded out ends, and what waited for that begins."""
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
        """The timeline begins or ends to play: speakers sound on Blender's own device meanwhile. True where they are
        what is chosen."""
        from ..actuator.actuator_state import SPEAKERS, get_selected_output, needs_offline_player

        self._speakers.use_shared_device(shared)
        return get_selected_output() == SPEAKERS or needs_offline_player(get_selected_output())

    def release(self) -> None:
        self._playing.release()
        self._speakers.release()
        self._playing = self._speakers

    def _select_player(self) -> Player:
        from ..actuator.actuator_state import SPEAKERS, get_selected_output, needs_offline_player

        target = get_selected_output()
        if target == SPEAKERS:
            return self._speakers
        if needs_offline_player(target):
            from .offline_player import OfflinePlayer

            return self._playing if isinstance(self._playing, OfflinePlayer) else OfflinePlayer(self._speakers)
        from ..actuator.player_client import PLAYER_CLIENT

        return PLAYER_CLIENT


PLAYER = OutputRouter()
MAX_CACHED_LEVELS = 16
_levels: dict[tuple[str, ActuatorProfile], Levels] = {}
INVALID_STATES = (Freshness.STALE, Freshness.BROKEN)


def refresh(obj: Any, context: Any, *, wait: bool, first: bool = True) -> PreviewResult | None:
    """Make sure that the signal of obj as it is now is there, or comes. wait: hear it here and now, and return it;
    else it is asked for (first: before all others), and collect() takes it. None where there is none;
    PREVIEW.problems then says why."""
    from hnf_core.errors import HnfError

    from .synthesis_thread import RenderCache, SynthesisThread, read_current_bake, synthesise_preview

    name, look = obj.name, get_image_style(context)
    try:
        now = read_current_bake(obj, context.scene)
    except HnfError as error:
        _set_problem(name, str(error))
        return None
    if now is None:
        _set_problem(name, "Not baked yet.")
        PREVIEW.results.pop(name, None)
        return None
    PREVIEW.problems.pop(name, None)
    heard = PREVIEW.results.get(name)
    if heard is not None and (heard.stamp, heard.style) == (now.stamp, look):
        PREVIEW.requested[name] = now.stamp, look
        return heard
    if wait:
        try:
            heard = synthesise_preview(now, look, RenderCache())
        except HnfError as error:
            _set_problem(name, str(error))
            return None
        store_result(name, heard)
        return heard
    if PREVIEW.requested.get(name) != (now.stamp, look):
        PREVIEW.requested[name] = now.stamp, look
        if PREVIEW.synthesis_thread is None:
            PREVIEW.synthesis_thread = SynthesisThread()
        PREVIEW.synthesis_thread.request(now, look, first=first)
    return None


def store_result(name: str, result: PreviewResult) -> None:
    """A signal is there."""
    PREVIEW.results[name] = result
    PREVIEW.requested[name] = result.stamp, result.style
    _update_icon(name)


def _update_icon(name: str) -> None:
    """The picture of what is heard of a stroke, as its icon."""
    from ..state.interface import set_icon

    shown = PREVIEW.get_shown(name)
    if shown is not None:
        PREVIEW.icons[name] = set_icon(f"stroke {name}", shown.image)  # the probe's picture has a name there too


def collect_results() -> set[str]:
    """Take what the listener has heard; names of the strokes it was."""
    if PREVIEW.synthesis_thread is None:
        return set()
    done = PREVIEW.synthesis_thread.pop_results()
    for name, outcome in done.items():
        if isinstance(outcome, str):
            _set_problem(name, outcome)
        else:
            store_result(name, outcome)
    return set(done)


def play(name: str, scene: Any) -> None:
    """Sound a stroke's shown signal from its start. Raises HnfError without a device."""
    _start_sound(name, scene, PLAYER.play)


def continue_playback(name: str, scene: Any) -> None:
    """A stroke that sounds goes on as it is shown now. Raises as play() does."""
    _start_sound(name, scene, PLAYER.change)


def _start_sound(name: str, scene: Any, start: Callable[[Sound], None]) -> None:
    shown = PREVIEW.get_shown(name)
    if shown is None:
        return
    PREVIEW.sounding = ""
    start(make_sound(shown.signal.samples, shown.signal.sample_rate, scene, loop=bool(scene.hnf.loop)))
    PREVIEW.sounding = name


def make_sound(samples: NDArray[np.float32], rate: float, scene: Any, *, loop: bool = False) -> Sound:
    """Samples (n,) m/s² as this scene plays them."""
    return Sound(samples, rate, get_actuator_profile(scene), loop, float(scene.hnf.monitor_gain_db))


def toggle_pause() -> None:
    """What sounds is held where it is, or what is held goes on."""
    if PLAYER.is_paused:
        PLAYER.resume()
    else:
        PLAYER.pause()


def stop() -> None:
    PLAYER.stop()
    PREVIEW.sounding = PREVIEW.play_when_ready = ""


def toggle_ab(name: str) -> bool:
    """Change between A and the newest; False where there is no A."""
    if name not in PREVIEW.references:
        return False
    PREVIEW.showing_reference ^= {name}
    _update_icon(name)
    return True


def get_problem(name: str, scene: Any) -> str:
    """Why the preview of a scene's stroke is not true, "" where it is."""
    status = STATE.get_statuses(scene).get(name)
    if status is not None and status.freshness in INVALID_STATES:
        return status.why
    return PREVIEW.problems.get(name, "")


def update_facts(name: str, scene: Any) -> PreviewFacts:
    """Facts of a stroke for the panels, made anew."""
    shown, profile = PREVIEW.get_shown(name), get_actuator_profile(scene)
    asked = PREVIEW.requested.get(name)
    newest = PREVIEW.results.get(name)
    busy = (
        asked is not None and (newest is None or (newest.stamp, newest.style) != asked) and not get_problem(name, scene)
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
    """A signal's figures, one line a thought."""
    levels = compute_levels(shown, profile)
    said = tr("{seconds} s; peak {peak} m/s², RMS {rms} m/s²")
    lines = [said.format(seconds=f"{shown.signal.duration_s:.2f}", peak=f"{levels.peak:.3g}", rms=f"{levels.rms:.3g}")]
    title = tr(profile.title)
    if levels.headroom_db is not None and levels.peak > 0.0 and profile.peak_m_s2 is not None:
        limit = f"{title} ({profile.peak_m_s2:.3g} m/s²)"
        room = levels.headroom_db
        said = tr("{room} dB too strong for {limit}") if room < 0.0 else tr("{room} dB below the limit of {limit}")
        lines.append(said.format(room=f"{abs(room):.1f}", limit=limit))
    sides = (
        tr("{share} of its energy lies below {edge} Hz, outside the range of {actuator}"),
        tr("{share} of its energy lies above {edge} Hz, outside the range of {actuator}"),
    )
    outside = [
        said.format(share=f"{share:.0%}", edge=f"{edge:g}", actuator=title)
        for share, said, edge in zip(
            (levels.below_share, levels.above_share), sides, profile.range_hz or (), strict=False
        )
        if share is not None and share >= 0.01
    ]
    clipped = compute_clipping_db(levels.peak, gain_db)
    said = tr("The preview clips by {over} dB: lower the monitor gain. The signal is not clipped")
    loud = [said.format(over=f"{clipped:.1f}")] if clipped else []
    return [*lines, *outside, *loud, *shown.warnings]


def update_outdated_strips(obj: Any, scene: Any) -> None:
    """Keep the names of the stroke's strips and speakers that sound as it was."""
    from .linked_strips import find_outdated_strips

    asked = PREVIEW.requested.get(obj.name)
    PREVIEW.outdated[obj.name] = [] if asked is None else find_outdated_strips(obj, scene, asked[0])


def describe_outdated_strips(name: str) -> list[str]:
    said = tr("'{name}' still plays the sound from before the last change: add it again (Export)")
    return [said.format(name=each) for each in PREVIEW.outdated.get(name, ())]


def compute_levels(shown: PreviewResult, profile: ActuatorProfile) -> Levels:
    """Computed once for a signal and an actuator: facts are told many times a second."""
    from hnf_core.actuators.output_prediction import compute_levels

    key = (shown.stamp, profile)
    if key not in _levels:
        while len(_levels) >= MAX_CACHED_LEVELS:
            del _levels[next(iter(_levels))]
        _levels[key] = compute_levels(shown.signal, profile)
    return _levels[key]


def get_image_style(context: Any) -> ImageStyle:
    from .stroke_image import ImageStyle

    return ImageStyle(_get_theme(context), get_actuator_profile(context.scene).peak_m_s2)


def _get_theme(context: Any) -> Theme:
    """Dark or light, by the text of Blender's own buttons."""
    from .stroke_image import DARK, LIGHT

    themes = context.preferences.themes
    text = themes[0].user_interface.wcol_regular.text if len(themes) else (1.0, 1.0, 1.0)
    return DARK if sum(text[:3]) / 3.0 > 0.5 else LIGHT


def _set_problem(name: str, why: str) -> None:
    PREVIEW.problems[name] = why
    PREVIEW.requested.pop(name, None)
