"""Create or refresh the project's Python environments; a second call with nothing changed returns at once.

    python3.11 tools/setup_env.py demo                  .venv, enough for `hnf touch`
    python3.11 tools/setup_env.py test blender-4.5 …    .venv with the test tools, .venv-4.5, …

Each name is a file in tools/requirements. A set of another Python than 3.11 is left out where that Python or a wheel
cannot be had, and tools/run_tests.py skips its tests for the reason that is given here. A stamp inside the environment
holds the hash of everything that decides its content; it is written only after pip has succeeded, so an interrupted
set-up is taken up again by the next call.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import sys
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import system_libraries

ROOT = Path(__file__).resolve().parent.parent
REQUIREMENTS = ROOT / "tools" / "requirements"
FOLDERS = {
    "demo": ".venv", "test": ".venv",
    "blender-5.2": ".venv-5.2", "blender-4.5": ".venv-4.5", "blender-4.2": ".venv-4.2",
}  # fmt: skip
PYTHON = (3, 11)
OTHER_PYTHONS = {"blender-5.2": (3, 13)}
# An environment that already holds a larger set serves the smaller one.
COVERED_BY = {"demo": ("demo", "test")}
KERNEL_FOLDERS = (".venv", ".venv-4.5", ".venv-5.2")
"""Environments that get the kernel. That of Blender 4.2 does not, so that its tests cover the numpy code."""
PIP_TIMEOUT_S = 1800
MAX_PARALLEL = 2


class SetupError(Exception):
    """Error for a set-up that cannot go on; the message names the remedy."""


def compute_fingerprint(name: str) -> str:
    """Hash the requirements, the pins, the project's own dependencies and the Python version."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    parts = [
        (REQUIREMENTS / f"{name}.txt").read_text(encoding="utf-8"),
        (REQUIREMENTS / "constraints.txt").read_text(encoding="utf-8"),
        (ROOT / "tools" / "pyproject.toml").read_text(encoding="utf-8"),
        repr((project["project"], project["build-system"])),
        repr((get_python(name), str(ROOT))),
    ]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def get_python(name: str) -> tuple[int, int]:
    """Return the Python version of set `name`."""
    return OTHER_PYTHONS.get(name, PYTHON)


def get_reason_path(folder: str) -> Path:
    """Return the path of the file that says why an environment cannot be had here; there is none where it can."""
    return ROOT / "build" / f"no-{folder.lstrip('.')}.txt"


def find_interpreter(version: tuple[int, int]) -> str:
    """Find a Python of this version, with pip to set up environments. Raises SetupError where there is none."""
    if version == sys.version_info[:2]:
        return sys.executable
    name = "python{}.{}".format(*version)
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    probe = f"import sys, ensurepip; sys.exit(sys.version_info[:2] != {version})"
    for python in (name, f"/usr/bin/{name}", f"/usr/local/bin/{name}", *map(str, sorted(pyenv.glob(f"*/bin/{name}")))):
        with contextlib.suppress(OSError, subprocess.SubprocessError):
            subprocess.run([python, "-c", probe], capture_output=True, timeout=60, check=True)
            return python
    raise SetupError(f"there is no {name} with venv on this machine. Install {name} and {name}-venv.")


def get_stamp_path(folder: Path, name: str) -> Path:
    """Return the path of the file that stores the hash of set `name`."""
    return folder / f"hnf-{name}.stamp"


def is_fresh(folder: Path, name: str) -> bool:
    """Return True if the environment holds the current set `name`, or a larger set that includes it."""
    for set_name in COVERED_BY.get(name, (name,)):
        stamp = get_stamp_path(folder, set_name)
        if stamp.is_file() and stamp.read_text(encoding="utf-8") == compute_fingerprint(set_name):
            return (folder / "bin" / "python").exists()
    return False


def ensure_interpreter(folder: Path, version: tuple[int, int] = PYTHON) -> Path:
    """Return the path of the environment's Python; create the environment if it is missing or broken."""
    python = folder / "bin" / "python"
    if folder.exists():
        probe = [str(python), "-c", f"import sys, pip; print(sys.version_info[:2] == {version})"]
        try:
            answer = subprocess.run(probe, capture_output=True, text=True, timeout=60, check=True).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            answer = "broken"
        if answer == "True":
            return python
        if answer == "False":
            wanted = "{}.{}".format(*version)
            raise SetupError(f"{folder} holds another Python than {wanted}. Remove or rename it, then run make again.")
        if not (folder / "pyvenv.cfg").is_file():
            raise SetupError(f"{folder} is in the way and is no Python environment. Rename it, then run make again.")
        shutil.rmtree(folder)
    subprocess.run([find_interpreter(version), "-m", "venv", str(folder)], check=True, timeout=300)
    return python


def pip(python: Path, *arguments: str) -> None:
    """Run pip in the project's root, quietly.

    Bytecode is compiled at the first import: most of torch is never imported.
    """
    options = ["--disable-pip-version-check", "--no-input", "install", "-q", "--no-compile"]
    command = [str(python), "-m", "pip", *options, *arguments]
    environment = os.environ | {"DIST_EXTRA_CONFIG": str(write_build_config(python.parent.parent))}
    subprocess.run(command, cwd=ROOT, env=environment, check=True, timeout=PIP_TIMEOUT_S, stdin=subprocess.DEVNULL)


def write_build_config(folder: Path) -> Path:
    """Write a setuptools configuration that keeps the builds for this environment out of the project's root.

    Builds for several environments would overwrite each other there.
    """
    config = folder / "build.cfg"
    config.write_text(f"[egg_info]\negg_base = {folder}\n[build]\nbuild_base = {folder / 'build'}\n", encoding="utf-8")
    return config


def ensure_environment(name: str) -> None:
    """Make the environment of set `name` hold exactly the pinned versions."""
    folder = ROOT / FOLDERS[name]
    get_reason_path(FOLDERS[name]).unlink(missing_ok=True)
    if is_fresh(folder, name):
        return
    started = time.monotonic()
    print(
        f"Setting up {folder.name} for {name} (downloads about {'2 GB' if name == 'test' else '600 MB'}) …", flush=True
    )
    python = ensure_interpreter(folder, get_python(name))
    get_stamp_path(folder, name).unlink(missing_ok=True)
    pip(python, "-c", str(REQUIREMENTS / "constraints.txt"), "setuptools")
    # Without isolation the build uses the pinned setuptools and downloads nothing else.
    pip(python, "--no-build-isolation", "-r", str(REQUIREMENTS / f"{name}.txt"))
    get_stamp_path(folder, name).write_text(compute_fingerprint(name), encoding="utf-8")
    print(f"{folder.name} is ready ({time.monotonic() - started:.0f} s).", flush=True)


def ensure_in_turn(names: list[str]) -> list[str]:
    """Ensure the sets of one folder in turn, up to the first that fails; returns its message, if any.

    That of another Python than 3.11 may fail: its reason is kept for tools/run_tests.py.
    """
    for name in names:
        try:
            ensure_environment(name)
        except (SetupError, OSError, subprocess.SubprocessError) as error:
            message = str(error)
            if not isinstance(error, SetupError):
                message = f"Setting up {FOLDERS[name]} failed: {str(error).rstrip('.')}. Fix that and run make again."
            if name not in OTHER_PYTHONS:
                return [message]
            path = get_reason_path(FOLDERS[name])
            path.parent.mkdir(exist_ok=True)
            path.write_text(message, encoding="utf-8")
            print(f"Without {name}: {message}", file=sys.stderr)
    return []


def main(names: list[str]) -> int:
    """Ensure each named set, MAX_PARALLEL folders at a time; returns 1 with one line for each that failed."""
    unknown = [name for name in names if name not in FOLDERS]
    if unknown or not names:
        print(f"usage: setup_env.py {{{','.join(FOLDERS)}}}…", file=sys.stderr)
        return 2
    if sys.version_info[:2] != PYTHON:
        print("Python 3.11 is needed: run this with python3.11, or name it with make PYTHON=…", file=sys.stderr)
        return 1
    if system_libraries.main() != 0:
        return 1
    folders: dict[str, list[str]] = {}
    for name in names:
        folders.setdefault(FOLDERS[name], []).append(name)
    with ThreadPoolExecutor(MAX_PARALLEL) as pool:
        errors = [error for messages in pool.map(ensure_in_turn, folders.values()) for error in messages]
    for error in errors:
        print(error, file=sys.stderr)
    if not errors:
        install_kernel([each for each in folders if each in KERNEL_FOLDERS and not get_reason_path(each).is_file()])
    return int(bool(errors))


def install_kernel(folders: list[str]) -> None:
    """Install the compiled kernel where it can be built; everything works without it, more slowly."""
    builder = ROOT / ".venv" / "bin" / "python"
    if not folders or not builder.exists():
        return
    pythons = [str(ROOT / folder / "bin" / "python") for folder in folders]
    try:
        if not is_fresh(ROOT / ".venv", "kernel"):
            pip(builder, "-r", str(REQUIREMENTS / "kernel.txt"))
            get_stamp_path(ROOT / ".venv", "kernel").write_text(compute_fingerprint("kernel"), encoding="utf-8")
        subprocess.run(
            [str(builder), "tools/build_kernel.py", "--install", *pythons], cwd=ROOT, check=True,
            timeout=PIP_TIMEOUT_S, stdin=subprocess.DEVNULL,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError) as error:
        print(f"There is no compiled kernel, and numpy does its work: {error}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
