"""A child whose parent died leaves, however its standard input ends: at its end, or with an error."""

from __future__ import annotations

import os
import threading

import pytest

from hnf_core import child_process


def ended(*_: object) -> bytes:
    return b""


def broken(*_: object) -> bytes:
    raise OSError("the pipe is being closed")


@pytest.mark.parametrize("read", [ended, broken])
def test_it_leaves(monkeypatch, read) -> None:
    left, codes = threading.Event(), []
    monkeypatch.setattr(os, "read", read)
    monkeypatch.setattr(os, "_exit", lambda code: (codes.append(code), left.set()))
    child_process.exit_with_parent()
    assert left.wait(30.0)
    assert codes == [child_process.EXIT_PARENT_GONE]
