"""Progress of nested work, its cancellation, the line on a terminal, and counts of the work done."""

from __future__ import annotations

import io
import threading

import pytest

from hnf_core.progress import (
    Cancelled,
    Progress,
    ProgressBar,
    add_work,
    count_work,
    ignore_progress,
    nest_progress,
)
from hnf_core.threads import run_in_thread


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class ClosedTerminal(Terminal):
    def write(self, text: str) -> int:
        raise BrokenPipeError


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0 / 3.0, 1.0])
def test_a_sub_task_is_a_part_of_one_step(share: float) -> None:
    seen: list[Progress] = []
    nest_progress(seen.append, "A: close-ups", 1, 4, 0.9)(Progress("close-ups", 0, 1, share))
    assert seen == [Progress("A: close-ups", 1, 4, 0.9 * share)]
    assert seen[0].fraction == (1.0 + 0.9 * share) / 4.0


def test_an_empty_run_has_a_fraction() -> None:
    assert Progress("", 0, 0).fraction == 0.0
    assert ignore_progress(Progress("", 0, 0)) is None


def test_cancelling_is_no_exception_that_a_step_could_swallow() -> None:
    assert not issubclass(Cancelled, Exception)

    def cancel(progress: Progress) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        nest_progress(cancel, "A", 0, 1)(Progress("", 0, 1))


def test_the_bar_shows_stage_and_steps_and_erases_them() -> None:
    terminal = Terminal()
    bar = ProgressBar(terminal)
    bar.show(Progress("A: close-ups", 1, 4, 0.5))
    assert "1/4 A: close-ups" in terminal.getvalue()
    assert terminal.getvalue().count("█") == round(ProgressBar.WIDTH * 0.375)
    bar.close()
    assert terminal.getvalue().endswith("\r\x1b[K")


class DetachedTerminal(Terminal):
    def write(self, text: str) -> int:
        raise ValueError("I/O operation on closed file.")


@pytest.mark.parametrize("kind", [ClosedTerminal, DetachedTerminal])
def test_a_closed_terminal_stops_nothing(kind: type[Terminal]) -> None:
    bar = ProgressBar(kind())
    bar.show(Progress("A", 0, 1))
    bar.close()


def test_nested_counts_each_count_all_work_while_they_are_open() -> None:
    add_work("rays", 1)
    with count_work() as outer:
        add_work("rays", 10)
        with count_work() as inner:
            add_work("rays", 100)
            add_work("meshes", item="Plate")
        add_work("rays", 1000)
    add_work("rays", 10_000)
    assert outer.amounts["rays"] == [10, 100, 1000]
    assert (outer.total("rays"), inner.total("rays")) == (1110, 100)
    assert outer.items["meshes"] == inner.items["meshes"] == ["Plate"]
    assert (outer.items["rays"], outer.total("meshes"), outer.total("states")) == (["", "", ""], 1, 0)


def test_counting_ends_with_errors_and_refuses_unknown_kinds() -> None:
    """A misspelt kind is not taken for work that was not done."""
    with pytest.raises(ZeroDivisionError), count_work() as failed:
        add_work("renders", 1 // 0)
    add_work("renders")
    assert failed.total("renders") == 0
    with count_work() as work, pytest.raises(KeyError):
        add_work("render")  # type: ignore[arg-type]
    with pytest.raises(KeyError):
        work.total("render")  # type: ignore[arg-type]


def test_work_of_all_threads_is_counted_once() -> None:
    together = threading.Barrier(4)

    def do_work(number: int) -> None:
        together.wait(60.0)
        for _ in range(1000):
            add_work("states", 1, number)

    with count_work() as work:
        waits = [run_in_thread(lambda number=number: do_work(number)) for number in range(4)]
        for wait in waits:
            wait()
    assert work.total("threads") == 4
    assert work.total("states") == len(work.items["states"]) == 4000
    assert {number: work.items["states"].count(number) for number in range(4)} == dict.fromkeys(range(4), 1000)
