"""Loading what statuses are made with, beside the window: a third of a second of imports would be felt in it."""

from __future__ import annotations

import threading

_preload_thread: threading.Thread | None = None


def is_preloaded() -> bool:
    """Is everything loaded? The first call begins to."""
    global _preload_thread
    if _preload_thread is None:
        _preload_thread = threading.Thread(target=_preload, name="hnf loading", daemon=True)
        _preload_thread.start()
    return not _preload_thread.is_alive()


def _preload() -> None:
    from hnf_core.field.weights import load_field
    from hnf_core.material.library import load_library

    from ..touch.seeing import ReliefPredictor
    from . import running  # noqa: F401  # all that a look or a bake imports

    load_field()
    load_library()
    _ = ReliefPredictor().weights_hash  # the file is read once for it
