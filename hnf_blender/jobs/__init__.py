"""Long work in child processes: bakes, touch queries and learning of materials, one job at a time.

A job is a request in a folder, a child process that writes results there, and a commit, which writes the results to the
scene; without a window the same steps run in this process. The child process of a bake waits for the next one. Read
`manager.py` first, then `bake_job.py`.
"""

from __future__ import annotations

import atexit


def register() -> None:
    atexit.register(_close)


def unregister() -> None:
    atexit.unregister(_close)
    _close()


def _close() -> None:
    from .manager import close

    close()
