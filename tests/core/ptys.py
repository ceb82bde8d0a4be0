"""Pseudo-terminals, which stand for serial ports in tests: where a system gives none, what needs one is skipped."""

from __future__ import annotations

import os

import pytest


def why_not() -> str:
    """Why there is none here, or ""."""
    try:
        import pty

        for end in pty.openpty():
            os.close(end)
    except (ImportError, OSError) as error:
        return f"this system has no ptys: {error}"
    return ""


needs_pty = pytest.mark.skipif(why_not() != "", reason=why_not())
