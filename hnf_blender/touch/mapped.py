"""A generator of steps, told otherwise."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Generator
from typing import TypeVar

Step = TypeVar("Step")
Mapped = TypeVar("Mapped")
Result = TypeVar("Result")


def map_steps(
    steps: Generator[Step, None, Result], convert: Callable[[Step], Mapped]
) -> Generator[Mapped, None, Result]:
    """tell() of each step; what steps returns in the end. Closes steps however it ends."""
    with contextlib.closing(steps):
        while True:
            try:
                step = next(steps)
            except StopIteration as finished:
                return finished.value  # type: ignore[no-any-return]  # what the generator declares
            yield convert(step)
