"""--seed of the verbs that feel strokes."""

from __future__ import annotations

from ..errors import UsageError

SEED_LIMIT = 2**63


def parse_seed(text: str) -> int:
    """For argparse. Raises UsageError for what is no whole number from 0 to SEEDS − 1."""
    if not (text.isascii() and text.isdigit() and len(text) < 20 and int(text) < SEED_LIMIT):
        raise UsageError(f"--seed {text[:40]}: not a whole number from 0 to 2^63 − 1.", remedy="Give e.g. 0.")
    return int(text)
