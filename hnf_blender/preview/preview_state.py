"""State of the preview that the panels show: signals, references, problems and icons by stroke name.

Reading it computes nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from .synthesis_thread import PreviewResult, SynthesisThread


class PreviewFacts(NamedTuple):
    """Facts of a stroke's signal for the panels.

    Attributes
    ----------
    stroke : str
        Name of the stroke.
    duration_s, peak_m_s2, rms_m_s2 : float
        Duration [s] and levels [m/s²] of the signal.
    headroom_db : float or None
        Distance of the peak to the actuator's limit [dB]; None if the limit is unknown.
    confidence : float
        Confidence of the signal, 0 to 1.
    shows : str
        "A" if the reference is shown, "now" if the newest signal is.
    has_kept : bool
        Whether there is a reference A.
    busy : bool
        Whether a newer signal is being synthesized.
    playing, paused : bool
        Whether the stroke plays, and whether it is paused.
    problem : str
        Why the signal is missing or no longer holds; "" if it holds.
    lines : tuple of str
        All of it as text.
    """

    stroke: str
    duration_s: float = 0.0
    peak_m_s2: float = 0.0
    rms_m_s2: float = 0.0
    headroom_db: float | None = None
    confidence: float = 0.0
    shows: str = "now"
    has_kept: bool = False
    busy: bool = False
    playing: bool = False
    paused: bool = False
    problem: str = ""
    lines: tuple[str, ...] = ()


class PreviewState:
    """Signals, reference signals and problems of all strokes' previews, by stroke name.

    Attributes
    ----------
    results : dict
        Newest signal.
    references : dict
        Reference A of the comparison.
    showing_reference : set of str
        Strokes whose reference is shown and played.
    requested : dict
        Stamp and image style of the newest request.
    outdated : dict
        Strips and speakers that play an earlier signal.
    problems : dict
        Why there is no valid signal.
    facts, icons : dict
        What the panels show.
    images : dict
        Image of the shown signal as bytes, without the playhead.
    playheads : dict
        Fraction of the stroke's time at which the image's playhead stands.
    play_when_ready : str
        Stroke to be played when its signal arrives.
    sounding : str
        Playing stroke; "" for none or the timeline.
    exported : tuple of str
        A sentence for every file of the last export.
    losses : str
        Full report on the last export.
    synthesis_thread : SynthesisThread or None
        Thread that synthesizes the requests.
    """

    def __init__(self) -> None:
        self.results: dict[str, PreviewResult] = {}
        self.references: dict[str, PreviewResult] = {}
        self.showing_reference: set[str] = set()
        self.requested: dict[str, tuple[str, object]] = {}
        self.outdated: dict[str, list[str]] = {}
        self.problems: dict[str, str] = {}
        self.facts: dict[str, PreviewFacts] = {}
        self.icons: dict[str, int] = {}
        self.images: dict[str, NDArray[np.uint8]] = {}
        self.playheads: dict[str, float | None] = {}
        self.play_when_ready = ""
        self.sound_problem = ""
        self.sounding = ""
        self.exported: tuple[str, ...] = ()
        self.losses = ""
        self.synthesis_thread: SynthesisThread | None = None

    def get_shown(self, name: str) -> PreviewResult | None:
        """Return the signal of a stroke that is shown: reference A (kept by the user), or the newest."""
        return self.references.get(name) if name in self.showing_reference else self.results.get(name)

    @property
    def _by_name(self) -> tuple[dict[str, Any], ...]:
        return (
            self.results, self.references, self.requested, self.outdated, self.problems, self.facts, self.icons,
            self.images, self.playheads,
        )  # fmt: skip

    def discard_except(self, names: set[str]) -> None:
        """Discard strokes whose names do not exist any more."""
        self.showing_reference &= names
        for entries in self._by_name:
            for name in entries.keys() - names:
                del entries[name]

    def clear(self) -> None:
        """Discard everything, since another file was opened."""
        self.showing_reference.clear()
        for entries in self._by_name:
            entries.clear()
        self.play_when_ready = self.sounding = self.losses = self.sound_problem = ""
        self.exported = ()


PREVIEW = PreviewState()


def get_preview_facts(obj: Any) -> PreviewFacts | None:
    """Return the facts of a stroke object; None if there are none yet."""
    return None if obj is None else PREVIEW.facts.get(obj.name)


def get_preview_icon(obj: Any) -> int:
    """Return the icon of a stroke's image for template_icon; 0 if there is none."""
    return 0 if obj is None else PREVIEW.icons.get(obj.name, 0)
