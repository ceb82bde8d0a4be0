"""Build the compiled kernel as a wheel: build/kernel/hnf_kernel-VERSION-py3-none-PLATFORM.whl.

    .venv/bin/python tools/build_kernel.py                          for this machine
    .venv/bin/python tools/build_kernel.py --platform windows-x64   for another one
    .venv/bin/python tools/build_kernel.py --install PYTHON…        for this machine, into these environments

The sources are hnf_core/kernel/source; the compiler is zig's (pinned, from the package index), which builds for every
platform on any. Where there is no kernel, numpy does the same work, in up to twice the time.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import platform
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parent.parent
SOURCE_FOLDER = ROOT / "hnf_core" / "kernel" / "source"
BUILD_FOLDER = ROOT / "build" / "kernel"
CACHE = {"ZIG_GLOBAL_CACHE_DIR": str(BUILD_FOLDER / "cache"), "ZIG_LOCAL_CACHE_DIR": str(BUILD_FOLDER / "cache")}
COMPILE_S, INSTALL_S = 300, 120
OPTIONS = (
    "-O3", "-std=c11", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fno-sanitize=all",
    "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror", "-shared", "-s",
)  # fmt: skip
INIT_TEXT = '"""Compiled inner loops of hnf_core.kernel, which loads them."""\n'


class KernelError(Exception):
    """Error for a kernel that cannot be built; the message says why."""


@dataclass(frozen=True)
class Platform:
    """Platform that the kernel is built for.

    Attributes
    ----------
    target
        Zig's name of the platform.
    wheel
        The package index's name of it.
    suffix
        File suffix of a shared library.
    processors
        Pairs of a library's name and the least processor that it runs on. hnf_core loads the last that fits.
    """

    target: str
    wheel: str
    suffix: str
    processors: tuple[tuple[str, str], ...]


# Blender itself asks for x86-64-v2 (SSE 4.2); v3 has AVX2 and FMA (2013 and later).
X64 = (("hnf_kernel", "x86_64_v2"), ("hnf_kernel_wide", "x86_64_v3"))
ARM64 = (("hnf_kernel", "baseline"),)
PLATFORMS = {
    "linux-x64": Platform("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64", ".so", X64),
    "windows-x64": Platform("x86_64-windows-gnu", "win_amd64", ".dll", X64),
    "macos-arm64": Platform("aarch64-macos.11.0", "macosx_11_0_arm64", ".dylib", ARM64),
    "macos-x64": Platform("x86_64-macos.11.0", "macosx_11_0_x86_64", ".dylib", X64),
}


def detect_platform() -> str:
    """Detect the platform of this machine. Raises KernelError where the kernel is not built for it."""
    name = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system(), "?")
    found = f"{name}-{'arm64' if platform.machine().lower() in ('arm64', 'aarch64') else 'x64'}"
    if found not in PLATFORMS:
        raise KernelError(f"the kernel is not built for {platform.system()} on {platform.machine()}")
    return found


def compute_fingerprint() -> str:
    """Hash everything that determines the build."""
    files = [*sorted(SOURCE_FOLDER.glob("*.[ch]")), Path(__file__), ROOT / "tools" / "requirements" / "constraints.txt"]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()


def make_version() -> str:
    """Join hnf_core.__version__ and a number from the sources' hash, by which pip and Blender tell builds apart."""
    text = (ROOT / "hnf_core" / "__init__.py").read_text(encoding="utf-8")
    number = re.search(r'^__version__ = "(\d+\.\d+\.\d+)', text, re.MULTILINE)
    assert number is not None
    return f"{number.group(1)}.post{int(compute_fingerprint()[:8], 16)}"


def build(name: str, folder: Path = BUILD_FOLDER) -> Path:
    """Build the wheel for one of PLATFORMS, unless it exists already. Raises KernelError."""
    goal = PLATFORMS[name]
    path = folder / f"hnf_kernel-{make_version()}-py3-none-{goal.wheel}.whl"
    if path.is_file():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder) as temporary:
        libraries = [compile_library(goal, *processor, Path(temporary)) for processor in goal.processors]
        pack_wheel(path, goal, libraries, Path(temporary))
    for old in folder.glob(f"hnf_kernel-*-{goal.wheel}.whl"):
        if old != path:
            old.unlink()
    return path


def compile_library(goal: Platform, library: str, processor: str, folder: Path) -> Path:
    """Compile one shared library. Raises KernelError with the compiler's output."""
    out = folder / f"{library}{goal.suffix}"
    sources = [str(path) for path in sorted(SOURCE_FOLDER.glob("*.c"))]
    command = [sys.executable, "-m", "ziglang", "cc", "-target", goal.target, f"-mcpu={processor}", *OPTIONS]
    command += [] if goal.suffix == ".dll" else ["-fPIC", "-lm"]
    try:
        run = subprocess.run(
            [*command, *sources, "-o", str(out)], capture_output=True, text=True, timeout=COMPILE_S,
            stdin=subprocess.DEVNULL, env=os.environ | CACHE,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise KernelError(f"the compiler did not run: {error}") from error
    if run.returncode != 0:
        raise KernelError(f"{library} for {goal.target} does not compile:\n{run.stderr.strip()[-2000:]}")
    return out


def pack_wheel(path: Path, goal: Platform, libraries: list[Path], folder: Path) -> None:
    """Pack the libraries into a wheel, which is moved to its path only when complete."""
    from wheel.wheelfile import WheelFile

    dist_info = f"hnf_kernel-{make_version()}.dist-info"
    temporary_path = folder / path.name
    with WheelFile(temporary_path, "w") as wheel:
        wheel.writestr("hnf_kernel/__init__.py", INIT_TEXT)
        for library in libraries:
            wheel.write(library, f"hnf_kernel/{library.name}")
        wheel.writestr(
            f"{dist_info}/METADATA",
            f"Metadata-Version: 2.1\nName: hnf-kernel\nVersion: {make_version()}\nLicense: GPL-3.0-or-later\n",
        )
        tag = f"Tag: py3-none-{goal.wheel}\n"
        wheel.writestr(f"{dist_info}/WHEEL", f"Wheel-Version: 1.0\nGenerator: hnf\nRoot-Is-Purelib: false\n{tag}")
    os.replace(temporary_path, path)


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
        options = ["--disable-pip-version-check", "--no-input", "install", "-q", "--no-deps", "--force-reinstall"]
        run = subprocess.run(
            [python, "-m", "pip", *options, str(wheel)], capture_output=True, text=True, timeout=INSTALL_S,
            stdin=subprocess.DEVNULL,
        )  # fmt: skip
        if run.returncode != 0:
            raise KernelError(f"the kernel could not be installed for {python}:\n{run.stderr.strip()[-1000:]}")
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
