"""Every text of the interface has a German one, with the same figures in it, and Blender finds it."""

from __future__ import annotations

import string

import bpy
import pytest
from ui_strings import strings_of_classes, strings_of_sources, untranslated_reports

import hnf_blender
from hnf_blender import translations
from hnf_blender.ops.material_ops import list_library_items
from hnf_blender.state import labels
from hnf_blender.touch.session import CHANGE_DESCRIPTIONS
from hnf_core.actuators.profile import PROFILES

GERMAN = translations.read_translations("de_DE")


def our_classes() -> list[type]:
    named = [getattr(bpy.types, name) for name in dir(bpy.types)]
    bases = (bpy.types.PropertyGroup, bpy.types.AddonPreferences)
    named += [each for base in bases for each in base.__subclasses__()]
    ours = [each for each in named if getattr(each, "__module__", "").startswith("hnf_blender")]
    return list(dict.fromkeys(ours))


def test_every_text_has_a_german_one(switched_on: None) -> None:
    tables = (labels.STATUS_LABELS.values(), labels.PLAN_LABELS.values())
    wanted = strings_of_classes(our_classes()) | strings_of_sources() | set(labels.ROUTE_LABELS.values())
    wanted |= {text for table in tables for _, text in table}
    wanted |= set(CHANGE_DESCRIPTIONS.values()) | {"no stroke touches it", "hidden", "muted"}
    # Names and citations stay as they are.
    wanted -= {text for _, label, words in list_library_items() for text in (label, words)}
    wanted -= {text for profile in PROFILES.values() for text in (profile.title, profile.source)}
    assert len(wanted) > 200
    assert [text for text in wanted if "--" in text or "hnf stream" in text] == []  # said at a command line alone
    assert sorted(wanted - set(GERMAN)) == []


def test_what_is_reported_is_translated() -> None:
    assert untranslated_reports() == set()


def test_placeholders_stay() -> None:
    for text, said in GERMAN.items():
        assert said.strip(), text
        assert fields(text) == fields(said), text


def test_blender_is_given_every_text_in_both_contexts(switched_on: None) -> None:
    """The wheels come without languages, so English is what they answer here."""
    given = translations.build_dictionary()
    assert set(given) == {"de_DE"}
    assert {text for context, text in given["de_DE"] if context == "Operator"} == set(GERMAN)
    assert {text for context, text in given["de_DE"] if context == "*"} == set(GERMAN)
    assert translations.tr("no such text") == "no such text"
    assert labels.format_duration(0.1) in ("under 1 s", "unter 1 s")


@pytest.fixture
def switched_on():
    """The whole add-on, as Blender switches it on; the properties that the session needs come back after it."""
    from hnf_blender import props

    had = hasattr(bpy.types.Object, "hnf_stroke")
    if had:
        props.unregister()
    hnf_blender.register()
    yield
    hnf_blender.unregister()
    if had:
        props.register()


def fields(text: str) -> list[str]:
    return sorted(name for _, name, _, _ in string.Formatter().parse(text) if name)


def test_sentences_with_figures_are_german_throughout(monkeypatch) -> None:
    """As in a German Blender: the wheels have no languages, so tr() is put in."""
    from dataclasses import replace

    from hnf_blender.jobs import bake_job
    from hnf_blender.jobs.commit import CommitResult
    from hnf_blender.jobs.request import JobResult, Rejection

    monkeypatch.setattr(bake_job, "tr", lambda text: GERMAN[text])
    result = JobResult((), (), (), (), fresh=1, close_ups=3)
    said = bake_job.describe_result(result, CommitResult(["A", "B"]), 4.2).message
    assert said == "2 Striche in 4 s gebacken, 3 Nahaufnahmen, 1 schon aktuell."
    nothing = bake_job.describe_result(replace(result, close_ups=0), CommitResult(), 1.0).message
    assert nothing == "Nichts zu backen: 1 Strich schon aktuell."
    problems = tuple(Rejection("C", "warum") for _ in range(3))
    failed = bake_job.describe_result(replace(result, failed=problems), CommitResult(["A"]), 4.0)
    assert failed.message.endswith("Warum (und 2 weitere Probleme)")
    assert not failed.ok


def test_why_a_button_is_grey_is_said_in_german(monkeypatch) -> None:
    """Blender would show the English that poll() gives it."""
    from types import SimpleNamespace

    from hnf_blender.ops import operator_base as greyed
    from hnf_blender.ops.stroke_ops import poll_object_mode

    monkeypatch.setattr(greyed, "tr", lambda text: GERMAN[text])
    told: list[str] = []
    operator, context = SimpleNamespace(poll_message_set=told.append), SimpleNamespace(mode="SCULPT")
    assert not poll_object_mode(operator, context)
    assert told == [GERMAN["Strokes are made in Object Mode: choose it in the header"]]
