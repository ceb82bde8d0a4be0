"""A real, windowed Blender in a Debian chroot, with the extension installed as a user would install it."""

from __future__ import annotations

import os
import signal
import subprocess
from dataclasses import dataclass
from pathlib import Path

import build_extension
import pytest

ROOT = Path(__file__).resolve().parents[2]
CHROOT = ROOT / "tools" / "chroot_blender.sh"
UNAVAILABLE = 3  # exit code of tools/chroot_blender.sh where this machine cannot have it
HERE = "/hnf/tests/app"  # this folder, seen from inside


@dataclass(frozen=True)
class Finished:
    """How a command in the chroot ended, and all it said."""

    code: int
    output: str


@dataclass(frozen=True)
class App:
    """The installed application. share: the host's folder that is /share inside."""

    share: Path

    def run(self, *command: str, timeout: float = 120.0) -> Finished:
        """Run a command inside, in the profile of this session; ended as a group when it takes too long."""
        inside = ["env", "HOME=/share/home", "BLENDER_USER_RESOURCES=/share/profile", *command]
        process = subprocess.Popen(
            [str(CHROOT), "run", *inside],
            env=os.environ | {"HNF_CHROOT_SHARE": str(self.share)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            output, _ = process.communicate(timeout=timeout)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
        return Finished(process.returncode, output)

    def blender(self, *arguments: str, timeout: float = 120.0) -> Finished:
        """Run Blender with these arguments."""
        return self.run("blender", *arguments, timeout=timeout)


@pytest.fixture(scope="session")
def bare_app(tmp_path_factory: pytest.TempPathFactory) -> App:
    """Blender with an empty profile. Skips, with the reason, where this machine cannot have it."""
    made = subprocess.run(
        [str(CHROOT), "ensure"], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=1500
    )
    if made.returncode == UNAVAILABLE:
        pytest.skip("no windowed Blender here: " + made.stderr.strip().splitlines()[-1])
    assert made.returncode == 0, made.stderr
    share = tmp_path_factory.mktemp("share")
    (share / "home").mkdir()
    (share / "profile").mkdir()
    return App(share)


@pytest.fixture(scope="session")
def archive(bare_app: App) -> Path:
    """The extension for the Python of that Blender, in the shared folder."""
    version = bare_app.run("python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])")
    target = build_extension.Target(version.output.strip(), "linux-x64")
    return build_extension.build(target, bare_app.share / "dist", bare_app.share / "staging")


@pytest.fixture(scope="session")
def app(bare_app: App, archive: Path) -> App:
    """Blender with the extension installed and enabled."""
    done = bare_app.blender(
        "--command", "extension", "install-file", "-r", "user_default", "--enable", f"/share/dist/{archive.name}"
    )
    assert done.code == 0, done.output
    assert "Traceback" not in done.output, done.output
    return bare_app


@pytest.fixture(scope="session")
def scene(app: App) -> str:
    """A small scene to touch, as a path inside."""
    made = app.blender("-b", "--python-exit-code", "9", "--python", f"{HERE}/make_scene.py", "--", "/share/ribs.blend")
    assert made.code == 0, made.output
    assert (app.share / "ribs.blend").is_file()
    return "/share/ribs.blend"
