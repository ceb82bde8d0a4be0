"""Build the Blender extension: dist/hnf-VERSION-PLATFORM-pyXY.zip, checked by Blender's own validator.

    .venv/bin/python tools/build_extension.py [--python 3.11]… [--platform linux-x64]… [--out dist]     default: all

The extension's root is hnf_blender, with hnf_core inside it. An extension is the package `bl_ext.REPOSITORY.hnf`, and
Blender warns of any module outside that name, so `from hnf_core.x import y` becomes a relative import. The manifest's
source is addon_manifest.toml; wheels are taken from the package index unmodified and stored in build/wheels.
"""

from __future__ import annotations

import argparse
import ast
import fcntl
import hashlib
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeGuard

import build_kernel

CORE, BRIDGE = "hnf_core", "hnf_blender"
MODULE_NAME = re.compile(rf"({CORE}|{BRIDGE})(\.\w+)+")


class ImportRewriteError(Exception):
    """Error for an import that cannot be made relative; the message names file and line."""


def rewrite_imports(text: str, level: int, name: str) -> str:
    """Make the hnf_core imports of source `text` relative, `level` dots deep; every other byte stays.

    Raises ImportRewriteError (naming `name` and the line) for `import hnf_core`, for an absolute import of
    hnf_blender, and for a string that names a module of either: at run time none of them would be found.
    """
    lines = text.splitlines(keepends=True)
    for node in ast.walk(ast.parse(text)):
        if _is_core_import(node):
            row, column = node.lineno - 1, _to_character_column(lines[node.lineno - 1], node.col_offset)
            head, tail = lines[row][:column], lines[row][column:]
            lines[row] = head + re.sub(rf"^from\s+{CORE}\b", f"from {'.' * level}{CORE}", tail)
        elif _is_absolute_reference(node):
            raise ImportRewriteError(
                f"{name}:{getattr(node, 'lineno', 0)}: only `from {CORE}.x import y` and relative imports can move "
                "into the extension. Write it so."
            )
    new = "".join(lines)
    remaining = [node.lineno for node in ast.walk(ast.parse(new)) if _is_core_import(node)]
    if remaining:
        raise ImportRewriteError(f"{name}:{remaining[0]}: `from` and `{CORE}` stand on different lines. Join them.")
    return new


def rewrite_file(path: Path, extension_root: Path) -> None:
    """Rewrite one file of the staged extension in place; its depth decides the number of dots."""
    relative = path.relative_to(extension_root)
    text = path.read_text(encoding="utf-8")
    if relative.parts[0] == CORE:
        # hnf_core moves as a whole and is relative inside already: anything to rewrite there is a mistake.
        new = rewrite_imports(text, len(relative.parts), str(relative))
        if new != text:
            raise ImportRewriteError(f"{relative}: inside {CORE} imports are relative. Write it so.")
        return
    new = rewrite_imports(text, len(relative.parts), f"{BRIDGE}/{relative}")
    if new != text:
        path.write_text(new, encoding="utf-8")


def _is_core_import(node: ast.AST) -> TypeGuard[ast.ImportFrom]:
    return isinstance(node, ast.ImportFrom) and node.level == 0 and _get_top_package(node.module) == CORE


def _get_top_package(module: str | None) -> str:
    return (module or "").partition(".")[0]


def _to_character_column(line: str, byte_column: int) -> int:
    return len(line.encode("utf-8")[:byte_column].decode("utf-8"))


def _is_absolute_reference(node: ast.AST) -> bool:
    if isinstance(node, ast.Import):
        return any(_get_top_package(alias.name) in (CORE, BRIDGE) for alias in node.names)
    if isinstance(node, ast.ImportFrom):
        return node.level == 0 and _get_top_package(node.module) == BRIDGE
    return isinstance(node, ast.Constant) and isinstance(node.value, str) and bool(MODULE_NAME.fullmatch(node.value))


ROOT = Path(__file__).resolve().parent.parent
WHEELS = ROOT / "build" / "wheels"
STAGING = ROOT / "build" / "extension"
OMITTED_FILES = frozenset(
    f"hnf_core/data/{name}.safetensors" for name in ("field-held-out", "field-encoders", "encoder")
)
"""Weights that only `hnf eval` uses, which needs torch and does not run in Blender; and E's network, whose tokens the
shipped field refuses."""
SOURCE_ONLY = ("batch", "study")
"""Folders that are not packed: `hnf batch` and `hnf study` run from the source."""
IGNORED = shutil.ignore_patterns(
    "__pycache__", "*.pyc", ".*", "*.blend1", *SOURCE_ONLY, *(Path(name).name for name in OMITTED_FILES)
)
TAGLINE_LIMIT = 64
KERNEL_PLATFORMS = ("linux-x64", "windows-x64")
"""Platforms on which the kernel has run. It was built for Macs but never run there, so they use numpy."""


class BuildError(Exception):
    """Error for an extension that cannot be built; the message names the file and the remedy."""


@dataclass(frozen=True)
class Target:
    """Target of one zip: a Python version ("3.11") and one of Blender's platform names ("linux-x64")."""

    python: str
    platform: str

    @property
    def tag(self) -> str:
        """Name of the target in file names, such as `linux-x64-py311`."""
        return f"{self.platform}-py{self.python.replace('.', '')}"


def read_source() -> dict[str, Any]:
    """Read addon_manifest.toml. Raises BuildError where it is unreadable or its tagline is too long."""
    try:
        source = tomllib.loads((ROOT / "addon_manifest.toml").read_text(encoding="utf-8"))
    except (OSError, tomllib.TOMLDecodeError) as error:
        raise BuildError(f"addon_manifest.toml cannot be read: {error}") from error
    if len(source["manifest"]["tagline"]) > TAGLINE_LIMIT:
        raise BuildError(f"addon_manifest.toml: the tagline is longer than {TAGLINE_LIMIT} characters. Shorten it.")
    return source


def read_project_version() -> str:
    """Read hnf_core.__version__ without importing. Raises BuildError where it is no x.y.z."""
    text = (ROOT / "hnf_core" / "__init__.py").read_text(encoding="utf-8")
    match = re.search(r'^__version__ = "(\d+\.\d+\.\d+[\w.+-]*)"$', text, re.MULTILINE)
    if match is None:
        raise BuildError('hnf_core/__init__.py holds no line __version__ = "x.y.z". Add it.')
    return match.group(1)


def list_requirements(source: dict[str, Any], target: Target) -> list[str]:
    """List the pinned wheels of one target. Raises BuildError for a Python or platform not in the source."""
    for table, key in (("python", target.python), ("platforms", target.platform)):
        if key not in source[table]:
            raise BuildError(f"addon_manifest.toml knows no {key}; it has {', '.join(source[table])}.")
    return sorted(source["wheels"]["every_python"] + source["python"][target.python]["wheels"])


def fetch_wheels(source: dict[str, Any], target: Target) -> list[Path]:
    """Fetch the target's wheels from build/wheels or the package index. Raises BuildError where pip finds none."""
    wanted = list_requirements(source, target)
    folder, stamp = WHEELS / target.tag, WHEELS / f"{target.tag}.stamp"
    digest = hashlib.sha256("\n".join([*wanted, *source["platforms"][target.platform]]).encode()).hexdigest()
    WHEELS.mkdir(parents=True, exist_ok=True)
    with (WHEELS / f"{target.tag}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # test environments run side by side and share the folder
        if not (stamp.is_file() and stamp.read_text(encoding="utf-8") == digest):
            shutil.rmtree(folder, ignore_errors=True)
            download(wanted, source["platforms"][target.platform], target.python, folder)
            stamp.write_text(digest, encoding="utf-8")
    wheels = sorted(folder.glob("*.whl"))
    if len(wheels) != len(wanted):
        raise BuildError(f"{folder} holds {len(wheels)} wheels where {len(wanted)} are wanted. Delete it and {stamp}.")
    return wheels


def build_kernel_wheels(target: Target) -> list[Path]:
    """Build the compiled kernel for platforms on which it has run (Windows: under Wine).

    Returns an empty list, with a message on stderr, where the compiler is not installed. Raises BuildError where the
    kernel does not compile.
    """
    if target.platform not in KERNEL_PLATFORMS:
        return []
    if importlib.util.find_spec("ziglang") is None:
        print("Without the compiled kernel: tools/requirements/kernel.txt is not installed.", file=sys.stderr)
        return []
    try:
        return [build_kernel.build(target.platform)]
    except build_kernel.KernelError as error:
        raise BuildError(f"The kernel cannot be built: {error}") from error


def download(wanted: list[str], platform_tags: list[str], python: str, folder: Path) -> None:
    """Download exactly the wanted wheels with pip, for another Python and platform than this one."""
    abi = "cp" + python.replace(".", "")
    options = ["--no-deps", "--only-binary=:all:", "--implementation", "cp", "--python-version", python]
    options += [word for tag in (abi, "abi3", "none") for word in ("--abi", tag)]
    options += [word for tag in platform_tags for word in ("--platform", tag)]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--no-input", "download", "-q", *options]
    run = subprocess.run(
        [*command, "-d", str(folder), *wanted], capture_output=True, text=True, timeout=900, stdin=subprocess.DEVNULL
    )
    if run.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        raise BuildError(f"The wheels for Python {python} could not be downloaded:\n{run.stderr.strip()[-1500:]}")


def format_toml(table: dict[str, Any]) -> list[str]:
    """Format a table of strings and lists of strings as `key = value` lines, whose JSON form is valid TOML."""
    return [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()]


def format_manifest(source: dict[str, Any], target: Target, version: str, wheels: list[Path]) -> str:
    """Format blender_manifest.toml of one target."""
    fields = {key: value for key, value in source["manifest"].items() if not isinstance(value, dict)}
    fields["version"] = version
    fields |= {key: value for key, value in source["python"][target.python].items() if key.startswith("blender_")}
    fields["platforms"] = [target.platform]
    fields["wheels"] = [f"./wheels/{wheel.name}" for wheel in wheels]
    tables = {key: value for key, value in source["manifest"].items() if isinstance(value, dict)}
    lines = format_toml(fields)
    for name, table in tables.items():
        lines += [
            "",
            f"[{name}]",
            *(f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()),
        ]
    return "\n".join(lines) + "\n"


def stage(source: dict[str, Any], target: Target, version: str, folder: Path) -> None:
    """Lay the extension out in `folder`: rewritten code, data files, licence, manifest, wheels."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(ROOT / "hnf_blender", folder, ignore=IGNORED)
    shutil.copytree(ROOT / "hnf_core", folder / "hnf_core", ignore=IGNORED)
    for path in sorted(folder.rglob("*.py")):
        try:
            rewrite_file(path, folder)
        except ImportRewriteError as error:
            raise BuildError(str(error)) from error
    shutil.copy2(ROOT / "LICENSE", folder / "LICENSE")
    wheels = [*fetch_wheels(source, target), *build_kernel_wheels(target)]
    (folder / "wheels").mkdir()
    for wheel in wheels:
        shutil.copy2(wheel, folder / "wheels" / wheel.name)
    text = format_manifest(source, target, version, wheels)
    (folder / "blender_manifest.toml").write_text(text, encoding="utf-8")


def find_blender_scripts() -> Path:
    """Find the folder `scripts` of this Python's bpy without importing it. Raises BuildError where there is none."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or not spec.submodule_search_locations:
        raise BuildError("This Python has no bpy, whose extension tool builds the zip. Use .venv/bin/python.")
    found = sorted(Path(spec.submodule_search_locations[0]).glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not found:
        raise BuildError("This bpy has no extension tool (blender_ext.py). Blender 4.2 or later is needed.")
    return found[-1].parents[3]


def run_blender_tool(verb: str, *arguments: str, tags: bool = True) -> str:
    """Run Blender's extension tool and return its output.

    Set tags where the verb checks an extension's tags. Raises BuildError with the tool's output where it fails.
    """
    scripts = find_blender_scripts()
    tool = scripts / "addons_core" / "bl_pkg" / "cli" / "blender_ext.py"
    command = [sys.executable, str(tool), verb, *arguments]
    if tags:
        known = scripts / "modules" / "_bpy_internal" / "extensions" / "tags.py"  # as Blender's own command line does
        command += ["--valid-tags", str(known) if known.is_file() else ""]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    if run.returncode != 0:
        raise BuildError(f"Blender refuses the extension:\n{run.stdout}{run.stderr}")
    return run.stdout


def build(target: Target, out: Path, staging: Path = STAGING, version: str = "") -> Path:
    """Build and validate one zip; returns its path. The version defaults to the project's own. Raises BuildError."""
    source, version = read_source(), version or read_project_version()
    folder = staging / target.tag
    stage(source, target, version, folder)
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{source['manifest']['id']}-{version}-{target.tag}.zip"
    run_blender_tool("build", "--source-dir", str(folder), "--output-filepath", str(path))
    run_blender_tool("validate", str(path))
    return path


def main(arguments: list[str] | None = None) -> int:
    """Build every Python × platform that is named; returns 1 with a clear message where one fails."""
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--python", action="append", metavar="X.Y", help="Python of Blender (default: all)")
    parser.add_argument("--platform", action="append", metavar="NAME", help="Blender's platform (default: all)")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR")
    chosen = parser.parse_args(arguments)
    source = read_source()
    for platform in chosen.platform or source["platforms"]:
        for python in chosen.python or source["python"]:
            try:
                path = build(Target(python, platform), chosen.out)
            except BuildError as error:
                print(error, file=sys.stderr)
                return 1
            print(f"{path} ({path.stat().st_size / 1e6:.1f} MB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
