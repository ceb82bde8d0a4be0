"""The words of the Touch tab: figures, names, routes and reasons as an artist reads them."""

from __future__ import annotations

import pytest

from hnf_blender.state import labels
from hnf_blender.state.session_state import JobStatus
from hnf_blender.touch.bake_status import Freshness, StrokeStatus
from hnf_blender.ui.materials_panel import group_equal_bakes

LONG = "A stroke along the very long seam of the left armrest"


@pytest.mark.parametrize(
    ("seconds", "said"),
    [(0.2, "under 1 s"), (1.0, "1 s"), (59.4, "59 s"), (60.0, "1 min"), (200.0, "3 min 20 s"), (3900.0, "1 h 5 min")],
)
def test_times_are_said_as_people_do(seconds: float, said: str) -> None:
    assert labels.format_duration(seconds) == said


@pytest.mark.parametrize(
    ("count", "said"), [(0, "0 B"), (999, "999 B"), (1234, "1.2 kB"), (48_321, "48 kB"), (5_000_000, "5 MB")]
)
def test_sizes(count: int, said: str) -> None:
    assert labels.format_bytes(count) == said


@pytest.mark.parametrize("most", [8, 12, 20, 200])
def test_a_shortened_name_fits_and_is_cut_at_its_end(most: int) -> None:
    short = labels.shorten_text(LONG, most)
    assert len(short) <= most
    assert LONG.startswith(short.rstrip("…"))
    assert labels.shorten_text("Rub", most) == "Rub"


@pytest.mark.parametrize("most", [8, 20, 60])
def test_wrapped_lines_fit_and_lose_no_word(most: int) -> None:
    text = "The mesh of 'Chair' changed since the bake: bake again."
    lines = labels.wrap_text(text, most)
    assert max(len(line) for line in lines) <= most
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")


def test_routes_are_said_in_an_artists_words() -> None:
    assert labels.format_routes("8–2 mm measured, 1–0.125 mm prior") == (
        "8–2 mm: seen in the shader's relief",
        "1–0.125 mm: taken from the library",
    )
    assert labels.format_routes("8–0.5 mm predicted, 0.25–0.125 mm prior") == (
        "8–0.5 mm: estimated from the picture",
        "0.25–0.125 mm: taken from the library",
    )
    assert labels.format_routes("8–0.125 mm learned") == ("8–0.125 mm: learned from recordings",)
    assert labels.format_routes("") == ()


def test_reasons_are_short() -> None:
    reason = "'oak' in 'Old oak table; sanded'; 'table' in 'Old oak table'; roughness 0.60 fits"
    assert labels.format_reason("'oak' in 'Old oak'; 'table' in 'Old table'; colour fits") == (
        "the name says oak, table; colour fits"
    )
    assert labels.format_reason("no clue in the scene") == "no clue in the scene"
    assert "roughness 0.60 fits" in labels.format_reason(reason)


def test_reasons_tell_pictures_and_relief_apart_from_names() -> None:
    reason = "'oak' in 'T_Oak.png'; 'wood' in 'Old wood'; colour fits; its relief is like oak-wood's"
    assert labels.format_reason(reason) == (
        "the name says wood; a picture's name says oak; colour fits; its relief is like oak-wood"
    )
    assert labels.format_reason("its relief does not fit") == "its relief does not fit"
    assert labels.format_reason("'plate' in 'Plate'; its relief does not fit") == (
        "the name says plate, though its relief does not fit"
    )


@pytest.mark.parametrize(
    ("metres", "said"),
    [(0.0, "0 nm"), (5.2e-8, "52 nm"), (9.994e-7, "999 nm"), (1e-6, "1 µm"), (21.2e-6, "21 µm"), (3.5e-4, "350 µm"),
     (2.5e-3, "2.5 mm"), (0.25, "250 mm")],
)  # fmt: skip
def test_roughness_is_said_in_the_unit_that_suits_it(metres: float, said: str) -> None:
    assert labels.format_height(metres) == said


def test_spreads_are_said_as_spans() -> None:
    assert labels.format_factor_range(0.3, 1.2, "{:.2f}") == "0.25 – 0.36"
    assert labels.format_stiffness(60_000.0, 1.5) == "Stiffness: about 60 N/mm (40 – 90)"


def test_what_the_strokes_are_is_counted() -> None:
    states = [Freshness.FRESH, Freshness.FORCE, Freshness.STALE, Freshness.BROKEN]
    assert labels.format_counts([StrokeStatus(each) for each in states]) == "2 Up to Date, 1 to Bake, 1 Broken"
    assert labels.format_counts([None]) == "1 Not Checked"
    assert labels.format_counts([]) == ""


def test_strokes_that_were_baked_alike_are_told_together() -> None:
    cork, oak = (StrokeStatus(Freshness.FRESH, library_material=name, confidence=0.4) for name in ("cork", "oak-wood"))
    moved = cork._replace(freshness=Freshness.STALE, why="moved", confidence=0.401)
    elsewhere = cork._replace(shader="Lid")
    told = group_equal_bakes([("A", cork), ("B", oak), ("C", moved), ("D", elsewhere)])
    assert [names for names, _ in told] == [["A", "C"], ["B"], ["D"]]
    assert [(status.shader, status.library_material) for _, status in told] == [
        ("", "cork"), ("", "oak-wood"), ("Lid", "cork")
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("stroke", "surface", "said"),
    [("Rub on Lid", "Lid", "Lid: Rub"), ("Rub on Lid.001", "Lid", "Lid: Rub.001"), ("Rub", "Lid", "Rub"),
     ("Rub on Lid", "", "Rub on Lid"), (" on Lid", "Lid", " on Lid"), ("Rub across Cup, Lid", "Lid", "Cup, Lid: Rub"),
     ("Rub across Cup, Lid", "", "Rub across Cup, Lid"), ("Rub across on Lid", "Lid", "Lid: Rub across")],
)  # fmt: skip
def test_a_listed_stroke_begins_with_its_surface(stroke: str, surface: str, said: str) -> None:
    assert labels.put_surface_first(stroke, surface) == said


@pytest.mark.parametrize(
    ("stage", "total", "said"),
    [("starting", 1, "Starting"), ("rub, close-ups", 4, "rub, close-ups: 2 of 3")],
)
def test_a_job_begins_with_a_capital_or_with_a_name(stage: str, total: int, said: str) -> None:
    assert labels.format_job(JobStatus(stage, 1, total, 0.0, None)) == said
