"""Install built wheels into clean environments, as a user would, and make a WAV in each.

    .venv/bin/python tools/check_install.py dist/hnf-0.2.0 [--python PYTHON]… [--uv UV] [--lowest] [--tests PATH]…

Prints one line for each Python and installer: versions, whether the compiled kernel works, and seconds from nothing to
a WAV. --lowest installs the lowest versions that pyproject.toml admits; --tests then runs tests of this checkout beside
what was installed. With --uv, the same through `uv pip` and `uv tool`.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

from kernel.setup import PLATFORMS, detect_platform

ROOT = Path(__file__).resolve().parent.parent
STROKE = ("synth", "--material", "oak-wood", "--stroke", "rub-slow", "--seed", "0", "--out", "rub.wav")
VERSIONS = """
import importlib.metadata as metadata, platform
from hnf_core.diagnostics import describe_kernel
names = ("hnf", "numpy", "safetensors", "soxr")
found = [f"{name} {metadata.version(name)}" for name in names]
print("Python", platform.python_version(), *found, "kernel", describe_kernel())
"""
SMALL_WAV_BYTES = 10_000
STEP_S, TESTS_S = 600, 1800
TEST_PACKAGES = ("pytest", "pytest-timeout", "hypothesis", "mpmath")


class InstallError(Exception):
    """Error for wheels that cannot be installed or do not work; the message names the step."""


def find_wheels(folder: Path) -> list[str]:
    """Find hnf's wheel and this machine's kernel wheel in a release. Raises InstallError."""
    platform = PLATFORMS[detect_platform()].wheel
    found = [sorted(folder.glob(pattern)) for pattern in ("hnf-*-none-any.whl", f"hnf_kernel-*-{platform}.whl")]
    if [len(paths) for paths in found] != [1, 1]:
        raise InstallError(f"{folder} does not hold one wheel of hnf and one of the kernel for {platform}.")
    return [str(paths[0].resolve()) for paths in found]


def read_lowest(extras: tuple[str, ...] = ()) -> list[str]:
    """Return the lowest versions that pyproject.toml admits, as exact requirements."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [*project["dependencies"], *(each for name in extras for each in project["optional-dependencies"][name])]
    return [each.partition(";")[0].strip().replace(">=", "==") for each in stated if not each.startswith("bpy")]


def run(*words: str, cwd: Path, timeout_s: float = STEP_S) -> str:
    """Run a step away from this checkout and return its output. Raises InstallError with its last words."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        words, cwd=cwd, capture_output=True, text=True, timeout=timeout_s, stdin=subprocess.DEVNULL, env=environment
    )
    if done.returncode != 0:
        raise InstallError(f"{' '.join(words)[:300]}\n{(done.stdout + done.stderr).strip()[-2000:]}")
    return done.stdout.strip()


def check_wav(path: Path) -> None:
    """Check that a WAV was written. Raises InstallError."""
    if not path.is_file() or path.stat().st_size < SMALL_WAV_BYTES:
        raise InstallError(f"{path.name} was not written, or is too short.")


def check_environment(python: str, wheels: list[str], uv: str, more: list[str], tests: list[str]) -> str:
    """Install into a clean environment and use it; returns a line on what was installed. Raises InstallError."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        started = time.monotonic()
        inside = folder / "environment" / ("Scripts" if sys.platform == "win32" else "bin")
        if uv:
            run(uv, "venv", "-q", "--python", python, "environment", cwd=folder)
            run(uv, "pip", "install", "-q", "--python", str(inside / "python"), *wheels, *more, cwd=folder)
        else:
            run(python, "-m", "venv", "environment", cwd=folder)
            run(str(inside / "python"), "-m", "pip", "install", "-q", *wheels, *more, cwd=folder)
        run(str(inside / "hnf"), *STROKE, cwd=folder)
        seconds = time.monotonic() - started
        check_wav(folder / "rub.wav")
        line = (
            f"{run(str(inside / 'python'), '-c', VERSIONS, cwd=folder)}; {'uv pip' if uv else 'pip'}: {seconds:.1f} s"
        )
        if tests:
            packages = list(TEST_PACKAGES)
            if uv:
                run(uv, "pip", "install", "-q", "--python", str(inside / "python"), *packages, cwd=folder)
            else:
                run(str(inside / "python"), "-m", "pip", "install", "-q", *packages, cwd=folder)
            options = ("-p", "no:cacheprovider", f"--basetemp={folder / 'tests'}")
            said = run(str(inside / "python"), "-m", "pytest", *tests, *options, cwd=ROOT, timeout_s=TESTS_S)
            line += f"; tests: {said.splitlines()[-1]}"
        return line


def check_tool(python: str, wheels: list[str], uv: str) -> str:
    """Make the WAV through `uv tool run`, from a tool environment of its own. Raises InstallError."""
    with TemporaryDirectory() as scratch:
        started = time.monotonic()
        words = ("tool", "run", "-q", "--isolated", "--python", python, "--from", wheels[0], "--with", wheels[1], "hnf")
        run(uv, *words, *STROKE, cwd=Path(scratch))
        check_wav(Path(scratch) / "rub.wav")
        return f"uv tool, {python}: {time.monotonic() - started:.1f} s"


def main(arguments: list[str] | None = None) -> int:
    """Check every Python that is named; returns 1 with a clear message at the first that fails."""
    parser = argparse.ArgumentParser(description="Install built wheels into clean environments and use them.")
    parser.add_argument("folder", type=Path, help="what tools/build_release.py has made")
    parser.add_argument("--python", action="append", metavar="PYTHON", help="default: this one")
    parser.add_argument("--uv", default="", metavar="UV", help="the program uv: the same with it")
    parser.add_argument("--lowest", action="store_true", help="the lowest versions of all dependencies")
    parser.add_argument("--extra", action="append", default=[], metavar="NAME", help="with what this extra needs")
    parser.add_argument("--tests", action="append", default=[], metavar="PATH", help="then run these tests")
    chosen = parser.parse_args(arguments)
    uv = os.path.abspath(shutil.which(chosen.uv) or chosen.uv) if chosen.uv else ""  # steps run in other folders
    try:
        wheels = find_wheels(chosen.folder)
        stated = read_lowest(tuple(chosen.extra))
        more = stated if chosen.lowest else [re.split("[=<>;]", each)[0] for each in stated]
        for python in chosen.python or [sys.executable]:
            print(check_environment(python, wheels, "", more, chosen.tests), flush=True)
            if uv:
                print(check_environment(python, wheels, uv, more, []), flush=True)
                print(check_tool(python, wheels, uv), flush=True)
    except (InstallError, OSError, subprocess.SubprocessError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
