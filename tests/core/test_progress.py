"""Progress of nested work, its cancellation, and the line on a terminal."""

from __future__ import annotations

import io

import pytest

from hnf_core.progress import Cancelled, Progress, ProgressBar, ignore_progress, nest_progress


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
