"""Build hnf-kernel: C sources, compiled by zig for one platform, in a wheel tagged py3-none-PLATFORM.

The sources are hnf_core/kernel/source of the checkout, and `source` in the source archive. Nothing is linked to Python,
so the wheel fits every Python 3. HNF_KERNEL_PLATFORM in the environment names another platform than this machine's.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
CHECKOUT = HERE.parent.parent
PACKED = HERE / "PKG-INFO"
"""Only a source archive has it."""
SOURCE_FOLDER = HERE / "source" if PACKED.is_file() else CHECKOUT / "hnf_core" / "kernel" / "source"
LICENSE = (HERE if PACKED.is_file() else CHECKOUT) / "LICENSE"
COMPILE_S = 300
OPTIONS = (
    "-O3", "-std=c11", "-ffp-contract=fast", "-fno-math-errno", "-fno-trapping-math", "-fno-sanitize=all",
    "-fvisibility=hidden", "-Wall", "-Wextra", "-Werror", "-shared", "-s",
)  # fmt: skip


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
    "linux-arm64": Platform("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64", ".so", ARM64),
    "windows-x64": Platform("x86_64-windows-gnu", "win_amd64", ".dll", X64),
    "macos-arm64": Platform("aarch64-macos.11.0", "macosx_11_0_arm64", ".dylib", ARM64),
    "macos-x64": Platform("x86_64-macos.11.0", "macosx_11_0_x86_64", ".dylib", X64),
}


def detect_platform() -> str:
    """Return the name of the platform to build for: HNF_KERNEL_PLATFORM, or this machine's."""
    name = {"Linux": "linux", "Windows": "windows", "Darwin": "macos"}.get(platform.system(), platform.system())
    processor = {"aarch64": "arm64", "amd64": "x64", "x86_64": "x64"}.get(
        platform.machine().lower(), platform.machine()
    )
    found = os.environ.get("HNF_KERNEL_PLATFORM") or f"{name}-{processor}"
    if found not in PLATFORMS:
        sys.exit(f"hnf-kernel is not built for {found}, but for {', '.join(PLATFORMS)}; without it, hnf uses numpy.")
    return found


def compute_fingerprint() -> str:
    """Hash everything that determines the build."""
    files = [*sorted(SOURCE_FOLDER.glob("*.[ch]")), Path(__file__), HERE / "pyproject.toml"]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in files)).hexdigest()


def make_version() -> str:
    """Join hnf's version and a number from the sources' hash, by which pip and Blender tell builds apart."""
    if PACKED.is_file():
        text, pattern = PACKED.read_text(encoding="utf-8"), r"^Version: (\S+)"
    else:
        text, pattern = (CHECKOUT / "hnf_core" / "__init__.py").read_text(encoding="utf-8"), r'^__version__ = "([\d.]+)'
    number = re.search(pattern, text, re.MULTILINE)
    assert number is not None
    return number[1] if PACKED.is_file() else f"{number[1]}.post{int(compute_fingerprint()[:8], 16)}"


def compile_library(goal: Platform, library: str, processor: str, folder: Path) -> None:
    """Compile one shared library into a folder; end with the compiler's output where that fails."""
    sources = [str(path) for path in sorted(SOURCE_FOLDER.glob("*.c"))]
    command = [sys.executable, "-m", "ziglang", "cc", "-target", goal.target, f"-mcpu={processor}", *OPTIONS]
    command += [] if goal.suffix == ".dll" else ["-fPIC", "-lm"]
    # By default a Mac's library carries the path that it was built at.
    command += [f"-Wl,-install_name,@rpath/{library}.dylib"] if goal.suffix == ".dylib" else []
    try:
        run = subprocess.run(
            [*command, *sources, "-o", str(folder / f"{library}{goal.suffix}")], capture_output=True, text=True,
            timeout=COMPILE_S, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        sys.exit(f"the compiler did not run: {error}")
    if run.returncode != 0:
        sys.exit(f"{library} for {goal.target} does not compile:\n{run.stderr.strip()[-2000:]}")


class BuildLibraries(build_py):
    """Command that puts the compiled libraries, and the licence, beside the package's one module."""

    def run(self) -> None:
        """Copy the module, compile every library of the platform."""
        super().run()
        goal, folder = PLATFORMS[detect_platform()], Path(self.build_lib) / "hnf_kernel"
        for library, processor in goal.processors:
            compile_library(goal, library, processor, folder)
        shutil.copy2(LICENSE, folder / "LICENSE")


class CompiledDistribution(Distribution):
    """Distribution that holds compiled files, of which setuptools knows nothing."""

    def has_ext_modules(self) -> bool:
        """Return True: files of a platform, laid out at the wheel's root."""
        return True


class PlatformWheel(bdist_wheel):
    """Command that names the platform in the wheel's tag, and no Python version."""

    def get_tag(self) -> tuple[str, str, str]:
        """Return the three parts of the wheel's tag."""
        return "py3", "none", PLATFORMS[detect_platform()].wheel


class SourceArchive(sdist):
    """Command that packs the C sources and the licence, which lie elsewhere in a checkout."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        """Lay out the archive's files."""
        super().make_release_tree(base_dir, files)
        shutil.copytree(SOURCE_FOLDER, Path(base_dir) / "source", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy2(LICENSE, base_dir)


if __name__ == "__main__":
    setup(
        version=make_version(),
        distclass=CompiledDistribution,
        cmdclass={"build_py": BuildLibraries, "bdist_wheel": PlatformWheel, "sdist": SourceArchive},
    )
