"""A real, windowed Blender in a Debian chroot, with the extension installed as a user would install it."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import build_extension
import pytest

from . import lent_python
from .session import CHROOT, HERE, App, Played, constant_of, play, scenarios

UNAVAILABLE = 3  # exit code of tools/chroot_blender.sh where this machine cannot have it


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
    lent_python.lend(share)
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


PLAYED: dict[str, Played] = {}
LONGEST = "survival"
"""Begins first, so that the two end at about the same time."""
AT_ONCE = 2
"""Sessions side by side: most of a session is waiting for redraws, a bake's second process and its own pauses."""


@pytest.fixture(scope="session")
def played(
    app: App,
    scene: str,
    request: pytest.FixtureRequest,
    record_testsuite_property: Callable[[str, object], None],
) -> Iterator[Callable[[str], Played]]:
    """Scenario → what its one session in a window brought back.

    All that the collected tests need are played from the first request on: those that measure time alone, then the
    others side by side.
    """
    named = [getattr(item, "callspec", None) for item in request.session.items]
    asked = {str(each.params["scenario"]) for each in named if each is not None and "scenario" in each.params}
    wanted = [name for name in scenarios() if name in asked]
    alone = [name for name in wanted if constant_of(name, "ALONE", "no") == "yes"]
    with ThreadPoolExecutor(AT_ONCE) as pool:
        for name in alone:
            PLAYED[name] = play(app, name)
        rest = sorted((name for name in wanted if name not in alone), key=lambda name: name != LONGEST)
        others = {name: pool.submit(play, app, name) for name in rest}

        def of(scenario: str) -> Played:
            if scenario not in PLAYED:
                PLAYED[scenario] = others[scenario].result()
            return PLAYED[scenario]

        yield of
        for future in others.values():
            future.cancel()
    for version in sorted({played.version for played in PLAYED.values()}):
        record_testsuite_property("blender", version)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Which Blender it was, and the figures that the scenarios measured."""
    versions = sorted({played.version for played in PLAYED.values()})
    if PLAYED:
        terminalreporter.write_line(f"Blender {', '.join(versions)} in a window: {len(PLAYED)} sessions")
    for played in PLAYED.values():
        for one in played.measured:
            terminalreporter.write_line(f"  {played.scenario}: {one['what']}: {one['value']:g} {one['unit']}")
