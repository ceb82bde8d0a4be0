"""Labels as Blender's Human Interface Guidelines have them: Title Case, short, US English, no sentences, translated."""

from __future__ import annotations

import re

import pytest
from test_translations import GERMAN, our_classes, switched_on  # noqa: F401  # a fixture
from ui_strings import labels_of_classes, labels_of_sources, strings_of_classes, strings_of_sources

from hnf_blender.ops.material_ops import list_library_items
from hnf_blender.state.labels import PLAN_LABELS, STATUS_LABELS
from hnf_blender.ui.actuator_panel import PHASE_LABELS

MAX_CHARACTERS = 28
MINOR = {"a", "an", "and", "as", "at", "but", "by", "for", "from", "in", "nor", "of", "on", "or", "per", "so", "than",
         "the", "to", "with"}  # fmt: skip
"""Words that are lower case within a label: articles, conjunctions, short prepositions."""
AS_WRITTEN = {"m", "mm/s", "ms", "m/s²", "mm", "s", "kHz", "dB", "glTF"}
"""Units and names with a case of their own."""
BRITISH = re.compile(
    r"\b(?:\w*(?:metre|litre|colour|behaviour|favour|neighbour|centre|fibre|grey|licence|catalogue|aluminium|mould"
    r"|defence|artefact|analyse|dialogue|cancelled|cancelling|labell|modell|travell)\w*"
    r"|(?!noise|raise|precise|rise|otherwise|exercise|promise|advise|surprise|comprise|revise|likewise|concise)"
    r"\w{3,}(?:ise|ised|ises|ising|isation)|3-D)\b",
    re.IGNORECASE,
)
"""Spellings that US English has not, and "3-D", which Blender writes "3D"."""


def find_breach(label: str) -> str:
    """Say what is wrong with a label; "" for nothing. What is put in for braces is not judged."""
    bare = re.sub(r"\{[^}]*\}", "0", label)
    if len(bare) > MAX_CHARACTERS:
        return f"{len(bare)} characters"
    if re.search(r"[.!?;,]$|[.!?;] ", bare):
        return "a sentence"
    if BRITISH.search(bare):
        return "not US English"
    words = [word.strip("()") for word in bare.rstrip("…").split()]
    for index, word in enumerate(words):
        is_inner = 0 < index < len(words) - 1
        if not word[:1].isalpha() or word in AS_WRITTEN:
            continue
        if word[0].islower() and not (is_inner and word in MINOR):
            return f"'{word}' is not capitalized"
        if is_inner and word.lower() in MINOR and word[0].isupper() and word != "A":
            return f"'{word}' is capitalized"
    return ""


def all_labels() -> set[str]:
    tables = (STATUS_LABELS.values(), PLAN_LABELS.values(), PHASE_LABELS.values())
    found = labels_of_classes(our_classes()) | labels_of_sources() | {text for table in tables for _, text in table}
    return found - {label for _, label, _ in list_library_items()}  # names of materials


def test_every_label_keeps_to_the_guidelines(switched_on: None) -> None:  # noqa: F811
    labels = all_labels()
    assert len(labels) > 150
    assert {label: breach for label in sorted(labels) if (breach := find_breach(label))} == {}


def test_every_label_has_a_german_one(switched_on: None) -> None:  # noqa: F811
    from hnf_core.actuators.profile import PROFILES

    assert sorted(all_labels() - set(GERMAN) - {profile.title for profile in PROFILES.values()}) == []


def test_every_text_is_american(switched_on: None) -> None:  # noqa: F811
    texts = strings_of_classes(our_classes()) | strings_of_sources() | set(GERMAN)
    bare = {text: re.sub(r"\{[^}]*\}", "", text) for text in texts}
    assert sorted(text for text, words in bare.items() if BRITISH.search(words)) == []


@pytest.mark.parametrize(
    ("label", "breach"),
    [("Follow the timeline", "'timeline' is not capitalized"), ("metres", "not US English"),
     ("Add To Sequencer", "'To' is capitalized"), ("Play the Stroke Now.", "a sentence"),
     ("Set Its Path; Then Check", "a sentence"), ("Show the Cache's Folder and Its Size", "36 characters"),
     ("Gray and Grey", "not US English"), ("3-D View", "not US English"), ("Normalised Level", "not US English"),
     ("the Plan", "'the' is not capitalized"), ("Listen to", "'to' is not capitalized")],
)  # fmt: skip
def test_a_breach_of_each_rule_is_refused(label: str, breach: str) -> None:
    assert find_breach(label) == breach


@pytest.mark.parametrize(
    "label", ["WAV in m/s²", "Touch Material (.hnf)", "Hearing A: Kept", "Keep as A", "{count} Up to Date", "Choose…",
              "Force (N)", "Noise", "GLB (glTF)"]
)  # fmt: skip
def test_what_the_guidelines_have_is_accepted(label: str) -> None:
    assert find_breach(label) == ""
