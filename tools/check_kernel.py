"""Run another platform's kernel beside this machine's, on the same inputs, and compare what they print.

    .venv/bin/python tools/check_kernel.py --platform windows-x64 --with wine

It is what a build for Windows is tried with on Linux (Debian's package wine64). Both builds of either wheel are called.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import build_kernel
from build_kernel import PLATFORMS, SOURCE_FOLDER

CHECK_SOURCE = Path(__file__).with_suffix(".c")
MAX_RUN_S = 120


def run_check(name: str, folder: Path, runner: list[str]) -> dict[str, str]:
    """What the check prints, for each library of a platform's wheel. Raises KernelError."""
    platform, out = PLATFORMS[name], folder / name
    with zipfile.ZipFile(build_kernel.build(name)) as wheel:
        wheel.extractall(out)
    program = out / ("check.exe" if platform.suffix == ".dll" else "check")
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        platform.target,
        "-O1",
        f"-I{SOURCE_FOLDER}",
        str(CHECK_SOURCE),
    ]
    command += ["-o", str(program), *([] if platform.suffix == ".dll" else ["-ldl", "-lm"])]
    subprocess.run(command, check=True, timeout=build_kernel.COMPILE_S, env=os.environ | build_kernel.CACHE)
    found = {}
    for library, _ in platform.processors:
        words = [*runner, str(program), f"{library}{platform.suffix}"]
        if not runner:
            words[-1] = str(out / "hnf_kernel" / words[-1])
        run = subprocess.run(
            words, cwd=out / "hnf_kernel", capture_output=True, text=True, timeout=MAX_RUN_S,
            env=os.environ | {"WINEDEBUG": "-all"},
        )  # fmt: skip
        if run.returncode != 0:
            raise build_kernel.KernelError(f"{library} of {name}:\n{run.stdout}{run.stderr}")
        found[library] = run.stdout.replace("\r", "")
    return found


def main() -> int:
    """0 where both print the same."""
    parser = argparse.ArgumentParser(description="Compare another platform's kernel with this machine's.")
    parser.add_argument("--platform", choices=PLATFORMS, required=True)
    parser.add_argument("--with", dest="runner", default="", metavar="COMMAND", help="what runs its programs here")
    chosen = parser.parse_args()
    with TemporaryDirectory() as folder:
        try:
            here = run_check(build_kernel.detect_platform(), Path(folder), [])
            there = run_check(chosen.platform, Path(folder), shlex.split(chosen.runner))
        except (build_kernel.KernelError, subprocess.SubprocessError, OSError) as error:
            print(error, file=sys.stderr)
            return 1
    for library, text in here.items():
        same = there.get(library) == text
        print(f"{library}: {'the same' if same else 'NOT the same'}\n{text}{'' if same else there.get(library, '')}")
    return int(here != there)


if __name__ == "__main__":
    sys.exit(main())
