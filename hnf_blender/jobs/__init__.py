"""Long work: in a child process under a modal operator, in line where there is no window."""

from __future__ import annotations


def register() -> None: ...


def unregister() -> None: ...
