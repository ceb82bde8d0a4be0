"""Build everything that a release consists of into dist/hnf-VERSION: nothing is uploaded.

    .venv/bin/python tools/build_release.py [--out dist] [--platform linux-x64]… [--python 3.11]… [--draft]

The folder gets hnf's wheel and source archive, the kernel's source archive and its wheel of every platform, a
repository of extension zips for every Blender, the changelog's section, a bill of materials (CycloneDX) and SHA-256
sums. `make release` runs the tests before and tools/check_install.py after it. docs/releasing.md says how to publish.
"""

from __future__ import annotations

import argparse
import email
import hashlib
import io
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import build_kernel
import build_repository
from build_extension import ROOT, BuildError, Target, build, read_project_version, read_source
from kernel.setup import PLATFORMS

BACKEND = "import sys; from setuptools import build_meta; getattr(build_meta, sys.argv[1])(sys.argv[2])"
SUMS, BILL, NOTES = "SHA256SUMS", "sbom.cdx.json", "release-notes.md"
BUILD_S = 600
SHORT_HOST = 8
"""Names of machines up to this many letters, such as `vm`, are words of texts too."""
PACKED = (
    "hnf_core", "hnf_blender", "tools/kernel", "pyproject.toml", "MANIFEST.in", "README.md", "LICENSE", "CHANGELOG.md",
    "CITATION.cff",
)  # fmt: skip


def read_notes(version: str) -> str:
    """Return the section of CHANGELOG.md on a version. Raises BuildError where there is none, or it is empty."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    match = re.search(rf"^## {re.escape(version)}\b[^\n]*\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
    if match is None or not match[1].strip():
        raise BuildError(f"CHANGELOG.md has no section '## {version}'. Name the section 'Unreleased' so, and date it.")
    return match[1].strip() + "\n"


def check_version(version: str) -> None:
    """Check that the version is a SemVer release and the same everywhere. Raises BuildError."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        raise BuildError(f"hnf_core/__init__.py: {version} is no release. Make it MAJOR.MINOR.PATCH.")
    if f"version: {version}\n" not in (ROOT / "CITATION.cff").read_text(encoding="utf-8"):
        raise BuildError(f"CITATION.cff is not of version {version}. Change it there.")


def run_git(*arguments: str) -> str:
    """Return what git prints in the checkout. Raises BuildError where it fails."""
    run = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, timeout=60)
    if run.returncode != 0:
        raise BuildError(f"git {arguments[0]} failed: {run.stderr.strip()}")
    return run.stdout.strip()


def run_backend(project: str, hook: str, out: Path) -> None:
    """Run a hook of a project's build backend in a copy of what it builds from. Raises BuildError with its last words.

    Setuptools builds in the project's folder, where builds that run side by side would meet.
    """
    with TemporaryDirectory() as copy:
        for name in PACKED:
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, Path(copy) / name, ignore=shutil.ignore_patterns("__pycache__", "build"))
            else:
                shutil.copy2(ROOT / name, copy)
        config = Path(copy) / "build.cfg"
        config.write_text("[sdist]\nowner = root\ngroup = root\n", encoding="utf-8")  # not who builds it
        run = subprocess.run(
            [sys.executable, "-c", BACKEND, hook, str(out)], cwd=Path(copy) / project, capture_output=True, text=True,
            timeout=BUILD_S, stdin=subprocess.DEVNULL, env=os.environ | {"DIST_EXTRA_CONFIG": str(config)},
        )  # fmt: skip
    if run.returncode != 0:
        raise BuildError(f"{hook} of {project or 'hnf'} failed:\n{(run.stdout + run.stderr).strip()[-2000:]}")


def describe_wheel(name: str, content: bytes) -> dict[str, Any]:
    """Describe one bundled wheel as a CycloneDX component: name, version, licence, hash."""
    package, version = name.split("-")[:2]
    with zipfile.ZipFile(io.BytesIO(content)) as wheel:
        metadata = next(each for each in wheel.namelist() if each.endswith(".dist-info/METADATA"))
        fields = email.message_from_bytes(wheel.read(metadata))
    licence = str(fields["License-Expression"] or "")
    first_line = str(fields["License"] or "").strip().partition("\n")[0]
    classified = [
        each.rpartition(" :: ")[2] for each in fields.get_all("Classifier", []) if each.startswith("License :: ")
    ]
    return {
        "type": "library",
        "bom-ref": name,
        "name": package.replace("_", "-"),
        "version": version,
        "purl": f"pkg:pypi/{package.replace('_', '-').lower()}@{version}?file_name={name}",
        "hashes": [{"alg": "SHA-256", "content": hashlib.sha256(content).hexdigest()}],
        "licenses": [{"license": {"name": licence or ", ".join(classified) or first_line or "see the wheel"}}],
    }


def make_bill(version: str, date: str, zips: list[Path]) -> dict[str, Any]:
    """Make the bill of materials of the extension zips: every wheel that they bundle, once."""
    components: dict[str, dict[str, Any]] = {}
    for path in zips:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.namelist():
                name = entry.rpartition("/")[2]
                if name.endswith(".whl") and name not in components:
                    components[name] = describe_wheel(name, archive.read(entry))
    product = {"type": "application", "bom-ref": "hnf", "name": "hnf", "version": version}
    licences = [{"license": {"id": "GPL-3.0-or-later"}}]
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"timestamp": date, "component": product | {"licenses": licences}},
        "components": [components[name] for name in sorted(components)],
        "dependencies": [{"ref": "hnf", "dependsOn": sorted(components)}],
    }


def list_members(name: str, content: bytes) -> Iterator[tuple[str, bytes]]:
    """List the files of an archive and of archives in it, as name and content; wheels of others are left out."""
    base = name.rpartition("/")[2]
    if name.endswith((".zip", ".whl")):
        if name.endswith(".whl") and not base.startswith("hnf"):
            return
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            for entry in archive.namelist():
                yield from list_members(f"{name}/{entry}", archive.read(entry))
    elif name.endswith(".tar.gz"):
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            for entry in archive:
                stream = archive.extractfile(entry)
                yield f"{name}/{entry.name}", b"" if stream is None else stream.read()
    else:
        yield name, content


def check_traces(folder: Path) -> None:
    """Check that no file names the checkout's folder, the person's or this machine. Raises BuildError."""
    host = socket.gethostname()
    traces = [f"{ROOT}", f"{Path.home()}/", *([host] if len(host) > SHORT_HOST else [])]
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        for name, content in list_members(path.relative_to(folder).as_posix(), path.read_bytes()):
            for trace in traces:
                if trace.encode() in content:
                    raise BuildError(f"{name} names {trace}, which is of this machine. Build it without.")


def write_sums(folder: Path) -> None:
    """Write the SHA-256 sums of all files of a folder, in the form that `sha256sum --check` takes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != SUMS)
    lines = [
        f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder).as_posix()}" for path in files
    ]
    (folder / SUMS).write_text("\n".join(lines) + "\n", encoding="utf-8")


def build_release(out: Path, targets: list[Target], *, is_draft: bool) -> Path:
    """Build all artifacts and return their folder, which appears when complete. Raises BuildError."""
    version = read_project_version()
    check_version(version)
    notes = read_notes(version)
    if not is_draft and run_git("status", "--porcelain"):
        raise BuildError(
            "The checkout has changes. Commit them, so that the release can be built again from its commit."
        )
    os.environ.setdefault("SOURCE_DATE_EPOCH", run_git("log", "-1", "--format=%ct"))
    folder, work = out / f"hnf-{version}", out / f"hnf-{version}.partial"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    run_backend("", "build_wheel", work)
    run_backend("", "build_sdist", work)
    run_backend("tools/kernel", "build_sdist", work)
    try:
        for name in PLATFORMS:
            shutil.copy2(build_kernel.build(name), work)
    except build_kernel.KernelError as error:
        raise BuildError(f"The kernel cannot be built: {error}") from error
    zips = [build(target, work / "repository") for target in targets]
    build_repository.publish_zips(zips, work / "repository")
    (work / NOTES).write_text(f"# {version}\n\n{notes}", encoding="utf-8")
    bill = make_bill(version, run_git("log", "-1", "--format=%cI"), zips)
    (work / BILL).write_text(json.dumps(bill, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    check_traces(work)
    write_sums(work)
    shutil.rmtree(folder, ignore_errors=True)
    work.rename(folder)
    return folder


def main(arguments: list[str] | None = None) -> int:
    """Build the release; returns 1 with a clear message where something is not ready."""
    source = read_source()
    parser = argparse.ArgumentParser(description="Build a release.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR")
    parser.add_argument("--platform", action="append", metavar="NAME", help="of the extension (default: all)")
    parser.add_argument("--python", action="append", metavar="X.Y", help="of the extension (default: all)")
    parser.add_argument("--draft", action="store_true", help="of a checkout with changes, to try it out")
    chosen = parser.parse_args(arguments)
    platforms, pythons = chosen.platform or source["platforms"], chosen.python or source["python"]
    try:
        targets = [Target(python, platform) for platform in platforms for python in pythons]
        folder = build_release(chosen.out.resolve(), targets, is_draft=chosen.draft)
    except BuildError as error:
        print(error, file=sys.stderr)
        return 1
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            print(f"{path.stat().st_size / 1e6:8.2f} MB  {path.relative_to(folder)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
