"""Why a button is grey."""

from __future__ import annotations

from typing import Any

from ..translations import tr


def fail_poll(operator: Any, reason: str) -> bool:
    """For poll(): False, and why is said in the language of the interface. Blender shows what poll_message_set() is
    given as it is, without looking it up."""
    operator.poll_message_set(tr(reason))
    return False
