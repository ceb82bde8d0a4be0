"""Panels of the Touch tab: contents for empty and full scenes, and clean unregistration."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from builders import add_plane
from panel_recorder import HEADER_PX, Recorder, Sized, context_of, drawn, rna_of

import hnf_blender.ops
import hnf_blender.ui
from hnf_blender.prefs import HnfPreferences
from hnf_blender.preview.preview_state import PREVIEW, PreviewFacts
from hnf_blender.props.scene_settings import get_active_stroke
from hnf_blender.registration import collect_classes
from hnf_blender.state import labels
from hnf_blender.state.addon_settings import Settings, finish_guide, get_settings
from hnf_blender.state.session_state import STATE, JobStatus, LastJob, PlanLine, PlanView
from hnf_blender.touch.bake_status import Freshness, StrokeStatus
from hnf_blender.ui import strokes_panel
from hnf_core.action.primitives import PRIMITIVES

ROOT = Path(__file__).resolve().parents[2]
UI = collect_classes("hnf_blender.ui", hnf_blender.ui.MODULES)
PANELS = [each for each in UI if issubclass(each, bpy.types.Panel)]
LONG = "A stroke along the very long seam of the left armrest"


@pytest.fixture(autouse=True)
def switched_on():
    hnf_blender.ops.register()
    hnf_blender.ui.register()
    STATE.clear()
    finish_guide(False)
    yield
    PREVIEW.clear()
    STATE.clear()
    finish_guide(False)
    hnf_blender.ui.unregister()
    hnf_blender.ops.unregister()


def panel(name: str) -> type:
    return next(each for each in PANELS if each.__name__ == name)


def add_stroke(name: str, surface: bpy.types.Object | None = None) -> bpy.types.Object:
    curve = bpy.data.curves.new(name, "CURVE")
    stroke = bpy.data.objects.new(name, curve)
    bpy.context.scene.collection.objects.link(stroke)
    stroke.hnf_stroke.is_stroke = True
    stroke.hnf_stroke.surface = surface
    bpy.context.view_layer.objects.active = stroke
    return stroke


def fill() -> None:
    """A scene in the middle of work: strokes in every state, a plan, a choice, suggestions, a job that failed."""
    plane = add_plane()
    for name in ("Oak table", "Steel"):
        plane.data.materials.append(bpy.data.materials.new(name))
    for freshness in Freshness:
        name = f"{LONG} {freshness.value}"
        add_stroke(name, plane)
        STATE.get_statuses(bpy.context.scene)[name] = StrokeStatus(
            freshness, "", 1.2, "Plane", "oak-wood", "8–2 mm measured, 1–0.125 mm prior", 0.64, ("fast",)
        )
        PREVIEW.facts[name] = PreviewFacts(
            name, 1.2, 3.0, 1.0, 20.0, 0.64, has_kept=freshness is Freshness.FRESH, busy=freshness is Freshness.FORCE,
            problem="stale" if freshness is Freshness.STALE else "", lines=("1.20 s; peak 3 m/s², RMS 1 m/s²",),
        )  # fmt: skip
    kinds = tuple(PlanLine(kind, f"stroke '{LONG}'", "because") for kind in labels.PLAN_LABELS for _ in range(8))
    STATE.plan = PlanView(kinds, 75.0, 48_321)
    STATE.last_job = LastJob(False, "The bake stopped. Bake again.", ("Killed",))
    plane.data.materials[0].hnf_touch.library = "oak-wood"
    bpy.context.view_layer.objects.active = plane
    bpy.ops.hnf.suggest()
    bpy.ops.hnf.diagnose()


WIDTHS = (120, 300, 900)


@pytest.mark.parametrize("each", PANELS, ids=lambda each: each.__name__)
def test_every_panel_draws_with_what_this_blender_has(each: type) -> None:
    """Functions, icons, operators and properties are looked up in Blender's own descriptions."""

    def draw() -> None:
        for width in WIDTHS:
            drawn(each, width)

    draw()
    fill()
    draw()
    for stroke in [obj for obj in bpy.context.scene.objects if obj.hnf_stroke.is_stroke]:
        bpy.context.view_layer.objects.active = stroke
        for law in ("PROGRESS", "SPEED", "DURATION"):
            stroke.hnf_stroke.law = law
            draw()
    stroke.keyframe_insert("hnf_stroke.force", frame=1)
    stroke.keyframe_insert("hnf_stroke.progress", frame=1)
    stroke.hnf_stroke.material = "oak-wood"
    draw()
    STATE.job = JobStatus("Close-ups", 3, 12, 4.0, 11.0)
    draw()


@pytest.mark.parametrize("each", PANELS, ids=lambda each: each.__name__)
def test_drawing_changes_nothing(each: type) -> None:
    fill()
    before = (
        dict(STATE.get_statuses(bpy.context.scene)),
        STATE.plan,
        STATE.last_job,
        dict(STATE.suggestions),
        set(STATE.dirty_names),
    )
    drawn(each)
    assert before == (
        dict(STATE.get_statuses(bpy.context.scene)),
        STATE.plan,
        STATE.last_job,
        dict(STATE.suggestions),
        set(STATE.dirty_names),
    )


def test_the_tab_is_in_the_order_of_the_work() -> None:
    listed = [each for each in PANELS if each.bl_region_type == "UI"]
    assert {each.bl_category for each in listed} == {"Touch"}
    tops = [each for each in listed if not getattr(each, "bl_parent_id", "")]
    assert [each.bl_label for each in sorted(tops, key=lambda each: each.bl_order)] == [
        "Bake & Preview", "Strokes", "Materials", "Output",
    ]  # fmt: skip
    popovers = {each.bl_label for each in PANELS if each not in listed}
    assert popovers == {"Details", "Plan", "Monitor", "One Place", "As Baked", "Units"}


def tab(name: str = "HNF_PT_preview") -> Recorder:
    """What a panel shows now."""
    found = drawn(panel(name))
    assert found is not None
    return found


def test_panels_show_first_steps_until_they_are_done() -> None:
    assert "1 of 3: Draw a Stroke" in tab().words
    assert "hnf.stroke_tool" in tab().operators
    assert "hnf.stroke_tool" not in tab("HNF_PT_strokes").operators  # one panel has it, not both
    stroke = add_stroke("Rub", add_plane())
    assert ("hnf.stroke_tool" in tab().operators, "hnf.stroke_tool" in tab("HNF_PT_strokes").operators) == (False, True)
    assert "2 of 3: Bake It" in tab().words
    STATE.get_statuses(bpy.context.scene)[stroke.name] = StrokeStatus(Freshness.FRESH)
    assert "3 of 3: Play It" in tab().words
    assert "hnf.preview_play" in tab().operators
    finish_guide()
    assert "of 3" not in tab().words


@pytest.mark.parametrize("freshness", Freshness)
def test_the_main_button_is_what_is_needed_next(freshness: Freshness) -> None:
    stroke = add_stroke("Rub", add_plane())
    STATE.get_statuses(bpy.context.scene)[stroke.name] = StrokeStatus(freshness)
    wanted = freshness in (Freshness.UNBAKED, Freshness.STALE, Freshness.BROKEN)
    assert ("Bake" in [text for text, _ in tab().texts]) == wanted
    assert ("hnf.preview_play" in tab().operators) != wanted
    assert labels.STATUS_LABELS[freshness][1] in tab().words


def test_the_preview_says_what_is_missing_then_shows_figures() -> None:
    assert "draw a stroke" in tab("HNF_PT_details").words.replace("\n", " ")
    stroke = add_stroke("Rub", add_plane())
    PREVIEW.facts[stroke.name] = PreviewFacts(stroke.name, problem="Not baked yet.")
    STATE.get_statuses(bpy.context.scene)[stroke.name] = StrokeStatus(Freshness.UNBAKED)
    assert "Bake this stroke" in tab("HNF_PT_details").words
    assert "Not baked yet." not in tab("HNF_PT_details").words
    STATE.get_statuses(bpy.context.scene)[stroke.name] = StrokeStatus(Freshness.FRESH)
    PREVIEW.facts[stroke.name] = PreviewFacts(stroke.name, 1.2, playing=True, has_kept=True, lines=("peak 3 m/s²",))
    playing = tab()
    assert "peak 3 m/s²" in playing.words
    assert {"hnf.preview_stop", "hnf.preview_pause"} <= set(playing.operators)
    assert "hnf.preview_play" not in playing.operators
    assert ("hnf.preview_ab", "action", "SWITCH") in playing.given


def warn(kind: str, stroke: bpy.types.Object) -> str:
    """Make one warning the most urgent one; the operator or property that mends it, "" where the details do."""
    status, facts = StrokeStatus(Freshness.FRESH, confidence=0.9), PreviewFacts(stroke.name, 1.2, lines=("1.2 s",))
    mends = ""
    if kind == "sound":
        PREVIEW.sound_problem, mends = "there is no sound device.", "screen.userpref_show"
    elif kind == "height":
        status, mends = status._replace(doubted_shaders=("Oak",)), "height_as_authored"
    elif kind == "scale":
        note = "object 'Scan' is a reconstruction, which has no real-world size: one unit is assumed to be 1 m."
        status, mends = status._replace(warnings=(note, "Another.")), "hnf.set_real_length"
    elif kind == "guess":
        status, mends = status._replace(confidence=0.1), "hnf.stroke_material"
    elif kind == "surface":
        bpy.context.scene.collection.objects.unlink(stroke.hnf_stroke.surface)
        mends = "hnf.strokes_delete_orphans"
    elif kind == "bake":
        STATE.last_job = LastJob(False, "The bake stopped. Bake again.", ("Killed",))
    STATE.get_statuses(bpy.context.scene)[stroke.name] = status
    PREVIEW.facts[stroke.name] = facts
    return mends


def test_the_list_is_searched_and_sorted() -> None:
    recorder = Recorder()
    listed = bpy.types.HNF_UL_strokes
    listed.draw_filter(SimpleNamespace(bl_rna=listed.bl_rna), context_of(), recorder)
    assert recorder.props == ["filter_name", "order", "use_filter_sort_reverse"]


KINDS = ("", "sound", "height", "scale", "guess", "bake", "surface")


@pytest.mark.parametrize("kind", KINDS)
def test_one_warning_at_most_with_what_mends_it(kind: str) -> None:
    bpy.data.materials.new("Oak")
    stroke = add_stroke("Rub", add_plane())
    finish_guide()
    mends, shown = warn(kind, stroke), tab()
    assert mends in ("", *shown.operators, *shown.props)
    assert ("Details" in shown.words.splitlines()) is (kind == "bake")  # what nothing mends is explained beside it
    assert shown.icons.count("ERROR") == (kind != "")
    assert sum("." in text for text, _ in shown.texts) <= (kind == "")  # no sentence; 1.2 s is none
    PREVIEW.sound_problem = ""


LINE_PX, LETTER_PX = 236.0, 5.9
"""Width of a line in a sidebar as wide as Blender makes it, and of a letter [px], measured on a picture of it."""


@pytest.mark.parametrize("kind", ["sound", "height", "scale", "guess", "surface", "bake"])
def test_neither_the_warning_nor_its_remedy_is_cut(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the sidebar of its usual width, where half of a line has no room for *Material Is a Guess*."""
    bpy.data.materials.new("Oak")
    stroke = add_stroke("Rub", add_plane())
    warn(kind, stroke)
    call, shares = Recorder._call, []

    def note(self: Recorder, name: str, values: tuple[object, ...], named: dict[str, object]) -> object:
        if name == "split":
            shares.append((named["factor"], len(self.texts)))
        return call(self, name, values, named)

    monkeypatch.setattr(Recorder, "_call", note)
    shown = Recorder()
    panel("HNF_PT_preview").draw(SimpleNamespace(layout=shown, bl_rna=panel("HNF_PT_preview").bl_rna), context_of())
    ((share, first),) = shares
    (warning, _), (remedy, _) = shown.texts[first : first + 2]
    assert 20.0 + LETTER_PX * len(warning) <= share * LINE_PX
    assert 8.0 + LETTER_PX * len(remedy) <= (1.0 - share) * LINE_PX
    PREVIEW.sound_problem = ""


@pytest.mark.parametrize(
    ("name", "line_px", "shown"),
    [("HNF_PT_strokes", LINE_PX - 24.0, ("Stroke Tool", "Ready Strokes")),
     ("HNF_PT_materials", LINE_PX, ("One Place", "As Baked", "Units"))],
)  # fmt: skip
def test_what_shares_a_line_is_not_cut(
    name: str, line_px: float, shown: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the sidebar of its usual width; an icon and the arrow of a menu need room too."""
    fill()
    call, needed = Recorder._call, {}

    def note(self: Recorder, kind: str, values: tuple[object, ...], named: dict[str, object]) -> object:
        text = str(named.get("text", "Stroke Tool" if values == ("hnf.stroke_tool",) else ""))
        needed[text] = LETTER_PX * len(text) + 24.0 * ("icon" in named) + 20.0 * (kind in ("menu", "popover"))
        return call(self, kind, values, named)

    monkeypatch.setattr(Recorder, "_call", note)
    panel(name).draw(SimpleNamespace(layout=Recorder(), bl_rna=panel(name).bl_rna), context_of())
    assert max(needed[text] for text in shown) <= line_px / len(shown)


def test_nothing_moves_when_a_message_comes() -> None:
    bpy.data.materials.new("Oak")
    stroke = add_stroke("Rub", add_plane())
    finish_guide()
    heights = set()
    for kind in KINDS:
        warn(kind, stroke)
        heights.add(measured("HNF_PT_preview"))
        STATE.last_job, PREVIEW.sound_problem = None, ""
    STATE.job = JobStatus("Close-ups", 3, 12, 4.0, 11.0)
    heights.add(measured("HNF_PT_preview"))
    STATE.job = None
    PREVIEW.facts[stroke.name] = PreviewFacts(stroke.name, 1.2, playing=True, has_kept=True)
    heights.add(measured("HNF_PT_preview"))
    assert len(heights) == 1


def measured(name: str) -> tuple[int, float]:
    """Rows and height [px] of a panel's content at resolution scale 1."""
    layout = Sized()
    panel(name).draw(SimpleNamespace(layout=layout, bl_rna=panel(name).bl_rna), context_of())
    return layout.rows, layout.height


def test_the_tab_of_a_baked_stroke_fits_a_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """740 px of a 1280 × 800 window, 25 rows and 90 words, with what is open by default; a popover is one row."""
    plane = add_plane()
    plane.data.materials.append(bpy.data.materials.new("Oak table"))
    stroke = add_stroke("Left right on Plane", plane)
    STATE.get_statuses(bpy.context.scene)[stroke.name] = StrokeStatus(Freshness.FRESH, "", 1.2, "Plane", "oak-wood")
    PREVIEW.facts[stroke.name] = PreviewFacts(stroke.name, 1.2, lines=("1.20 s; peak 3 m/s², RMS 1 m/s²",))
    PREVIEW.icons[stroke.name] = 1
    monkeypatch.setattr("hnf_blender.ui.preview_panel.get_preview_icon", lambda _stroke: 1)
    rows, height, words = 0, 0.0, []
    for each in [each for each in PANELS if each.bl_region_type == "UI"]:
        parent = next((one for one in PANELS if one.__name__ == getattr(each, "bl_parent_id", "")), None)
        if parent is not None and "DEFAULT_CLOSED" in getattr(parent, "bl_options", ()):
            continue
        rows, height, words = rows + 1, height + HEADER_PX, [*words, each.bl_label]
        if "DEFAULT_CLOSED" in getattr(each, "bl_options", ()):
            continue
        content = Sized()
        each.draw(SimpleNamespace(layout=content, bl_rna=each.bl_rna), context_of())
        rows, height, words = rows + content.rows, height + content.height, [*words, *content.words]
    count = len(" ".join(words).split())
    assert rows <= 25
    assert height <= 740.0
    assert count <= 90
    print(f"rows {rows}, height {height:.0f} px, words {count}")


def test_custom_actuator_fields_show_only_for_a_custom_actuator() -> None:
    settings, own = bpy.context.scene.hnf, ["own_peak_m_s2", "own_lowest_hz", "own_highest_hz"]
    listed = drawn(panel("HNF_PT_actuator"))
    assert listed is not None
    live = ["live_pen_n", "live_mouse_n"]
    assert listed.props == ["actuator", *live]
    assert "30 m/s²" in listed.words
    settings.actuator = "own"
    entered = drawn(panel("HNF_PT_actuator"))
    assert entered is not None
    assert entered.props == ["actuator", *own, *live]
    assert "Source" not in entered.words
    for name in own:
        assert re.search(r"m/s²|Hz", settings.bl_rna.properties[name].description)


@pytest.mark.parametrize("row_px", [70.0, 105.0, 180.0, 250.0, 800.0])
def test_solo_and_mute_have_their_room_in_a_narrow_list(row_px: float) -> None:
    share = strokes_panel.compute_name_share(row_px)
    assert (1.0 - share) * row_px >= strokes_panel.SWITCHES_PX - 1e-9
    assert strokes_panel.MIN_SHARE <= share <= strokes_panel.NAME_SHARE


def test_what_was_told_of_another_scene_is_not_shown_here() -> None:
    fill()
    here = bpy.context.scene.name
    for scene, is_shown in ((here, True), ("Another", False)):
        STATE.last_job = LastJob(False, "It stopped.", scene=scene)
        STATE.plan = PlanView((PlanLine("needed", "a stroke", "because"),), 75.0, 48_321, scene)
        said, planned = tab("HNF_PT_details"), tab("HNF_PT_plan")
        assert ("It stopped." in said.words) is is_shown
        assert [text in planned.words for text in ("because", "1 min 15 s")] == [is_shown] * 2


def test_a_running_job_shows_its_stage_and_the_way_out() -> None:
    fill()
    STATE.job = JobStatus("Close-ups", 3, 12, 4.0, 11.0)
    shown = drawn(panel("HNF_PT_preview"), 600)
    assert shown is not None
    assert "Close-ups: 4 of 11, 11 s left" in shown.words
    assert "hnf.bake_cancel" in shown.operators
    assert {"hnf.bake", "hnf.preview_play"}.isdisjoint(shown.operators)


def test_the_preferences_draw_and_are_read() -> None:
    recorder = Recorder()
    declared = SimpleNamespace(properties=HnfPreferences.__annotations__)
    HnfPreferences.draw(SimpleNamespace(layout=recorder, bl_rna=declared), context_of())
    assert recorder.props == ["overlay", "default_probe", "external_python"]
    assert {"hnf.cache_clear", "hnf.diagnose_copy", "hnf.purge"} <= set(recorder.operators)
    assert "PyTorch" in recorder.words
    properties = {name: getattr(Settings(), name) for name in HnfPreferences.__annotations__}
    assert get_settings(bpy.context) == Settings(**properties)  # where Blender keeps none


def test_the_ready_strokes_are_the_primitives() -> None:
    menu = bpy.types.HNF_MT_stroke_add
    recorder = Recorder()
    menu.draw(type("Menu", (), {"layout": recorder})(), bpy.context)
    chosen = [value for operator, name, value in recorder.given if (operator, name) == ("hnf.stroke_add", "primitive")]
    assert chosen == list(PRIMITIVES)
    assert ("hnf.stroke_add", "dialog", True) in recorder.given
    assert "0.5 N, 100 mm/s" in recorder.words


def test_the_active_stroke_is_selected_then_listed_then_only_one() -> None:
    first, second = add_stroke("A"), add_stroke("B")
    scene = bpy.context.scene
    assert get_active_stroke(bpy.context) == second
    bpy.context.view_layer.objects.active = add_plane()
    scene.hnf.stroke_index = scene.objects.find("A")
    assert get_active_stroke(bpy.context) == first
    scene.hnf.stroke_index = scene.objects.find("Plane")
    assert get_active_stroke(bpy.context) is None
    bpy.data.objects.remove(second)
    scene.hnf.stroke_index = 99
    assert get_active_stroke(bpy.context) == first


def test_every_operator_and_its_properties_have_tooltips() -> None:
    bare = []
    for each in collect_classes("hnf_blender.ops", hnf_blender.ops.MODULES):
        if issubclass(each, bpy.types.Operator):
            rna = rna_of(each.bl_idname)
            bare += [each.bl_idname] if not rna.description.strip() else []
            own = [prop for prop in rna.properties if prop.identifier in each.__annotations__ and not prop.is_hidden]
            bare += [f"{each.bl_idname}.{prop.identifier}" for prop in own if not prop.description.strip()]
    assert bare == []


SWITCHING = """
import bpy, sys, os
sys.path.insert(0, {root!r})

def left():
    names = {{name for name in dir(bpy.types) if "hnf" in name.lower()}}
    owned = {{f"{{owner}}.{{name}}" for owner in ("Object", "Scene", "Material")
             for name in dir(getattr(bpy.types, owner)) if name.startswith("hnf")}}
    listed = {{(kind, getattr(each, "__name__", str(each))) for kind in dir(bpy.app.handlers)
              if isinstance(getattr(bpy.app.handlers, kind), list) for each in getattr(bpy.app.handlers, kind)}}
    keys = {{(config.name, keymap.name, item.idname) for config in bpy.context.window_manager.keyconfigs
            for keymap in config.keymaps for item in keymap.keymap_items if item.idname.startswith("hnf")}}
    drawn = {{(menu, each.__module__) for menu in dir(bpy.types)
             for each in getattr(getattr(getattr(bpy.types, menu), "draw", None), "_draw_funcs", ())
             if each.__module__.startswith("hnf")}}
    return names, owned, listed, keys, drawn

before = left()
import hnf_blender
for _ in range(50):
    hnf_blender.register()
    on = left()
    hnf_blender.unregister()
    assert left() == before, (left(), before)
assert len(on[0]) > 20, on
print("CLEAN", flush=True)
os._exit(0)
"""


def test_switched_on_and_off_50_times_it_leaves_nothing() -> None:
    run = subprocess.run(
        [sys.executable, "-c", SWITCHING.format(root=str(ROOT))],
        capture_output=True,
        text=True,
        timeout=120,
        stdin=subprocess.DEVNULL,
    )
    assert "CLEAN" in run.stdout, run.stdout + run.stderr
    assert "Error" not in run.stdout + run.stderr
    assert "Warning" not in run.stdout + run.stderr


BROKEN = """
import bpy, sys, os
sys.path.insert(0, {root!r})
sys.modules["hnf_blender.ui.strokes_panel"] = None  # importing it fails
import hnf_blender
from hnf_blender import error_panel
try:
    hnf_blender.register()
except ImportError as error:
    print("RAISED", flush=True)
    left = [name for name in dir(bpy.types) if "hnf" in name.lower()]
    assert left == [], left
    error_panel.register(error)  # what a Blender with a window does at this point
    assert hasattr(bpy.types, "HNF_PT_rescue")
    words = error_panel.explain_error(error)
    assert "strokes_panel" in words and "install" in words, words
    assert "Traceback" in error_panel.format_report(error)
hnf_blender.unregister()
left = [name for name in dir(bpy.types) if "hnf" in name.lower()]
assert left == [], left
del sys.modules["hnf_blender.ui.strokes_panel"]
hnf_blender.register()
assert hasattr(bpy.types, "HNF_PT_strokes")
hnf_blender.unregister()
print("RESCUED", flush=True)
os._exit(0)
"""


def test_a_failed_registration_is_undone_and_explained() -> None:
    run = subprocess.run(
        [sys.executable, "-c", BROKEN.format(root=str(ROOT))],
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
    )
    assert "RAISED" in run.stdout, run.stdout + run.stderr
    assert "RESCUED" in run.stdout, run.stdout + run.stderr
