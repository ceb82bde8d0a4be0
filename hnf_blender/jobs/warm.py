"""Loading what statuses are made with, beside the window: a third of a second of imports would be felt in it."""

from __future__ import annotations

import threading

_thread: threading.Thread | None = None


def is_ready() -> bool:
    """Is everything loaded? The first call begins to."""
    global _thread
    if _thread is None:
        _thread = threading.Thread(target=_load, name="hnf loading", daemon=True)
        _thread.start()
    return not _thread.is_alive()


def _load() -> None:
    from hnf_core.field.weights import load_field
    from hnf_core.material.library import load_library

    from ..touch.seeing import Seeing
    from . import running  # noqa: F401  # all that a look or a bake imports

    load_field()
    load_library()
    _ = Seeing().weights_hash  # the file is read once for it
