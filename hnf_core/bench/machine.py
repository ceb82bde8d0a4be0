"""What was measured on: without it no time means anything."""

from __future__ import annotations

import os
import platform
import sys
from pathlib import Path

from .. import __version__
from ..kernel.library import why_unavailable

PACKAGES = ("numpy", "bpy", "torch", "scipy", "OpenEXR", "embreex")
"""Those whose work may be what was measured: told where they are loaded."""


def describe_machine() -> dict[str, str]:
    """Processor, cores, memory, load of the last minute, system, versions of what is loaded."""
    facts = {"processor": _find_processor(), "cores": str(os.cpu_count() or 0)}
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        facts["memory"] = f"{os.sysconf('SC_PHYS_PAGES') * os.sysconf('SC_PAGE_SIZE') / 1e9:.0f} GB"
    if hasattr(os, "getloadavg"):
        facts["load"] = f"{os.getloadavg()[0]:.1f}"
    facts["system"] = platform.platform()
    facts["hnf"], facts["python"] = __version__, platform.python_version()
    for name in PACKAGES:
        if name in sys.modules:
            facts[name] = _find_version(name)
    facts["kernel"] = why_unavailable() or "compiled"
    return facts


def _find_processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    named = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return named or platform.processor() or platform.machine()


def _find_version(name: str) -> str:
    module = sys.modules[name]
    if name == "bpy":
        return str(module.app.version_string)
    return str(getattr(module, "__version__", None) or _find_package_version(name))


def _find_package_version(name: str) -> str:
    """What pip calls a package that does not say its version itself; "?" where pip does not know it either."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return "?"
