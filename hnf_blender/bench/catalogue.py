"""All benches: those of the core, and those that need Blender."""

from __future__ import annotations

from hnf_core.bench.catalogue import BENCHES as OF_THE_CORE
from hnf_core.bench.frame import Bench, Options, Row


def _enable(options: Options) -> list[Row]:
    from .enable import rows

    return rows(options)


def _responsiveness(options: Options) -> list[Row]:
    from .responsiveness import rows

    return rows(options)


def _authoring(options: Options) -> list[Row]:
    from .authoring import rows

    return rows(options)


BENCHES = (
    Bench("enable", "switching the add-on on, beside `import numpy`", _enable),
    Bench("responsiveness", "what a window waits for while 100,000 faces bake", _responsiveness),
    Bench("authoring", "what a window waits for when a stroke is drawn or placed on 100,000 faces", _authoring),
    *OF_THE_CORE,
)
