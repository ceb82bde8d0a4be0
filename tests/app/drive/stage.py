"""Hands and eyes on a Blender window: events at places of the screen, waiting, looking, photographs."""

import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d

from .record import Record

TICK_S = 0.05
Waits = Iterator[float]
Point = tuple[int, int]
PRINTED = {"SPACE": " ", "PERIOD": ".", "MINUS": "-"} | dict(
    zip(("ZERO", "ONE", "TWO", "THREE", "FOUR", "FIVE", "SIX", "SEVEN", "EIGHT", "NINE"), "0123456789", strict=True)
)


class MissedError(Exception):
    """What was waited for or required did not come."""


class Stage:
    """folder: where pictures go. Nothing of Blender's is kept between two steps: undo and reload invalidate it."""

    def __init__(self, folder: Path, record: Record) -> None:
        self.folder = folder
        self._record = record
        self.memory: dict[str, object] = {}
        """What one check leaves for those after it."""

    # ---- what is seen

    def expect(self, what: str, truth: object, detail: object = "") -> None:
        """Write down whether it is so, and go on."""
        self._record.write("expect", what=what, ok=bool(truth), detail=str(detail))

    def require(self, what: str, truth: object, detail: object = "") -> None:
        """As expect, but the check ends here where it is not so."""
        self.expect(what, truth, detail)
        if not truth:
            raise MissedError(f"{what}: {detail}")

    def measured(self, what: str, value: float, unit: str) -> None:
        """A figure for the report; nothing depends on it."""
        self._record.write("measured", what=what, value=round(value, 4), unit=unit)

    def until(self, what: str, predicate: Callable[[], object], seconds: float = 20.0) -> Waits:
        """Let Blender run until predicate() holds; MissedError after some seconds."""
        deadline = time.monotonic() + seconds
        while not predicate():
            if time.monotonic() > deadline:
                self.require(what, False, f"not within {seconds:g} s")
            yield TICK_S
        self.expect(what, True)

    def photograph(self, name: str, part: Sequence[int] = ()) -> Path:
        """The screen as it is drawn now, to folder/NAME.png. part: left, top, width, height of it [pixels]."""
        path = self.folder / f"{name}.png"
        of = ["-a", ",".join(map(str, part))] if part else []
        subprocess.run(["scrot", "-o", *of, str(path)], check=True, timeout=30)
        return path

    def picture(self, name: str, settle: float = 0.6) -> Waits:
        """Redraw everything, wait, photograph."""
        for area in self.areas():
            area.tag_redraw()
        yield settle
        self.photograph(name)

    # ---- where things are

    def window(self, index: int = 0):
        return bpy.context.window_manager.windows[index]

    def areas(self) -> list:
        return [area for window in bpy.context.window_manager.windows for area in window.screen.areas]

    def area(self, kind: str = "VIEW_3D", window: int = 0):
        """The largest area of this kind. MissedError where there is none."""
        found = [area for area in self.window(window).screen.areas if area.type == kind]
        if not found:
            raise MissedError(f"no {kind} area")
        return max(found, key=lambda area: area.width * area.height)

    def region(self, kind: str = "WINDOW", area: str = "VIEW_3D", window: int = 0):
        return next(region for region in self.area(area, window).regions if region.type == kind)

    def over(self, area: str = "VIEW_3D", region: str = "WINDOW", window: int = 0):
        """Context manager: operators run as if the mouse were there."""
        return bpy.context.temp_override(
            window=self.window(window), area=self.area(area, window), region=self.region(region, area, window)
        )

    def seen_at(self, point: Sequence[float]) -> Point:
        """Where a place of the scene is drawn, in pixels of the window. MissedError where it is behind the eye."""
        region = self.region()
        place = location_3d_to_region_2d(region, self.area().spaces.active.region_3d, point)
        if place is None:
            raise MissedError(f"{tuple(point)} is not in view")
        return region.x + round(place.x), region.y + round(place.y)

    def middle(self, area: str = "VIEW_3D", region: str = "WINDOW") -> Point:
        box = self.region(region, area)
        return box.x + box.width // 2, box.y + box.height // 2

    # ---- what a hand does

    def event(self, kind: str, value: str, at: Point, **held: bool) -> None:
        """One event; held: shift, ctrl, alt."""
        self.window().event_simulate(type=kind, value=value, x=at[0], y=at[1], **held)

    def move(self, at: Point) -> Waits:
        self.event("MOUSEMOVE", "NOTHING", at)
        yield TICK_S

    def click(self, at: Point, button: str = "LEFTMOUSE", **held: bool) -> Waits:
        yield from self.move(at)
        self.event(button, "PRESS", at, **held)
        yield TICK_S
        self.event(button, "RELEASE", at, **held)
        yield TICK_S

    def drag(self, path: Sequence[Point], pause: float = 0.02, **held: bool) -> Waits:
        """Press at the first point, move through all, release at the last."""
        yield from self.move(path[0])
        self.event("LEFTMOUSE", "PRESS", path[0], **held)
        for at in path[1:]:
            yield pause
            self.event("MOUSEMOVE", "NOTHING", at, **held)
        yield TICK_S
        self.event("LEFTMOUSE", "RELEASE", path[-1], **held)
        yield TICK_S

    def key(self, kind: str, at: Point | None = None, **held: bool) -> Waits:
        """Press and release a key while the mouse is there (the middle of the 3-D view)."""
        at = self.middle() if at is None else at
        yield from self.move(at)
        text = PRINTED.get(kind, kind.lower() if len(kind) == 1 else "")
        typed = {"unicode": text} if text and not (held.get("ctrl") or held.get("alt")) else {}
        self.window().event_simulate(type=kind, value="PRESS", x=at[0], y=at[1], **typed, **held)
        yield TICK_S
        self.event(kind, "RELEASE", at, **held)
        yield TICK_S

    # ---- the room

    def drawn(self, region: str = "UI") -> Waits:
        """Until a region of the 3-D view has been drawn once more: before that it has no size, tabs or matrices."""
        seen: list[int] = []
        handle = bpy.types.SpaceView3D.draw_handler_add(seen.append, (1,), region, "POST_PIXEL")
        try:
            deadline = time.monotonic() + 20.0
            while not seen:
                if time.monotonic() > deadline:
                    raise MissedError(f"the {region} region of the 3-D view is not drawn")
                self.area().tag_redraw()
                yield TICK_S
        finally:
            bpy.types.SpaceView3D.draw_handler_remove(handle, region)

    def show_tab(self, category: str = "Touch") -> Waits:
        """Open the sidebar of the 3-D view at a tab."""
        yield from self.drawn("WINDOW")  # Blender 5.2 crashes where the file was opened in this very tick
        self.area().spaces.active.show_region_ui = True
        yield from self.drawn()
        self.region("UI").active_panel_category = category
        yield from self.drawn()
        yield 0.2

    def widen_sidebar(self, width: int) -> Waits:
        """Drag the sidebar's edge until it is this many pixels wide, more or less."""
        box = self.region("UI")
        edge, y = box.x, box.y + box.height // 3
        yield from self.drag([(edge, y), (edge - 4, y), (box.x + box.width - width, y)], pause=0.15)
        yield from self.drawn()

    def take_sound_device(self) -> str:
        """Let Blender play to a device that goes nowhere, in real time (see App.window); its name, "None" = there is
        none."""
        system = bpy.context.preferences.system
        for name in ("OpenAL", "SDL", "PulseAudio"):
            try:
                system.audio_device = name
            except TypeError:  # this Blender is built without it
                continue
            return name
        return str(system.audio_device)
