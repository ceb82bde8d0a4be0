"""What the panels show of a preview. Reading it computes nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from .synthesis_thread import PreviewResult, SynthesisThread


class PreviewFacts(NamedTuple):
    """A stroke's signal as it is shown. Figures in s, m/s² and dB; headroom_db: None where the actuator's largest is
    not known. shows: "A" (kept) or "now". has_kept: is there an A. busy: a newer one is being made. paused: it plays,
    and is held. problem: why what is shown is not true any more, or why there is nothing; "" = true. lines: all of it
    in words."""

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
    """All by stroke name. heard: the newest signal. kept: A of the comparison. on_kept: strokes of which A is heard.
    asked: stamp and look of the newest request. behind: strips and speakers that sound as the stroke did before.
    problems: why there is no true signal. facts, icons: what panels show.
    play_when_ready: stroke to be played when its signal is there. sounding: stroke that plays, "" = none or the
    timeline. exported: a sentence for each file of the last export, what it cost; losses: the whole report."""

    def __init__(self) -> None:
        self.results: dict[str, PreviewResult] = {}
        self.references: dict[str, PreviewResult] = {}
        self.showing_reference: set[str] = set()
        self.requested: dict[str, tuple[str, object]] = {}
        self.outdated: dict[str, list[str]] = {}
        self.problems: dict[str, str] = {}
        self.facts: dict[str, PreviewFacts] = {}
        self.icons: dict[str, int] = {}
        self.play_when_ready = ""
        self.sounding = ""
        self.exported: tuple[str, ...] = ()
        self.losses = ""
        self.synthesis_thread: SynthesisThread | None = None

    def get_shown(self, name: str) -> PreviewResult | None:
        """What is heard and seen of a stroke: A, or the newest."""
        return self.references.get(name) if name in self.showing_reference else self.results.get(name)

    @property
    def _by_name(self) -> tuple[dict[str, Any], ...]:
        return self.results, self.references, self.requested, self.outdated, self.problems, self.facts, self.icons

    def discard_except(self, names: set[str]) -> None:
        """Forget strokes that are no more, or are called otherwise now."""
        self.showing_reference &= names
        for each in self._by_name:
            for name in each.keys() - names:
                del each[name]

    def clear(self) -> None:
        """Another file is open."""
        self.showing_reference.clear()
        for each in self._by_name:
            each.clear()
        self.play_when_ready = self.sounding = self.losses = ""
        self.exported = ()


PREVIEW = PreviewState()


def get_preview_facts(obj: Any) -> PreviewFacts | None:
    """Of a stroke object; None where nothing is known of it yet."""
    return None if obj is None else PREVIEW.facts.get(obj.name)


def get_preview_icon(obj: Any) -> int:
    """Icon of a stroke's picture for template_icon; 0 where there is none (yet, or without a window)."""
    return 0 if obj is None else PREVIEW.icons.get(obj.name, 0)
