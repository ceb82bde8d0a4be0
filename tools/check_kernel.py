"""Run another platform's kernel beside this machine's, on the same inputs, and compare what they print.

    .venv/bin/python tools/check_kernel.py --platform windows-x64 --with wine
    .venv/bin/python tools/check_kernel.py --platform linux-arm64 --with "qemu-aarch64 -L /usr/aarch64-linux-gnu"

So builds for Windows and for Arm are checked on Linux (Debian's packages wine, qemu-user and libc6-arm64-cross). Every
library of the other platform's wheel is called.
"""

from __future__ import annotations

import argparse
import os
import re
import shlex
import subprocess
import sys
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import build_kernel
from kernel.setup import COMPILE_S, PLATFORMS, SOURCE_FOLDER, detect_platform

CHECK_SOURCE = Path(__file__).with_suffix(".c")
MAX_RUN_S = 120


def run_check(name: str, folder: Path, runner: list[str]) -> dict[str, str]:
    """Run the check with each library of a platform's wheel and return the outputs. Raises KernelError."""
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
    subprocess.run(command, check=True, timeout=COMPILE_S, env=os.environ | build_kernel.CACHE)
    outputs = {}
    for library, _ in platform.processors:
        words = [*runner, str(program), f"{library}{platform.suffix}"]
        if platform.suffix != ".dll":
            words[-1] = str(out / "hnf_kernel" / words[-1])
        run = subprocess.run(
            words, cwd=out / "hnf_kernel", capture_output=True, text=True, timeout=MAX_RUN_S,
            env=os.environ | {"WINEDEBUG": "-all"},
        )  # fmt: skip
        if run.returncode != 0:
            raise build_kernel.KernelError(f"{library} of {name}:\n{run.stdout}{run.stderr}")
        outputs[library] = run.stdout.replace("\r", "")
    return outputs


def main() -> int:
    """Return 0 if both platforms print the same, but for whether their processors have wide vectors."""
    parser = argparse.ArgumentParser(description="Compare another platform's kernel with this machine's.")
    parser.add_argument("--platform", choices=PLATFORMS, required=True)
    parser.add_argument("--with", dest="runner", default="", metavar="COMMAND", help="what runs its programs here")
    chosen = parser.parse_args()
    with TemporaryDirectory() as folder:
        try:
            expected = run_check(detect_platform(), Path(folder), [])
            actual = run_check(chosen.platform, Path(folder), shlex.split(chosen.runner))
        except (build_kernel.KernelError, subprocess.SubprocessError, OSError) as error:
            print(error, file=sys.stderr)
            return 1
    all_same = "hnf_kernel" in actual
    for library, text in actual.items():
        same = drop_vectors(text) == drop_vectors(expected[library])
        print(f"{library}: {'the same' if same else 'NOT the same'}\n{text}{'' if same else expected[library]}")
        all_same &= same
    return int(not all_same)


def drop_vectors(text: str) -> str:
    """Drop from the first line that which depends on the processor."""
    return re.sub(r", wide vectors \d", "", text, count=1)


if __name__ == "__main__":
    sys.exit(main())
