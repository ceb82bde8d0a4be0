"""Check the system libraries that Blender's Python module needs, and print one command that installs the missing ones.

Libraries are looked for the way the dynamic linker does, not by package, so this holds on every distribution.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import shutil
import sys
from pathlib import Path

APT_LIST = Path(__file__).with_name("apt.txt")

# Debian package → the shared library that stands for it.
SONAMES = {
    "libx11-6": "libX11.so.6",
    "libxext6": "libXext.so.6",
    "libxrender1": "libXrender.so.1",
    "libxfixes3": "libXfixes.so.3",
    "libxi6": "libXi.so.6",
    "libxxf86vm1": "libXxf86vm.so.1",
    "libxkbcommon0": "libxkbcommon.so.0",
    "libsm6": "libSM.so.6",
    "libice6": "libICE.so.6",
    "libgl1": "libGL.so.1",
    "libgomp1": "libgomp.so.1",
}
PYTHON_MODULES = {"python3-venv": "ensurepip"}


def read_packages() -> list[str]:
    """Read the Debian packages from tools/apt.txt."""
    return APT_LIST.read_text(encoding="utf-8").split()


def is_present(package: str) -> bool:
    """Return True if this Python can load the library or module of `package`."""
    if package in PYTHON_MODULES:
        return importlib.util.find_spec(PYTHON_MODULES[package]) is not None
    try:
        ctypes.CDLL(SONAMES[package])
    except OSError:
        return False
    return True


def make_install_command(missing: list[str]) -> str:
    """Make one command for this machine's package manager that installs the `missing` Debian packages."""
    sudo = "" if os.geteuid() == 0 else "sudo "
    if shutil.which("apt-get") or not shutil.which("dnf"):
        return f"{sudo}apt-get update && {sudo}apt-get install -y " + " ".join(missing)
    provides = [f"'{SONAMES[name]}()(64bit)'" if name in SONAMES else "python3-pip" for name in missing]
    return f"{sudo}dnf install -y " + " ".join(provides)


def main() -> int:
    """Print the missing libraries and the command, and return 1; return 0 without output if none is missing."""
    missing = [name for name in read_packages() if not is_present(name)]
    if not missing:
        return 0
    names = ", ".join(SONAMES.get(name, name) for name in missing)
    print(f"Missing on this machine: {names}.\nInstall with:  {make_install_command(missing)}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
