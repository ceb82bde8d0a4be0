"""Differences between Blender versions: 4.2 LTS, 4.5 LTS, 5.0 and later. No other file checks the version."""

from __future__ import annotations

import importlib
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class WorkLock:
    """Lock of everything that computes: handed on in the order in which it was asked for, to an operator first.

    Threads take it with `with`, an operator with `lock_for_operator`. It is not reentrant.
    """

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._is_held = False
        self._operators: deque[threading.Event] = deque()
        self._threads: deque[threading.Event] = deque()

    @property
    def is_wanted(self) -> bool:
        """True while an operator waits, for whom a thread should stop as soon as it can."""
        return bool(self._operators)

    def give_way(self) -> None:
        """Let all that wait go first; called between two steps by a thread that holds the lock."""
        if self._operators or self._threads:
            self._release()
            self._acquire(self._threads)

    @contextmanager
    def lock_for_operator(self) -> Iterator[None]:
        """Hold the lock in Blender's main thread, before all threads that wait."""
        self._acquire(self._operators)
        try:
            yield
        finally:
            self._release()

    def __enter__(self) -> None:
        self._acquire(self._threads)

    def __exit__(self, *_: object) -> None:
        self._release()

    def _acquire(self, waiting: deque[threading.Event]) -> None:
        turn = threading.Event()
        with self._guard:
            if not self._is_held:
                self._is_held = True
                return
            waiting.append(turn)
        try:
            turn.wait()
        except BaseException:
            with self._guard:
                is_ours = turn not in waiting
                if not is_ours:
                    waiting.remove(turn)
            if is_ours:
                self._release()
            raise

    def _release(self) -> None:
        # The lock stays held and only the next one is woken: nobody else may run beside an operator.
        with self._guard:
            waiting = self._operators or self._threads
            self._is_held = bool(waiting)
            if waiting:
                waiting.popleft().set()


WORK_LOCK = WorkLock()
"""Held by a thread while it computes, and while an operator reads an overridden context."""


def version() -> tuple[int, int, int]:
    """Return Blender's version as (major, minor, patch)."""
    import bpy

    major, minor, patch = bpy.app.version
    return int(major), int(minor), int(patch)


def version_text() -> str:
    """Return Blender's version as shown to a person, e.g. "5.2.2 LTS"."""
    import bpy

    return str(bpy.app.version_string)


@contextmanager
def override_context(**members: Any) -> Iterator[None]:
    """Override members of the context for an operator, while no thread of ours computes.

    Notes
    -----
    A script's operator gives Python's lock away. With Python 3.11 (Blender 5.0 and earlier) Blender takes the lock of
    *any* thread for its own then, and reads the override without one: it crashes where another thread runs.
    """
    import bpy

    with WORK_LOCK.lock_for_operator(), bpy.context.temp_override(**members):
        yield


def beside_the_file() -> set[str]:
    """Return the `options` of a path property whose value may begin with "//" (relative to the .blend).

    Blender 4.5 and later warn if the option is missing; earlier versions do not know it.
    """
    return {"PATH_SUPPORTS_BLEND_RELATIVE"} if version() >= (4, 5, 0) else set()


def use_multilayer_exr(render: Any) -> None:
    """Set the render output to a float32 multilayer EXR, so that passes can be read without a compositor.

    It is not compressed: the file is read once and deleted, and ZIP took a sixth of a close-up render's time.
    """
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # 5.0: the file format enum depends on it
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"
    settings.exr_codec = "NONE"


def use_nodes(material: Any) -> bool:
    """Return True if Blender shades the material by its nodes; always true from 5.0 on."""
    if material.node_tree is None:
        return False
    return True if version() >= (5, 0, 0) else bool(material.use_nodes)


def switch_nodes_on(datablock: Any) -> None:
    """Give a material or world a node tree.

    From 5.0 on every new one has a node tree, and setting `use_nodes` is deprecated.
    """
    if datablock.node_tree is None or version() < (5, 0, 0):
        datablock.use_nodes = True


def fcurves_of(id_data: Any) -> list[Any]:
    """Return the F-curves that animate this very datablock.

    An object and its data may share one action in two slots; only the datablock's own slot is read.
    """
    animation = getattr(id_data, "animation_data", None)
    action = None if animation is None else animation.action
    if action is None:
        return []
    slot = getattr(animation, "action_slot", None)
    if not hasattr(animation, "action_slot"):  # 4.2 and 4.3: no slots
        return list(action.fcurves)
    if slot is None:
        return []
    if hasattr(action, "fcurves") and version() < (5, 0, 0) and not getattr(action, "is_action_layered", False):
        return list(action.fcurves)
    bag = _channelbag(action, slot)
    return [] if bag is None else list(bag.fcurves)


def _channelbag(action: Any, slot: Any) -> Any:
    """Return the channel bag (F-curves) of an action's slot, or None.

    Blender so far supports only one layer with one keyframe strip.
    """
    for layer in action.layers:
        for strip in layer.strips:
            bag = strip.channelbag(slot)
            if bag is not None:
                return bag
    return None


def working_space() -> str:
    """Return the color space in which shaders compute, "" for Linear Rec.709.

    Linear Rec.709 is the only one before 5.0.
    """
    import bpy

    spaces = getattr(bpy.data, "colorspace", None)
    name = str(getattr(spaces, "working_space", ""))
    return "" if name == "Linear Rec.709" else name


def has_denoiser() -> bool:
    """Return True if this build includes Open Image Denoise.

    Builds of Linux distributions may lack it; they then fail, or skip denoising silently.
    """
    try:
        cycles = importlib.import_module("_cycles")
    except ImportError:
        return False
    return bool(getattr(cycles, "with_openimagedenoise", False))


def fcurves_of_slot(action: Any, strip: Any) -> list[Any]:
    """Return the F-curves of the action that an NLA strip plays."""
    slot = getattr(strip, "action_slot", None)
    if not hasattr(strip, "action_slot") or (version() < (5, 0, 0) and not getattr(action, "is_action_layered", False)):
        return list(action.fcurves)
    if slot is None:
        return []
    bag = _channelbag(action, slot)
    return [] if bag is None else list(bag.fcurves)


def own_action(animated: Any) -> None:
    """Give a datablock that shares its action with others a copy of the action, in the same slot."""
    animation = getattr(animated, "animation_data", None)
    if animation is None or animation.action is None:
        return
    slot = getattr(animation, "action_slot", None)
    identifier = None if slot is None else str(slot.identifier)
    animation.action = animation.action.copy()
    if identifier is not None:
        animation.action_slot = next(slot for slot in animation.action.slots if slot.identifier == identifier)


def show_in_sequencer(workspace: Any, scene: Any) -> None:
    """Show a scene in the workspace's sequencers if they show none yet.

    Up to Blender 4.5 sequencers show the window's scene, and nothing is done.
    """
    if workspace is not None and hasattr(workspace, "sequencer_scene") and workspace.sequencer_scene is None:
        workspace.sequencer_scene = scene


def sequencer_strips(editor: Any) -> Any:
    """Return the strips of a sequence editor, which are called sequences up to 4.3."""
    return editor.strips if hasattr(editor, "strips") else editor.sequences
