"""Long work: in a child process under a modal operator, in line where there is no window."""

from __future__ import annotations

import atexit


def register() -> None:
    atexit.register(_stop)


def unregister() -> None:
    atexit.unregister(_stop)
    _stop()


def _stop() -> None:
    from .current import cancel

    cancel()
