"""The stroke's picture: its numbers obey their laws, and any input gives a whole PNG without global state."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import Action
from hnf_core.errors import FileError
from hnf_core.export import stroke_figure as picture
from hnf_core.export.figure import compute_spectrogram, force_to_colour, make_thumbnail
from hnf_core.export.stroke_figure import StrokeView, write_stroke_figure
from hnf_core.signal import Signal
from hnf_core.tactile.tactile_map import Route, TactileMap
from hnf_core.units import linear_to_srgb

image = pytest.importorskip("matplotlib.image", reason="pictures need matplotlib")


def action(n: int = 101, force: float = 1.0) -> Action:
    speed = np.full(n, 0.1)
    forces = np.full(n, force)
    return Action(200.0, np.tile([1.0, 0.0], (n, 1)), speed, forces, np.cumsum(speed) / 200, forces > 0)


def signal(n: int = 4000) -> Signal:
    return Signal(np.sin(np.arange(n) * 0.2).astype(np.float32), 8000.0, 3)


def view(height: int = 54, width: int = 96, n: int = 101, force: float = 1.0) -> StrokeView:
    k = np.linspace(0.1, 0.9, n)
    return StrokeView(
        np.full((height, width, 3), 0.2, np.float32), np.stack([width * k, height * k], axis=1), np.full(n, force)
    )


def pixels(path: Path) -> np.ndarray:
    return image.imread(io.BytesIO(path.read_bytes()), format="png")[..., :3]


@given(rate=st.sampled_from([1000.0, 8000.0, 44100.0]), hertz=st.floats(100.0, 400.0), size=st.floats(0.01, 100.0))
def test_a_tone_keeps_its_power_and_its_frequency(rate: float, hertz: float, size: float) -> None:
    t = np.arange(int(rate)) / rate
    spectra = compute_spectrogram(Signal((size * np.sin(2 * np.pi * hertz * t)).astype(np.float32), rate, 0))
    step = spectra.frequency[1]
    inner = spectra.power[:, 2:-3]
    assert np.allclose(inner.sum(axis=0) * step, size**2 / 2, rtol=0.02)
    assert abs(spectra.frequency[np.argmax(inner.mean(axis=1))] - hertz) <= step


def test_white_noise_is_flat_at_its_variance() -> None:
    noise = np.random.default_rng(0).normal(size=200_000).astype(np.float32)
    spectra = compute_spectrogram(Signal(noise, 2000.0, 0))
    assert np.median(spectra.mean()[2:-2]) == pytest.approx(1.0 / 1000.0, rel=0.03)
    assert spectra.mean().sum() * spectra.frequency[1] == pytest.approx(1.0, rel=0.03)


def test_every_sample_falls_into_a_window() -> None:
    for n in (0, 1, 511, 512, 513, 1000, 4001):
        spectra = compute_spectrogram(Signal(np.ones(n, np.float32), 8000.0, 0))
        assert spectra.power.shape == (len(spectra.frequency), len(spectra.time))
        assert (spectra.time[-1] + 0.032) * 8000.0 >= n


def test_srgb_transfer() -> None:
    assert linear_to_srgb(np.array([0.0, 1.0, 0.21404114, 0.003])) == pytest.approx([0.0, 1.0, 0.5, 0.03876], abs=1e-6)
    assert linear_to_srgb(np.array([np.nan, np.inf, -np.inf, -1.0, 7.0])) == pytest.approx([0, 1, 0, 0, 1])


def test_the_view_shows_the_path_in_the_colour_of_its_force(tmp_path: Path) -> None:
    write_stroke_figure(tmp_path / "a.png", title="A", action=action(), signal=signal(), view=view())
    drawn = pixels(tmp_path / "a.png")
    assert drawn.shape == (1000, 1600, 3)
    column = slice(40, 790)
    full_force, grey = np.array(force_to_colour(1.0)[:3]), linear_to_srgb(np.float32([0.2, 0.2, 0.2]))
    at = np.argwhere(np.abs(drawn[90:500, column] - full_force).max(axis=2) < 0.02)
    assert len(at) > 500
    # The path runs down the diagonal of the view, so rows and columns of its pixels go together.
    assert np.corrcoef(at.T)[0, 1] > 0.99
    assert np.mean(np.abs(drawn[90:500, column] - grey).max(axis=2) < 0.01) > 0.5


@pytest.mark.parametrize("strongest", [1.0, 2.5, 6.0])
def test_a_force_has_the_same_colour_whatever_the_strongest_is(tmp_path: Path, strongest: float) -> None:
    """Half the way at 1 N, half at the strongest; and every colour of the bar is where it always is."""
    shown = view()
    force = np.where(np.arange(101) < 50, 1.0, strongest)
    seen = StrokeView(shown.rgb, shown.path, force)
    for name, each in (("a.png", seen), ("b.png", view())):
        write_stroke_figure(tmp_path / name, title="A", action=action(), signal=signal(), view=each)
    drawn, other = pixels(tmp_path / "a.png"), pixels(tmp_path / "b.png")
    for newtons in (1.0, strongest):
        at = np.abs(drawn[90:500, 40:790] - np.array(force_to_colour(newtons)[:3])).max(axis=2) < 0.02
        assert at.sum() > 250
    assert np.array_equal(drawn[530:590, 40:790], other[530:590, 40:790])
    assert len(np.unique(drawn[534, 45:790].round(2), axis=0)) > 100


def drawn_at(picture: np.ndarray, seen: StrokeView) -> np.ndarray:
    """(n, 3) the picture's colour where each point of the path lies in it; for a view of 768 × 432."""
    column, row = (np.array([40.0, 85.0]) + seen.path * 760.0 / 768.0).astype(int).T
    return picture[row, column]


@pytest.mark.parametrize(
    "way",
    [np.linspace(-0.5, 0.5, 101), 0.5 * np.sin(np.linspace(0.0, 5.5 * np.pi, 101))],
    ids=["one way", "back and forth"],
)
@pytest.mark.parametrize("length_px", [24.0, 60.0, 400.0])
def test_marks_leave_a_stroke_to_be_seen_however_short_it_is(tmp_path: Path, way: np.ndarray, length_px: float) -> None:
    path = np.stack([380.0 + length_px * way, np.full(101, 220.0)], axis=1)
    seen = StrokeView(np.full((432, 768, 3), 0.2, np.float32), path, np.full(101, 2.0))
    write_stroke_figure(tmp_path / "a.png", title="A", action=action(), signal=signal(), view=seen)
    shown = np.abs(drawn_at(pixels(tmp_path / "a.png"), seen) - force_to_colour(2.0)[:3]).max(axis=1) < 0.1
    assert shown.mean() > 0.4


def test_a_press_has_the_colour_of_its_strongest_force(tmp_path: Path) -> None:
    seen = StrokeView(np.full((432, 768, 3), 0.2, np.float32), np.full((3, 2), 200.0), np.array([0.0, 4.0, 0.0]))
    write_stroke_figure(tmp_path / "a.png", title="A", action=action(3), signal=signal(), view=seen)
    assert np.abs(drawn_at(pixels(tmp_path / "a.png"), seen)[0] - force_to_colour(4.0)[:3]).max() < 0.02


def test_hidden_parts_are_not_drawn_as_visible(tmp_path: Path) -> None:
    write_stroke_figure(tmp_path / "a.png", title="A", action=action(), signal=signal(), view=view())
    hidden = StrokeView(view().rgb, view().path, view().force, np.zeros(101, bool))
    write_stroke_figure(tmp_path / "b.png", title="A", action=action(), signal=signal(), view=hidden)
    full_force = np.array(force_to_colour(1.0)[:3])
    count = [
        np.sum(np.abs(pixels(tmp_path / n)[90:500, 40:790] - full_force).max(axis=2) < 0.02) for n in ("a.png", "b.png")
    ]
    assert count[0] > 500
    assert count[1] == 0


def test_equal_input_gives_equal_bytes(tmp_path: Path) -> None:
    for name in ("a.png", "b.png"):
        write_stroke_figure(
            tmp_path / name, title="A", action=action(), signal=signal(), view=view(), facts={"Probe": "pen"}
        )
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("route", [Route.MEASURED, Route.PREDICTED])
def test_a_tactile_map_is_shown_beside_the_facts(tmp_path: Path, route: Route) -> None:
    """Its upper half is lit from one side, its lower half from the other, faintly: the contrast is raised."""
    half = np.where(np.arange(64)[:, None] < 32, 0.02, -0.02)
    lit = np.broadcast_to(0.5 + half[..., None] * np.array([1.0, -1.0, 0.0]), (64, 64, 3)).astype(np.float32)
    tactile = TactileMap(lit, None, np.ones((64, 64), bool), 312.5e-6, "gelsight", 625e-6, route)
    for name, shown in (("without.png", None), ("with.png", make_thumbnail(tactile))):
        write_stroke_figure(
            tmp_path / name, title="A", action=action(), signal=signal(), view=view(), tactile=shown,
            facts={"Routes": "8–1 mm " + route.value},
        )  # fmt: skip
    drawn = pixels(tmp_path / "with.png")
    red, green, blue = linear_to_srgb(np.array([0.7, 0.3, 0.5]))
    upper = np.argwhere(np.abs(drawn - [red, green, blue]).max(axis=2) < 0.02)
    lower = np.argwhere(np.abs(drawn - [green, red, blue]).max(axis=2) < 0.02)
    assert len(upper) == pytest.approx(160 * 80, rel=0.1)
    assert len(lower) == pytest.approx(160 * 80, rel=0.1)
    assert upper[:, 0].max() < lower[:, 0].min() + 3
    blank = pixels(tmp_path / "without.png")
    assert np.sum(np.abs(blank - [red, green, blue]).max(axis=2) < 0.02) == 0


def test_facts_end_before_the_tactile_map(tmp_path: Path) -> None:
    tactile = TactileMap(
        np.full((64, 64, 3), 0.5, np.float32), None, np.ones((64, 64), bool), 312.5e-6, "gelsight", 625e-6,
        Route.PREDICTED,
    )  # fmt: skip
    likely = "wood Brown on SheenChair_wood: oak-wood 28%, varnished-wood 23%, painted-wood 16% (roughness 0.41 fits). "
    for name, material in (("short.png", "wood"), ("long.png", 2 * likely)):
        write_stroke_figure(
            tmp_path / name, title="A", action=action(), signal=signal(), view=view(), tactile=make_thumbnail(tactile),
            facts={"Material": material},
        )  # fmt: skip
    short, long = pixels(tmp_path / "short.png"), pixels(tmp_path / "long.png")
    assert not np.array_equal(short[600:, 176:635], long[600:, 176:635])
    np.testing.assert_array_equal(short[600:, 636:802], long[600:, 636:802])


def words_of(monkeypatch: pytest.MonkeyPatch, facts: dict[str, str]) -> str:
    """All that a picture with facts says beside its axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    said: list[str] = []

    def drawn(path: Path, size_px: tuple[int, int], draw: Callable[[Figure], None]) -> None:
        figure = Figure(figsize=(size_px[0] / 100, size_px[1] / 100), dpi=100)
        FigureCanvasAgg(figure)
        draw(figure)
        assert all(0.0 <= text.get_position()[1] <= 1.0 for text in figure.texts)
        said.extend(text.get_text() for text in figure.texts)

    monkeypatch.setattr(picture, "write_figure", drawn)
    write_stroke_figure(Path("a.png"), title="A", action=action(), signal=signal(), view=view(), facts=facts)
    return " ".join(said)


def test_a_reason_is_read_to_its_end_while_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    reason = " ".join(f"word{number}" for number in range(60))
    facts = {"Material": reason, "Routes": "8–0.125 mm measured", "Height": "bump", "Confidence": "96%"}
    said = words_of(monkeypatch, facts)
    assert reason in said
    assert "…" not in said
    endless = words_of(monkeypatch, {**facts, "Material": " ".join([reason] * 9)})
    assert reason in endless
    assert "…" in endless
    assert "0.50 s at 8000 Hz" in endless


def test_hatching_is_explained_where_there_is_some(tmp_path: Path) -> None:
    """A stroke that begins and ends at no force touches in between: an instant is not hatched."""
    for name, off in (("a.png", 1), ("b.png", 20)):
        force = np.ones(101)
        force[:off] = force[-1] = 0.0
        moves = replace(action(), force=force, contact=force > 0)
        write_stroke_figure(tmp_path / name, title="A", action=moves, signal=signal())
    above = [pixels(tmp_path / name)[64:82, 1300:1475] for name in ("a.png", "b.png")]
    spread = [float(np.ptp(each, axis=(0, 1)).max()) for each in above]
    assert spread[0] == 0.0 < 0.3 < spread[1]


@settings(max_examples=8, deadline=None)
@given(title=st.text(max_size=120), label=st.text(max_size=30), text=st.text(max_size=300))
def test_names_are_never_read_as_markup(
    title: str, label: str, text: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.getbasetemp() / "names.png"
    write_stroke_figure(
        path, title=title + "$\\frac{", action=action(), signal=signal(400), facts={label: text + "$^$"}
    )
    assert pixels(path).shape == (1000, 1600, 3)


@pytest.mark.parametrize(
    ("moves", "felt", "seen"),
    [
        (action(1), signal(0), None),
        (action(2), Signal(np.zeros(1, np.float32), 8000.0, 0), view(n=1)),
        (action(force=0.0), Signal(np.zeros(4000, np.float32), 8000.0, 0), view(force=0.0)),
        (action(), signal(100), view(100, 100)),
        (action(), signal(), view(400, 50)),
        (action(), signal(), view(20, 400)),
        (action(), Signal(signal().samples, 500.0, 0), view(n=0)),
    ],
    ids=["one instant", "one sample", "silence", "square", "portrait", "panorama", "slow rate"],
)
@pytest.mark.parametrize("scale", ["linear", "log"])
def test_edges_of_input(tmp_path: Path, moves: Action, felt: Signal, seen: StrokeView | None, scale: str) -> None:
    path = tmp_path / "a.png"
    write_stroke_figure(path, title="A", action=moves, signal=felt, view=seen, frequency_scale=scale)
    assert pixels(path).std() > 0.01


def test_no_display_no_pyplot_and_the_style_is_put_back(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, 'tests/core/export')\n"
        "import matplotlib\n"
        "from pathlib import Path\n"
        "from test_stroke_picture import action, signal, view\n"
        "from hnf_core.export.stroke_figure import write_stroke_figure\n"
        "style = lambda: {k: matplotlib.rcParams[k] for k in matplotlib.rcParams if k != 'backend'}\n"
        "before = style()\n"
        "write_stroke_figure(Path(sys.argv[1]), title='A', action=action(), signal=signal(), view=view())\n"
        "assert style() == before\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    root = Path(__file__).parents[3]
    env = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PYTHONPATH": str(root)}
    subprocess.run([sys.executable, "-c", code, str(tmp_path / "a.png")], check=True, cwd=root, env=env, timeout=120)


def test_without_matplotlib_the_error_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(FileError, match="pictures need matplotlib"):
        write_stroke_figure(tmp_path / "a.png", title="A", action=action(), signal=signal())


def test_an_unwritable_target_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(FileError, match="cannot write here"):
        write_stroke_figure(tmp_path / "file" / "a.png", title="A", action=action(), signal=signal(400))
