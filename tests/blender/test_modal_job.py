"""Modal job operators restore the screen however the job ends."""

from __future__ import annotations

import time
from types import SimpleNamespace

import bpy
import pytest
from job_scene import LIMIT_S, NOTHING, is_gone, kept, kill, my_folders, reach, small_scene

from hnf_blender.jobs import manager as current
from hnf_blender.jobs.bake_process import get_process
from hnf_blender.ops.operator_base import ModalJob, poll_no_job
from hnf_blender.state.session_state import STATE, LastJob
from hnf_core.errors import HnfError

VIEW, TEXT = (
    SimpleNamespace(type=kind, x=x, y=0, width=80, height=100, regions=())
    for kind, x in (("VIEW_3D", 0), ("TEXT_EDITOR", 80))
)
"""Two editors of a window, side by side."""
ESC, TICK, MOVE = (
    SimpleNamespace(type=kind, value=value, mouse_x=40, mouse_y=50)
    for kind, value in (("ESC", "PRESS"), ("TIMER", "NOTHING"), ("MOUSEMOVE", ""))
)


class Screen:
    """What an operator puts up: timers that tick, the status bar's text."""

    def __init__(self) -> None:
        self.timers: list[object] = []
        self.status: str | None = None
        scene, layer = bpy.context.scene, bpy.context.view_layer
        manager = SimpleNamespace(event_timer_add=self._add, event_timer_remove=self.timers.remove)
        self.context = SimpleNamespace(
            scene=scene, view_layer=layer, window_manager=manager,
            window=SimpleNamespace(screen=SimpleNamespace(areas=[VIEW, TEXT])),
            workspace=SimpleNamespace(status_text_set=self._say),
        )  # fmt: skip

    @property
    def is_bare(self) -> bool:
        return not self.timers and self.status is None

    def _add(self, _seconds: float, window: object) -> object:
        self.timers.append(timer := object())
        return timer

    def _say(self, text: str | None) -> None:
        self.status = text


class Operator(ModalJob):
    """reported: words of every report. ended: how the jobs did."""

    def __init__(self) -> None:
        self.reported: list[str] = []
        self.ended: list[LastJob] = []

    def report(self, _kind: set[str], message: str) -> None:
        self.reported.append(message)

    def format_status(self, job) -> str:
        return f"Busy: {job.stage}"

    def report_end(self, ended: LastJob) -> set[str]:
        self.ended.append(ended)
        return {"FINISHED"} if ended.written else {"CANCELLED"}


@pytest.fixture
def begun(warm_bake):
    """An operator whose job runs; its screen; the child."""
    small_scene()
    operator, screen, made = Operator(), Screen(), []

    def start() -> None:
        made.append(current.start_bake(screen.context.scene, screen.context.view_layer))

    assert operator.start_job(screen.context, start)
    assert len(screen.timers) == 1
    assert screen.status.startswith("Busy: ")
    assert reach("opening")
    return operator, screen, made[0].pid


def ticked(operator: Operator, screen: Screen) -> set[str]:
    """Blender's timer, until the operator has ended."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        answer = operator.modal(screen.context, TICK)
        if answer != {"PASS_THROUGH"}:
            return answer
        assert len(screen.timers) == 1
        time.sleep(0.01)
    raise AssertionError(f"it did not end: {STATE.job}")


def is_over(screen: Screen, pid: int) -> bool:
    return screen.is_bare and not current.is_running() and is_gone(pid) and my_folders() == []


def test_a_job_that_runs_lets_events_pass_and_ends_by_itself(begun) -> None:
    operator, screen, pid = begun
    assert not poll_no_job(SimpleNamespace(poll_message_set=operator.reported.append))
    assert "press Esc" in operator.reported.pop()
    assert operator.modal(screen.context, MOVE) == {"PASS_THROUGH"}
    assert ticked(operator, screen) == {"FINISHED"}
    assert [ended.ok for ended in operator.ended] == [True]
    assert list(kept()["bakes"]) == ["Along"]
    assert screen.is_bare
    assert my_folders() == []
    assert get_process().pid == pid  # it waits for the next
    assert poll_no_job(operator)
    current.close()
    assert is_over(screen, pid)


def test_esc_cancels_in_the_view_and_passes_to_other_editors(begun) -> None:
    operator, screen, pid = begun
    beside = SimpleNamespace(**vars(ESC) | {"mouse_x": 120})
    assert operator.modal(screen.context, beside) == {"PASS_THROUGH"}
    assert current.is_running()
    assert operator.modal(screen.context, ESC) == {"CANCELLED"}
    assert "canceled" in operator.ended[0].message
    assert kept() == NOTHING
    assert is_over(screen, pid)


def test_cancelled_from_elsewhere_it_is_told_at_the_next_event(begun) -> None:
    operator, screen, pid = begun
    current.cancel()
    assert operator.modal(screen.context, MOVE) == {"CANCELLED"}
    assert "canceled" in operator.ended[0].message
    assert is_over(screen, pid)


def test_where_blender_ends_it_nothing_is_told(begun) -> None:
    operator, screen, pid = begun
    operator.cancel(screen.context)
    assert operator.ended == []
    assert is_over(screen, pid)


def test_a_dead_child_is_told(begun) -> None:
    operator, screen, pid = begun
    kill(pid)
    assert ticked(operator, screen) == {"CANCELLED"}
    assert "killed (signal 9)" in operator.ended[0].message
    assert is_over(screen, pid)


def test_an_internal_error_is_raised_and_the_screen_restored(begun, monkeypatch) -> None:
    operator, screen, _pid = begun

    def fails() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(current, "tick", fails)
    with pytest.raises(ZeroDivisionError):
        operator.modal(screen.context, TICK)
    assert operator.ended == []
    assert screen.is_bare


def test_what_cannot_be_begun_is_reported_and_puts_nothing_up(lone_bake) -> None:
    def refuse() -> LastJob:
        raise HnfError("there is nothing to do.", remedy="Draw a stroke.")

    operator, screen = Operator(), Screen()
    assert not operator.start_job(screen.context, refuse)
    assert operator.run_blocking(refuse) == {"CANCELLED"}
    assert operator.reported == ["There is nothing to do. Draw a stroke."] * 2
    assert operator.ended == []
    assert screen.is_bare


def test_in_line_the_end_is_told_as_in_a_window(lone_bake) -> None:
    operator, ended = Operator(), LastJob(True, "Done.", written=1)
    assert operator.run_blocking(lambda: ended) == {"FINISHED"}
    assert operator.ended == [ended]


def test_picking_waits_for_clicks_in_the_view_alone() -> None:
    from hnf_blender.ops.material_ops import HNF_OT_probe

    view = SimpleNamespace(**vars(VIEW) | {"regions": [SimpleNamespace(type="WINDOW", x=0, y=0, width=80, height=100)]})
    context, ended = SimpleNamespace(window=SimpleNamespace(screen=SimpleNamespace(areas=[view, TEXT]))), []
    operator = SimpleNamespace(finish=lambda context, why: ended.append(why) or {"CANCELLED"})

    def answer(kind: str, x: int) -> set[str]:
        event = SimpleNamespace(type=kind, value="PRESS", mouse_x=x, mouse_y=50)
        return HNF_OT_probe._wait_for_click(operator, context, event)

    assert [answer(kind, 120) for kind in ("LEFTMOUSE", "RIGHTMOUSE", "ESC")] == [{"PASS_THROUGH"}] * 3
    assert ended == []
    assert [answer(kind, 40) for kind in ("RIGHTMOUSE", "ESC")] == [{"CANCELLED"}] * 2
