"""What a stranger gets: no advice to install what is not there, one version, no trace of the machine it was made on."""

from __future__ import annotations

import importlib.util
import io
import re
import socket
import subprocess
import tarfile
import tomllib
import zipfile
from pathlib import Path

import build_release
import check_install
import pytest
from build_extension import BuildError
from kernel import setup as kernel_project

import hnf_core

ROOT = Path(__file__).resolve().parents[2]
INSTALLS = re.compile(r"(?:pip install|uv tool install|uvx)((?:(?!, |[\n`;#)]).)*)")
"""An advice ends with its clause, its line or its quotation."""
OWN_NAME = re.compile(r"(?:^|[\s'\"])(hnf(?:[-_]kernel|[-_]core)?)(?:\[[\w,]*\])?(?:[=<>~!].*)?(?=$|[\s'\").,;])")
"""The project's name as a package of an index: not a path, a wheel's file name or the extra of a checkout."""
ABSOLUTE = re.compile(r"(?<![\w.\]/$}{)])/(?:root|work|mnt|opt|home|Users)/[\w.-]+")
MIRROR = re.compile(r"https?://[\w.-]*(?:mirror|pypi|debian|ubuntu|npmjs|artifactory|nexus)[\w.-]*", re.IGNORECASE)
GALLERY_BYTES = 1_000_000


def tracked() -> dict[str, str]:
    """Text files of the repository by name; in a copy without git, those of its source folders."""
    run = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, timeout=30)
    names = [name for name in run.stdout.split("\0") if name] if run.returncode == 0 else []
    paths = [ROOT / name for name in names] or [path for path in ROOT.glob("*/**/*") if path.suffix in (".py", ".md")]
    contents = {path: path.read_bytes() for path in paths if path.is_file() and path != Path(__file__)}
    return {path.relative_to(ROOT).as_posix(): each.decode() for path, each in contents.items() if is_text(each)}


def advised_names(text: str) -> list[str]:
    """Names of this project that a text advises to install from an index."""
    advice = [words for words in INSTALLS.findall(text) if "--no-index" not in words]  # that asks a folder
    return [name for words in advice for name in OWN_NAME.findall(words)]


def traces(text: str) -> list[str]:
    """Absolute paths of a developer's machine, package mirrors and this machine's name."""
    host = socket.gethostname()
    named = [host] if len(host) > 8 and host in text else []
    return ABSOLUTE.findall(text) + MIRROR.findall(text) + named


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("pip install hnf", ["hnf"]),
        ("pip install 'hnf[device]').", ["hnf"]),
        ("pip install torch hnf_kernel==0.2.0", ["hnf_kernel"]),
        ("pip install -e '.[batch]', then hnf batch.", []),
        ("pip install hnf-0.2.0-py3-none-any.whl", []),
        ("pip install torch scipy pillow.", []),
        ("uv tool install hnf", ["hnf"]),
        ("Install it (pip install bpy, Python 3.11), or run: blender -b --command hnf touch …", []),
        ("pip install --no-index --find-links wheels hnf-kernel", []),
    ],
)
def test_the_rule_on_names_catches_a_breach(text: str, names: list[str]) -> None:
    assert advised_names(text) == names


def test_nothing_advises_a_package_that_is_not_registered() -> None:
    shown = {name: text for name, text in tracked().items() if not name.startswith("tests/")}
    assert {"README.md", "docs/install.md", "hnf_core/cli/commands.py"} <= shown.keys()
    found = {}
    for path, text in shown.items():
        if names := advised_names(text):
            found[path] = names
    assert found == {}


@pytest.mark.parametrize(
    "text", ["cd /root/x", "'/home/me/a'", "http://deb.debian.org/debian", "https://pypi.org/simple"]
)
def test_the_rule_on_traces_catches_a_breach(text: str) -> None:
    assert traces(text) != []


def test_no_file_names_a_machine_or_a_mirror() -> None:
    found = {name: traces(text) for name, text in tracked().items()}
    assert {name: each for name, each in found.items() if each} == {}


def test_the_version_is_the_same_everywhere() -> None:
    build_release.check_version(hnf_core.__version__)
    assert build_release.read_notes(hnf_core.__version__)


def test_a_version_without_its_section_is_refused() -> None:
    with pytest.raises(BuildError, match=r"no section '## 99\.0\.0'"):
        build_release.read_notes("99.0.0")
    with pytest.raises(BuildError, match="MAJOR"):
        build_release.check_version("0.3.0.dev1")


def test_pins_of_the_environments_fit_the_stated_bounds() -> None:
    """What make installs is admitted by the metadata, and the kernel's compiler is one and the same."""
    packaging = pytest.importorskip("packaging.requirements", reason="packaging reads requirements")
    lines = (ROOT / "tools" / "requirements" / "constraints.txt").read_text(encoding="utf-8").splitlines()
    exact = dict(line.lower().split("==") for line in lines if "==" in line and not line.startswith("#"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    stated = [
        *project["dependencies"],
        *(each for extra in project["optional-dependencies"].values() for each in extra),
    ]
    stated += tomllib.loads((ROOT / "tools" / "kernel" / "pyproject.toml").read_text())["build-system"]["requires"]
    checked = [each for each in map(packaging.Requirement, stated) if each.name.lower() in exact]
    assert len(checked) > 12
    assert [str(each) for each in checked if not each.specifier.contains(exact[each.name.lower()])] == []


def test_the_lowest_versions_are_those_of_the_metadata() -> None:
    assert "numpy==1.24" in check_install.read_lowest()
    assert "pyserial==3.5" in check_install.read_lowest(("device",))


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """hnf's wheel and both source archives, built as a release builds them."""
    if importlib.util.find_spec("setuptools") is None:
        pytest.skip("setuptools builds them")
    folder = tmp_path_factory.mktemp("archives")
    build_release.run_backend("", "build_wheel", folder)
    build_release.run_backend("", "build_sdist", folder)
    build_release.run_backend("tools/kernel", "build_sdist", folder)
    return folder


def read_members(path: Path) -> dict[str, bytes]:
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as wheel:
            return {name: wheel.read(name) for name in wheel.namelist() if not name.endswith("/")}
    with tarfile.open(path) as archive:
        files = [(each, archive.extractfile(each)) for each in archive.getmembers() if each.isfile()]
        return {each.name.partition("/")[2]: stream.read() for each, stream in files if stream is not None}


def test_the_archives_hold_what_they_should(archives: Path) -> None:
    sources = {path.name for path in kernel_project.SOURCE_FOLDER.glob("*.[ch]")}
    (wheel,), (source,) = archives.glob("hnf-*.whl"), archives.glob("hnf-*.tar.gz")
    (kernel,) = archives.glob("hnf_kernel-*.tar.gz")
    packed = read_members(kernel)
    assert {name.partition("/")[2] for name in packed if name.startswith("source/")} == sources
    assert {"LICENSE", "setup.py", "pyproject.toml", "hnf_kernel/__init__.py"} <= packed.keys()
    assert f"Version: {kernel_project.make_version()}".encode() in packed["PKG-INFO"]
    inside = read_members(source)
    assert {f"hnf_core/kernel/source/{name}" for name in sources} <= inside.keys()
    assert {"LICENSE", "README.md", "CHANGELOG.md", "hnf_core/data/library.json"} <= inside.keys()
    names = read_members(wheel)
    assert {"hnf_core/api.py", "hnf_core/data/library.json", "hnf_blender/cli.py"} <= names.keys()
    assert [name for name in names if name.startswith(("tests", "tools"))] == []
    assert wheel.name.endswith("-py3-none-any.whl")


def test_the_archives_name_no_machine(archives: Path) -> None:
    for path in archives.iterdir():
        members = read_members(path)
        texts = {name: content.decode() for name, content in members.items() if is_text(content)}
        assert {name: traces(text) for name, text in texts.items() if traces(text)} == {}
        assert [name for name, content in members.items() if str(ROOT).encode() in content] == []


def is_text(content: bytes) -> bool:
    try:
        return "\0" not in content.decode()
    except UnicodeDecodeError:
        return False


def test_the_bill_names_each_bundled_wheel_once(tmp_path: Path) -> None:
    wheel = io.BytesIO()
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("a_b-1.0.dist-info/METADATA", "Name: a-b\nVersion: 1.0\nLicense-Expression: MIT\n")
    for name in ("x.zip", "y.zip"):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            archive.writestr("wheels/a_b-1.0-py3-none-any.whl", wheel.getvalue())
    bill = build_release.make_bill("1.0.0", "2026-01-01T00:00:00+00:00", sorted(tmp_path.glob("*.zip")))
    (component,) = bill["components"]
    assert (component["name"], component["version"]) == ("a-b", "1.0")
    assert component["licenses"] == [{"license": {"name": "MIT"}}]
    assert bill["dependencies"] == [{"ref": "hnf", "dependsOn": [component["bom-ref"]]}]


def test_a_file_that_names_this_machine_is_refused(tmp_path: Path) -> None:
    bundle = io.BytesIO()
    with zipfile.ZipFile(bundle, "w") as wheel:
        wheel.writestr("a/lib.so", f"\0{Path.home()}/a.c")
    with zipfile.ZipFile(tmp_path / "x.zip", "w") as archive:
        archive.writestr("wheels/other-1.0-py3-none-any.whl", bundle.getvalue())
    build_release.check_traces(tmp_path)  # another project's wheel stays as the index has it
    with zipfile.ZipFile(tmp_path / "x.zip", "a") as archive:
        archive.writestr("wheels/hnf_kernel-1.0-py3-none-any.whl", bundle.getvalue())
    with pytest.raises(BuildError, match=r"x\.zip/wheels/hnf_kernel-.*/a/lib\.so names "):
        build_release.check_traces(tmp_path)
    (tmp_path / "x.zip").unlink()
    (tmp_path / "notes.md").write_text(f"made in {ROOT}\n")
    with pytest.raises(BuildError, match=r"notes\.md names "):
        build_release.check_traces(tmp_path)


def test_sums_are_those_of_sha256sum(tmp_path: Path) -> None:
    (tmp_path / "repository").mkdir()
    (tmp_path / "a.txt").write_text("a")
    (tmp_path / "repository" / "b.txt").write_text("b")
    build_release.write_sums(tmp_path)
    lines = (tmp_path / "SHA256SUMS").read_text().splitlines()
    assert lines[0] == "ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb  a.txt"
    assert [line.partition("  ")[2] for line in lines] == ["a.txt", "repository/b.txt"]


def test_the_gallery_is_small_and_complete() -> None:
    files = sorted((ROOT / "docs" / "gallery").iterdir())
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert [path.name for path in files if f"(gallery/{path.name})" not in page] == []
    assert len([path for path in files if path.suffix == ".mp3"]) == 10
    assert sum(path.stat().st_size for path in files) < GALLERY_BYTES


def test_the_container_has_the_libraries_that_blender_loads() -> None:
    text = (ROOT / "tools" / "Dockerfile").read_text(encoding="utf-8")
    packages = {*(ROOT / "tools" / "apt.txt").read_text(encoding="utf-8").split()} - {"python3-venv"}
    assert [name for name in packages if not re.search(rf"\s{re.escape(name)}\s", text)] == []
