"""The preview at work: asks for signals when strokes change, takes them when they are there, tells the panels."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..actuator.sound import Sound
from ..props.scene import actuator_of
from ..state.session import STATE
from ..touch.status import Freshness
from ..translations import tr
from .facts import PREVIEW, PreviewFacts
from .outputs import Outputs

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hnf_core.actuators.levels import Levels
    from hnf_core.actuators.profile import ActuatorProfile

    from .hearing import Heard
    from .pictures import Look, Theme

PLAYER = Outputs()
KEPT_LEVELS = 16
_levels: dict[tuple[str, ActuatorProfile], Levels] = {}
NOT_TRUE = (Freshness.STALE, Freshness.BROKEN)


def refresh(obj: Any, context: Any, *, wait: bool, first: bool = True) -> Heard | None:
    """Make sure that the signal of obj as it is now is there, or comes. wait: hear it here and now, and return it;
    else it is asked for (first: before all others), and collect() takes it. None where there is none;
    PREVIEW.problems then says why."""
    from hnf_core.errors import HnfError

    from .hearing import Kept, Listener, hear
    from .present import present

    name, look = obj.name, look_of(context)
    try:
        now = present(obj, context.scene)
    except HnfError as error:
        _cannot(name, str(error))
        return None
    if now is None:
        _cannot(name, "Not baked yet.")
        PREVIEW.heard.pop(name, None)
        return None
    PREVIEW.problems.pop(name, None)
    heard = PREVIEW.heard.get(name)
    if heard is not None and (heard.stamp, heard.look) == (now.stamp, look):
        PREVIEW.asked[name] = now.stamp, look
        return heard
    if wait:
        try:
            heard = hear(now, look, Kept())
        except HnfError as error:
            _cannot(name, str(error))
            return None
        take(name, heard)
        return heard
    if PREVIEW.asked.get(name) != (now.stamp, look):
        PREVIEW.asked[name] = now.stamp, look
        if PREVIEW.listener is None:
            PREVIEW.listener = Listener()
        PREVIEW.listener.ask(now, look, first=first)
    return None


def take(name: str, heard: Heard) -> None:
    """A signal is there."""
    PREVIEW.heard[name] = heard
    PREVIEW.asked[name] = heard.stamp, heard.look
    _show(name)


def _show(name: str) -> None:
    """The picture of what is heard of a stroke, as its icon."""
    from ..state.icons import show

    shown = PREVIEW.shown(name)
    if shown is not None:
        PREVIEW.icons[name] = show(f"stroke {name}", shown.picture)  # the probe's picture has a name there too


def collect() -> set[str]:
    """Take what the listener has heard; names of the strokes it was."""
    if PREVIEW.listener is None:
        return set()
    done = PREVIEW.listener.take()
    for name, outcome in done.items():
        if isinstance(outcome, str):
            _cannot(name, outcome)
        else:
            take(name, outcome)
    return set(done)


def play(name: str, scene: Any) -> None:
    """Sound a stroke's shown signal from its start. Raises HnfError without a device."""
    _sound(name, scene, PLAYER.play)


def go_on(name: str, scene: Any) -> None:
    """A stroke that sounds goes on as it is shown now. Raises as play() does."""
    _sound(name, scene, PLAYER.change)


def _sound(name: str, scene: Any, begin: Callable[[Sound], None]) -> None:
    shown = PREVIEW.shown(name)
    if shown is None:
        return
    PREVIEW.sounding = ""
    begin(sound_of(shown.signal.samples, shown.signal.sample_rate, scene, loop=bool(scene.hnf.loop)))
    PREVIEW.sounding = name


def sound_of(samples: NDArray[np.float32], rate: float, scene: Any, *, loop: bool = False) -> Sound:
    """Samples (n,) m/s² as this scene plays them."""
    return Sound(samples, rate, actuator_of(scene), loop, float(scene.hnf.monitor_gain_db))


def pause_or_go_on() -> None:
    """What sounds is held where it is, or what is held goes on."""
    if PLAYER.is_paused:
        PLAYER.resume()
    else:
        PLAYER.pause()


def stop() -> None:
    PLAYER.stop()
    PREVIEW.sounding = PREVIEW.play_when_ready = ""


def switch_kept(name: str) -> bool:
    """Change between A and the newest; False where there is no A."""
    if name not in PREVIEW.kept:
        return False
    PREVIEW.on_kept ^= {name}
    _show(name)
    return True


def problem_of(name: str, scene: Any) -> str:
    """Why the preview of a scene's stroke is not true, "" where it is."""
    status = STATE.strokes_in(scene).get(name)
    if status is not None and status.freshness in NOT_TRUE:
        return status.why
    return PREVIEW.problems.get(name, "")


def tell(name: str, scene: Any) -> PreviewFacts:
    """Facts of a stroke for the panels, made anew."""
    shown, profile = PREVIEW.shown(name), actuator_of(scene)
    asked = PREVIEW.asked.get(name)
    newest = PREVIEW.heard.get(name)
    busy = (
        asked is not None and (newest is None or (newest.stamp, newest.look) != asked) and not problem_of(name, scene)
    )
    common = {
        "shows": "A" if name in PREVIEW.on_kept else "now",
        "has_kept": name in PREVIEW.kept,
        "busy": busy,
        "playing": PREVIEW.sounding == name and PLAYER.is_playing,
        "paused": PREVIEW.sounding == name and PLAYER.is_paused,
        "problem": problem_of(name, scene),
    }
    if shown is None:
        facts = PreviewFacts(name, **common)  # type: ignore[arg-type]
    else:
        levels = levels_against(shown, profile)
        facts = PreviewFacts(
            name, shown.signal.duration_s, levels.peak, levels.rms, levels.headroom_db, shown.confidence,
            lines=(*words(shown, profile, scene.hnf.monitor_gain_db), *behind_words(name)), **common,  # type: ignore[arg-type]
        )  # fmt: skip
    PREVIEW.facts[name] = facts
    return facts


def words(shown: Heard, profile: ActuatorProfile, gain_db: float) -> list[str]:
    """A signal's figures, one line a thought."""
    from .monitor import clips_by_db

    levels = levels_against(shown, profile)
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
    clipped = clips_by_db(levels.peak, gain_db)
    said = tr("The preview clips by {over} dB: lower the monitor gain. The signal is not clipped")
    loud = [said.format(over=f"{clipped:.1f}")] if clipped else []
    return [*lines, *outside, *loud, *shown.warnings]


def look_behind(obj: Any, scene: Any) -> None:
    """Keep the names of the stroke's strips and speakers that sound as it was."""
    from .companions import behind

    asked = PREVIEW.asked.get(obj.name)
    PREVIEW.behind[obj.name] = [] if asked is None else behind(obj, scene, asked[0])


def behind_words(name: str) -> list[str]:
    said = tr("'{name}' still plays the sound from before the last change: add it again (Export)")
    return [said.format(name=each) for each in PREVIEW.behind.get(name, ())]


def levels_against(shown: Heard, profile: ActuatorProfile) -> Levels:
    """Computed once for a signal and an actuator: facts are told many times a second."""
    from hnf_core.actuators.levels import levels_of

    key = (shown.stamp, profile)
    if key not in _levels:
        while len(_levels) >= KEPT_LEVELS:
            del _levels[next(iter(_levels))]
        _levels[key] = levels_of(shown.signal, profile)
    return _levels[key]


def look_of(context: Any) -> Look:
    from .pictures import Look

    return Look(_theme_of(context), actuator_of(context.scene).peak_m_s2)


def _theme_of(context: Any) -> Theme:
    """Dark or light, by the text of Blender's own buttons."""
    from .pictures import DARK, LIGHT

    themes = context.preferences.themes
    text = themes[0].user_interface.wcol_regular.text if len(themes) else (1.0, 1.0, 1.0)
    return DARK if sum(text[:3]) / 3.0 > 0.5 else LIGHT


def _cannot(name: str, why: str) -> None:
    PREVIEW.problems[name] = why
    PREVIEW.asked.pop(name, None)
