"""Arrays kept between runs under the name of what they follow from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ...errors import FileError
from ...files import content_hash, write_bytes
from ...tensor_file import dump_tensors, load_tensors

Arrays = Mapping[str, NDArray[Any]]
VERSION = 1
"""Counts changes of what is kept under a name."""


class ArrayCache:
    """A folder of arrays; with None nothing is kept and everything is made anew."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder

    def get_or_make(self, name: str, make: Callable[[], Arrays]) -> Arrays:
        """What make gives, from the folder where it lies there. name: all that it follows from, in words.

        Raises FileError where a file is damaged or the folder refuses, and what make raises.
        """
        if self._folder is None:
            return make()
        path = self._folder / f"{content_hash(str(VERSION), name)}.safetensors"
        try:
            return load_tensors(path.read_bytes())[0]
        except FileNotFoundError:
            made = dict(make())
            write_bytes(path, dump_tensors(made))
            return made
        except (OSError, ValueError) as error:
            raise FileError(f"cannot be read ({error}).", where=str(path), remedy="Delete it.") from error
