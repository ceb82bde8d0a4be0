"""Keyframes that may be written: a stroke's own, shared with nobody."""

from __future__ import annotations

from typing import Any

from hnf_core.errors import StrokeError

from .. import compat


def make_keys_single_user(stroke: Any) -> None:
    """Give a stroke whose action others use too (a linked duplicate, Alt D) a copy of its own, so that what is done to
    its keyframes leaves theirs alone. Raises StrokeError where the keyframes are linked from another file."""
    action = None if stroke.animation_data is None else stroke.animation_data.action
    if action is None:
        return
    if action.library is not None:
        raise StrokeError(
            "its keyframes are linked.",
            where=f"stroke '{stroke.name}'",
            remedy="Make its action local, or change them there.",
        )
    if action.users > 1 + action.use_fake_user:
        compat.own_action(stroke)
