"""State of this installation, for `hnf doctor` and the add-on: versions, optional packages, kernel, data files."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path

from . import __version__
from .errors import HnfError


@dataclass(frozen=True)
class Fact:
    """One line of the diagnosis that `hnf doctor` prints.

    Attributes
    ----------
    key : str
        Stable name for programs; stays when the label is reworded.
    label : str
        Name for people.
    value : str
        Version, hash or message.
    """

    key: str
    label: str
    value: str


@dataclass(frozen=True)
class Package:
    """An optional package: its name in pip, and the consequence if it is missing."""

    name: str
    without: str


OPTIONAL_PACKAGES = (
    Package("bpy", "no scene is opened at a shell: touch runs in Blender alone (blender -b --command hnf touch …)"),
    Package("OpenEXR", "close-ups cannot be read: touch does not work"),
    Package("embreex", "rays are cast more slowly"),
    Package("safetensors", "weights cannot be read: nothing is synthesized"),
    Package("matplotlib", "no pictures of strokes and no plots"),
    Package("torch", "no training; touching and synthesis do not need it"),
    Package("sounddevice", "no playing by the sound card (stream --to audio)"),
    Package("python-osc", "no sending by OSC (stream --to osc:HOST:PORT)"),
    Package("pyserial", "no actuators on a serial port (stream --to serial:PORT)"),
)


def get_base_versions() -> tuple[Fact, ...]:
    """Return the versions of this program, Python, numpy and the operating system."""
    return (
        Fact("hnf", "hnf", __version__),
        Fact("python", "Python", platform.python_version()),
        Fact("numpy", "numpy", get_version("numpy") or "not installed"),
        Fact("system", "System", f"{platform.system()} {platform.release()} {platform.machine()}"),
    )


def get_version(package: str) -> str:
    """Return the installed version of a package, or "" if it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def describe_kernel() -> str:
    """Return a line on the compiled synthesis kernel; without it numpy does the same in about twice the time."""
    from .kernel.loader import load_kernel, why_unavailable

    return "at work" if load_kernel() is not None else f"using slower numpy version ({why_unavailable()})"


def describe_field() -> str:
    """Return the identity of the shipped field (synthesis network), or the error message if it cannot be loaded."""
    from .field.weights import load_field

    try:
        return load_field().identity
    except (HnfError, ImportError) as error:
        return str(error)


def hash_data_files() -> tuple[Fact, ...]:
    """Return content hashes of the material library and the diffusion weights; "not there" if a file is missing."""
    from .files import hash_file
    from .material.library import LIBRARY_PATH
    from .tactile.unet import DEFAULT_WEIGHTS

    def hash_of(path: Path) -> str:
        try:
            return hash_file(path)
        except OSError as error:
            return f"not there ({error.strerror}): {path}"

    return (
        Fact("material_library", "Material library", hash_of(LIBRARY_PATH)),
        Fact("weights_for_pictures", "Weights for pictures", hash_of(DEFAULT_WEIGHTS)),
    )


MIN_TRAINING_PYTHON = (3, 11)
"""Oldest Python version that training runs on."""


TRAINING_PACKAGES = {
    "numpy": "numpy>=1.24", "safetensors": "safetensors==0.8.0", "soxr": "soxr==1.1.0", "torch": "torch==2.13.0",
}  # fmt: skip
"""Packages that `hnf train field` imports, with pip's requirement as pinned in pyproject.toml."""
