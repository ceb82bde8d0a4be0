"""What an artist never forgives: lost work. Undo, reload, other people's files, several windows, Edit Mode."""

import random

import bpy
from drive import scenery
from drive.addon import MODULE, baked, freshness, kept, ours, start_bake, state, strokes

SMOOTH = "no"  # nobody looks at how its 3-D view is drawn
STEPS = 200
SEED = 20260
BAKES = 8  # among the steps; the others are edits, undos and redos


def everything():
    """What is kept, and the mesh that the walk dents."""
    mesh = bpy.data.objects["Plate"].data
    return kept() | {"mesh": [round(vertex.co.z, 8) for vertex in mesh.vertices]}


class Walk:
    """A random walk of edits beside a model of Blender's undo stack: what the file must hold after each step."""

    def __init__(self, stage) -> None:
        self.stage, self.random = stage, random.Random(SEED)
        self.past, self.place, self.log = [everything()], 0, []
        self.done = {"edit": 0, "undo": 0, "redo": 0, "bake": 0, "cancel": 0, "met a bake": 0}
        self.known_job = state().last_job

    def pushed(self, what: str) -> None:
        """An undo step was made: what lay ahead is gone."""
        del self.past[self.place + 1 :]
        self.past.append(everything())
        self.place += 1
        self.log.append(what)

    def compare(self, what: str) -> None:
        expected, found = self.past[self.place], everything()
        if found != expected:
            bpy.context.window_manager.print_undo_steps()
            wrong = [key for key in expected | found if expected.get(key) != found.get(key)]
            self.stage.require(
                f"step {len(self.log)}: {what} keeps everything",
                False,
                f"{wrong}: {[(expected.get(key), found.get(key)) for key in wrong]} after {self.log[-6:]}",
            )

    def undo(self):
        yield from self.travel("undo", -1)

    def redo(self):
        yield from self.travel("redo", +1, shift=True)

    def travel(self, what: str, way: int, **held: bool):
        """Ctrl-Z or Shift-Ctrl-Z. Where a bake wrote its result in between, nobody can say which came first: the walk
        then begins a new history."""
        jobs_before = state().last_job
        yield from self.stage.key("Z", ctrl=True, **held)
        yield 0.12
        self.log.append(what)
        self.done[what] += 1
        if state().last_job is not jobs_before:
            self.past, self.place, self.known_job = [everything()], 0, state().last_job
            self.done["met a bake"] += 1
            return
        self.place += way
        self.compare(what)

    def notice_a_bake(self) -> None:
        """A bake that ended since the last step made an undo step where it wrote something."""
        if state().last_job is self.known_job:
            return
        self.known_job = state().last_job
        if everything() != self.past[self.place]:
            self.pushed("bake")
            self.done["bake"] += 1

    def edit(self):
        what = self.random.choice(EDITS)
        if what(self.random) is not False:
            bpy.ops.ed.undo_push(message=what.__name__)
            self.pushed(what.__name__)
            self.done["edit"] += 1
        yield 0.02

    def bake(self, cancel: bool):
        start_bake(self.stage)
        for _ in range(self.random.randrange(4)):  # life goes on meanwhile
            yield from self.any_step()
        if cancel and state().job is not None:
            yield from self.stage.key("ESC")
            self.done["cancel"] += 1
        yield from self.stage.until("a bake of the walk ends", lambda: state().job is None, 90.0)
        yield from self.stage.key("ESC")  # an error that popped up at the mouse would take the next key
        yield 0.3
        self.notice_a_bake()
        self.log.append(f"({state().last_job.message})" if state().last_job else "(no bake)")

    def any_step(self):
        self.notice_a_bake()
        roll = self.random.random()
        if roll < 0.3 and self.place > 0:
            yield from self.undo()
        elif roll < 0.5 and self.place + 1 < len(self.past):
            yield from self.redo()
        else:
            yield from self.edit()


def some_stroke(dice):
    return dice.choice(strokes()) if strokes() else None


def key_force(dice):
    obj = some_stroke(dice)
    if obj is None:
        return False
    obj.hnf_stroke.force = round(dice.uniform(0.2, 3.0), 3)
    obj.keyframe_insert("hnf_stroke.force", frame=dice.randrange(1, 14))


def move_a_point(dice):
    obj = some_stroke(dice)
    if obj is None:
        return False
    point = obj.data.splines[0].points[0]
    point.co = (point.co[0] + dice.uniform(-0.004, 0.004), point.co[1] + dice.uniform(-0.004, 0.004), point.co[2], 1.0)


def change_the_seed(dice):
    obj = some_stroke(dice)
    if obj is None:
        return False
    obj.hnf_stroke.seed += 1


def mute(dice):
    obj = some_stroke(dice)
    if obj is None:
        return False
    obj.hnf_stroke.mute = not obj.hnf_stroke.mute


def rename(dice):
    obj = some_stroke(dice)
    if obj is None:
        return False
    obj.name = f"Renamed {dice.randrange(1000)}"


def add_a_stroke(dice):
    plate = bpy.data.objects.get("Plate")
    if plate is None or len(strokes()) > 4:
        return False
    scenery.stroke_on(plate, "Another", 0.02, seconds=0.4, turned=dice.uniform(0.0, 3.0))


def delete_a_stroke(dice):
    if len(strokes()) < 3:
        return False
    bpy.data.objects.remove(some_stroke(dice))


def choose_a_material(dice):
    material = bpy.data.objects["Plate"].active_material
    library = [item[0] for item in ours("ops.material_ops").list_library_items()]
    material.hnf_touch.library = dice.choice([*library[:5], ""])


def dent_the_mesh(dice):
    mesh = bpy.data.objects["Plate"].data
    mesh.vertices[dice.randrange(len(mesh.vertices))].co.z += dice.uniform(-1e-5, 1e-5)
    mesh.update()


EDITS = (
    key_force, key_force, move_a_point, change_the_seed, mute, rename, add_a_stroke, delete_a_stroke,
    choose_a_material, dent_the_mesh,
)  # fmt: skip


def check_two_hundred_random_steps_lose_nothing(stage):
    bpy.context.preferences.edit.undo_steps = 256
    scenery.empty_room()
    plate = scenery.plate(cuts=4)
    for k in range(3):
        scenery.stroke_on(plate, f"Stroke {k}", 0.02, seconds=0.5, turned=0.6 * k)
    yield from scenery.look_at(stage, plate)
    yield from stage.show_tab()
    bpy.ops.ed.undo_push(message="begin")
    walk = Walk(stage)
    bakes = sorted(walk.random.sample(range(10, STEPS), BAKES))
    for step in range(STEPS):
        if step in bakes:
            yield from walk.bake(cancel=bakes.index(step) % 3 == 2)
        else:
            yield from walk.any_step()
    stage.expect("all steps were taken", len(walk.log) >= STEPS, walk.done)
    stage.expect(
        "of every kind", all(walk.done[each] for each in ("edit", "undo", "redo", "bake", "cancel")), walk.done
    )
    stage.measured("random steps", len(walk.log), f"({walk.done})")
    yield from stage.picture("after-the-random-walk")
    while walk.place > 0:
        yield from walk.undo()
    stage.expect("undone to the beginning it is as at the beginning", everything() == walk.past[0])


def check_saved_in_mid_bake_and_opened(stage):
    scenery.empty_room()
    plate = scenery.plate(cuts=4)
    for k in range(2):
        scenery.stroke_on(plate, f"Stroke {k}", 0.02, seconds=0.5, turned=0.6 * k)
    yield 0.3
    yield from baked(stage)
    before = kept()
    strokes()[0].hnf_stroke.seed = 5
    start_bake(stage)
    yield 0.5
    path = str(stage.folder / "kept.blend")
    with stage.over():
        bpy.ops.wm.save_as_mainfile(filepath=path)
    now = kept()
    with stage.over():
        bpy.ops.wm.open_mainfile(filepath=path)
    yield 1.0
    stage.expect("what was baked before is there", kept() == now, kept())
    stage.expect("the running bake ended with its file", state().job is None, state().job)
    stage.expect("its strokes too", sorted(kept()) == sorted(before), kept())
    yield from stage.until("the panel knows the file", lambda: freshness("Stroke 1") == "fresh", 10.0)


def check_a_file_survives_a_blender_without_the_add_on(stage):
    import addon_utils

    path = str(stage.folder / "kept.blend")
    before = kept()
    addon_utils.disable(MODULE)
    yield 0.2
    with stage.over():
        bpy.ops.wm.open_mainfile(filepath=path)
    yield 0.6
    stage.expect("the add-on is off", not hasattr(bpy.types.Object, "hnf_stroke"))
    bpy.ops.mesh.primitive_cube_add(size=0.01, location=(0.2, 0.0, 0.0))
    without = str(stage.folder / "saved-without.blend")
    with stage.over():
        bpy.ops.wm.save_as_mainfile(filepath=without)
        bpy.ops.wm.open_mainfile(filepath=without)
    yield 0.6
    addon_utils.enable(MODULE)
    yield 0.4
    stage.expect("nothing is lost when it is on again", kept() == before, (before, kept()))
    yield from stage.until("and it is fresh", lambda: freshness("Stroke 1") == "fresh", 10.0)


def check_a_mesh_edited_after_the_bake_is_stale(stage):
    plate = bpy.data.objects["Plate"]
    yield from scenery.look_at(stage, plate)
    yield from stage.key("TAB")
    yield 0.4
    stage.require("Edit Mode", bpy.context.object.mode == "EDIT", bpy.context.object.mode)
    yield from stage.show_tab()
    yield from stage.picture("edit-mode")
    with stage.over():
        bpy.ops.mesh.select_all(action="SELECT")
        bpy.ops.mesh.subdivide(number_cuts=1)
        bpy.ops.transform.resize(value=(1.2, 1.0, 1.0))
    yield from stage.key("TAB")
    yield 0.4
    stage.require("Object Mode again", bpy.context.object.mode == "OBJECT", bpy.context.object.mode)
    yield from stage.until("it is shown as stale", lambda: freshness("Stroke 1") == "stale", 10.0)
    yield from stage.picture("stale")


def check_several_windows(stage):
    with stage.over():
        bpy.ops.wm.window_new()
    yield 1.0
    stage.require("two windows", len(bpy.context.window_manager.windows) == 2)
    yield from baked(stage)
    stage.expect("baked with two windows open", freshness("Stroke 1") == "fresh", freshness("Stroke 1"))
    start = kept()
    strokes()[0].hnf_stroke.seed += 1
    start_bake(stage)
    yield 0.3
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[1]):
        bpy.ops.wm.window_close()
    yield from stage.until("the bake ends though a window closed", lambda: state().job is None, 60.0)
    stage.expect("strokes are all there", sorted(kept()) == sorted(start))


def check_duplicate_append_and_rename(stage):
    before = len(strokes())
    path = str(stage.folder / "kept.blend")
    with bpy.data.libraries.load(path) as (there, here):
        here.objects = [name for name in there.objects if name.startswith("Stroke")]
    for obj in here.objects:
        bpy.context.scene.collection.objects.link(obj)
    yield 0.5
    stage.expect("appended strokes are strokes", len(strokes()) == before + 2, [obj.name for obj in strokes()])
    strokes()[0].name = "A stroke with a very long name that no list of this narrow sidebar can ever show whole"
    yield 0.3
    yield from stage.show_tab()
    yield from stage.picture("long-names")
    with bpy.data.libraries.load(path, link=True) as (there, here):
        here.objects = ["Stroke 0"]
    bpy.context.scene.collection.objects.link(here.objects[0])
    yield 0.5
    stage.expect("a linked stroke is listed", any(obj.library for obj in strokes()))
    yield from stage.picture("linked")


def check_two_scenes(stage):
    first = bpy.context.scene
    with stage.over():
        bpy.ops.scene.new(type="NEW")
    yield 0.4
    stage.expect("the new scene has no strokes", strokes() == [])
    yield from stage.picture("second-scene")
    stage.window().scene = first
    yield 0.3
    stage.expect("the first keeps its own", len(strokes()) > 1)
