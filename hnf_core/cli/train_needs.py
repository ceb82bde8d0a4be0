"""What the subjects of `hnf train` have in common: torch, a seed, and a file of weights to write."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager

from ..errors import HnfError, UsageError


@contextmanager
def require_torch(what: str) -> Iterator[None]:
    """For imports that torch is needed for. Raises HnfError, which names what, where they fail."""
    try:
        yield
    except ImportError as error:
        raise HnfError(
            f"{what} needs torch ({error}).",
            remedy="In a checkout: make env-test; elsewhere: pip install 'hnf[train]'.",
        ) from error


def check_seed_and_weights(arguments: argparse.Namespace) -> None:
    """--seed and --out. Raises UsageError where one of them will not do."""
    if arguments.seed < 0:
        raise UsageError("--seed must be a whole number from 0.")
    if arguments.out.suffix != ".safetensors":
        raise UsageError(f"--out {arguments.out.name}: weights are .safetensors files.", remedy="Name it so.")
