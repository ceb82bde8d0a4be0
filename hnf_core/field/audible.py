"""Which samples of a stroke are heard, and the blocks in which they are rendered."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from .carriers import MODEL_RATE_HZ
from .hops import HOP_SIZE
from .timeline import SAMPLES_PER_STATE

Float = NDArray[np.float64]

BEFORE_CONTACT_S, AFTER_CONTACT_S = 0.02, 0.06
"""Beyond these distances from contact the signal is exactly zero."""
BLOCK_SAMPLES = HOP_SIZE
"""Samples of a block: how much a small change costs; the last bit of what a profile adds depends on it."""
MAX_JOINED_BLOCKS = 32
"""Blocks that are rendered in one go where neighbours are heard: 13 s, whose carriers are held together."""


def compute_audible_gain(contact: NDArray[np.bool_], count: int) -> Float:
    """(count,) 1 in contact (n,), fading to exactly 0 at BEFORE_CONTACT_S ahead of it and AFTER_CONTACT_S behind it."""
    indices = np.flatnonzero(contact)
    if len(indices) == 0:
        return np.zeros(count)
    touched, out = contact.astype(bool), np.ones(count)
    # 1 throughout between two states of which one touches; the rest is far from most of a stroke.
    away = np.flatnonzero(~(touched[:-1] | touched[1:]))
    sample = (SAMPLES_PER_STATE * away[:, None] + np.arange(SAMPLES_PER_STATE)).ravel()
    state = sample / SAMPLES_PER_STATE
    following = np.searchsorted(indices, state)
    ahead = np.where(following < len(indices), indices[np.minimum(following, len(indices) - 1)] - state, np.inf)
    behind = np.where(following > 0, state - indices[np.maximum(following - 1, 0)], np.inf)
    per_state = SAMPLES_PER_STATE / MODEL_RATE_HZ
    ahead, behind = np.maximum(ahead - 1.0, 0.0) * per_state, np.maximum(behind - 1.0, 0.0) * per_state
    fade = np.maximum(1.0 - ahead / BEFORE_CONTACT_S, 1.0 - behind / AFTER_CONTACT_S)
    out[sample] = np.sin(0.5 * np.pi * np.clip(fade, 0.0, 1.0)) ** 2
    return out


def is_audible(audible: Float) -> bool:
    """Whether any of audible (count,) is heard: its largest is found sooner than any()."""
    return bool(audible.max(initial=0.0) > 0.0)


def split_blocks(count: int) -> list[tuple[int, int]]:
    """(start, length) of the blocks in which count samples are rendered."""
    return [(start, min(BLOCK_SAMPLES, count - start)) for start in range(0, count, BLOCK_SAMPLES)]


def find_audible_spans(audible: Float) -> Iterator[tuple[int, int]]:
    """(start, length) of neighbouring blocks in which anything of audible (count,) is heard, BLOCKS_AT_ONCE at most."""
    begin, end = 0, 0
    for start, count in split_blocks(len(audible)):
        if not is_audible(audible[start : start + count]):
            continue
        if end > begin and (start > end or start - begin == MAX_JOINED_BLOCKS * BLOCK_SAMPLES):
            yield begin, end - begin
            begin = start
        begin, end = (start, start + count) if end == begin else (begin, start + count)
    if end > begin:
        yield begin, end - begin
