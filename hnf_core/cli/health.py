"""What is at work here and what is missing: for `hnf doctor`, and for the panel that says the same of a Blender."""

from __future__ import annotations

import platform
from dataclasses import dataclass

from .. import __version__
from ..errors import HnfError


@dataclass(frozen=True)
class Package:
    """name: as pip knows it. without: what cannot be done where it is missing."""

    name: str
    without: str


PACKAGES = (
    Package("bpy", "no scene is opened at a shell: touch runs in Blender alone (blender -b --command hnf touch …)"),
    Package("OpenEXR", "close-ups cannot be read: touch does not work"),
    Package("embreex", "rays are cast more slowly"),
    Package("safetensors", "weights cannot be read: nothing is synthesised"),
    Package("matplotlib", "no pictures of strokes and no plots"),
    Package("torch", "no training; touching and synthesis do not need it"),
    Package("sounddevice", "no playing by the sound card (stream --to audio)"),
    Package("python-osc", "no sending by OSC (stream --to osc:HOST:PORT)"),
    Package("pyserial", "no actuators on a serial port (stream --to serial:PORT)"),
)


def base_versions() -> tuple[tuple[str, str], ...]:
    """Of the program, of Python and of what it cannot run without."""
    return (
        ("hnf", __version__),
        ("Python", platform.python_version()),
        ("numpy", version_of("numpy") or "not installed"),
        ("System", f"{platform.system()} {platform.release()} {platform.machine()}"),
    )


def version_of(package: str) -> str:
    """ "" where it is not installed."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def kernel_state() -> str:
    """Whether the inner loops of synthesis are compiled: numpy does the same in about twice the time."""
    from ..kernel.library import kernel, why_not

    return "at work" if kernel() is not None else f"using slower numpy version ({why_not()})"


def field_identity() -> str:
    """Of the shipped field, or what is wrong with it."""
    from ..field.weights import load_field

    try:
        return load_field().identity
    except (HnfError, ImportError) as error:
        return str(error)


def file_hashes() -> tuple[tuple[str, str], ...]:
    """Content hashes of the material library and of the network that reads pictures; "not there" without the file."""
    from ..files import content_hash
    from ..material.library import LIBRARY_PATH
    from ..tactile.diffusion.weights import DEFAULT_WEIGHTS

    found = []
    for name, path in (("Material library", LIBRARY_PATH), ("Weights for pictures", DEFAULT_WEIGHTS)):
        try:
            found.append((name, content_hash(path.read_bytes())))
        except OSError as error:
            found.append((name, f"not there ({error.strerror}): {path}"))
    return tuple(found)
