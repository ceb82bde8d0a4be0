"""Build the compiled kernel as a wheel: build/kernel/hnf_kernel-VERSION-py3-none-PLATFORM.whl.

    .venv/bin/python tools/build_kernel.py                          for this machine
    .venv/bin/python tools/build_kernel.py --platform windows-x64   for another one
    .venv/bin/python tools/build_kernel.py --install PYTHON…        for this machine, into these environments

The project that it builds is tools/kernel. Where there is no kernel, numpy does the same work, in up to twice the time.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from kernel.setup import PLATFORMS, compute_fingerprint, detect_platform, make_version

ROOT = Path(__file__).resolve().parent.parent
PROJECT = ROOT / "tools" / "kernel"
BUILD_FOLDER = ROOT / "build" / "kernel"
CACHE = {"ZIG_GLOBAL_CACHE_DIR": str(BUILD_FOLDER / "cache"), "ZIG_LOCAL_CACHE_DIR": str(BUILD_FOLDER / "cache")}
BUILD_S = 600
PIP_OPTIONS = ("--disable-pip-version-check", "--no-input")


class KernelError(Exception):
    """Error for a kernel that cannot be built; the message says why."""


def build(name: str, folder: Path = BUILD_FOLDER) -> Path:
    """Build the wheel for one of PLATFORMS, unless it exists already. Raises KernelError."""
    goal = PLATFORMS[name]
    path = folder / f"hnf_kernel-{make_version()}-py3-none-{goal.wheel}.whl"
    if path.is_file():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder) as temporary:
        config = Path(temporary) / "build.cfg"
        config.write_text(
            f"[egg_info]\negg_base = {temporary}\n[build]\nbuild_base = {temporary}/build\n", encoding="utf-8"
        )
        command = ["wheel", "-q", "--no-deps", "--no-build-isolation", "-w", temporary, str(PROJECT)]
        run_pip(sys.executable, *command, DIST_EXTRA_CONFIG=str(config), HNF_KERNEL_PLATFORM=name, **CACHE)
        os.replace(Path(temporary) / path.name, path)
    for old in folder.glob(f"hnf_kernel-*-{goal.wheel}.whl"):
        if old != path:
            old.unlink()
    return path


def run_pip(python: str, *arguments: str, **environment: str) -> None:
    """Run an environment's pip. Raises KernelError with its last words."""
    try:
        run = subprocess.run(
            [python, "-m", "pip", *PIP_OPTIONS, *arguments], capture_output=True, text=True, timeout=BUILD_S,
            stdin=subprocess.DEVNULL, env=os.environ | environment,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KernelError(f"pip did not run: {error}") from error
    if run.returncode != 0:
        raise KernelError(f"pip {arguments[0]} failed for {python}:\n{(run.stdout + run.stderr).strip()[-2000:]}")


def install(pythons: list[str]) -> None:
    """Install the kernel into those environments of this machine that do not have this build. Raises KernelError."""
    digest = compute_fingerprint()
    stamps = {python: Path(python).parent.parent / "hnf-compiled.stamp" for python in pythons}
    old = [
        (python, stamp)
        for python, stamp in stamps.items()
        if not (stamp.is_file() and stamp.read_text(encoding="utf-8") == digest)
    ]
    wheel = build(detect_platform()) if old else Path()
    for python, stamp in old:
        run_pip(python, "install", "-q", "--no-deps", "--force-reinstall", str(wheel))
        stamp.write_text(digest, encoding="utf-8")


def main(arguments: list[str] | None = None) -> int:
    """Build or install; returns 1 with a clear message where that fails."""
    parser = argparse.ArgumentParser(description="Build the compiled kernel.")
    parser.add_argument("--platform", choices=PLATFORMS, help="another machine than this one")
    parser.add_argument("--install", nargs="+", metavar="PYTHON", help="into these environments of this machine")
    chosen = parser.parse_args(arguments)
    try:
        if chosen.install:
            install(chosen.install)
        else:
            print(build(chosen.platform or detect_platform()))
    except KernelError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
