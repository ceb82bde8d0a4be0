"""Long work: in a child process under a modal operator, in line where there is no window."""

from __future__ import annotations

import atexit


def register() -> None:
    atexit.register(_cancel_job)


def unregister() -> None:
    atexit.unregister(_cancel_job)
    _cancel_job()


def _cancel_job() -> None:
    from .manager import cancel

    cancel()
