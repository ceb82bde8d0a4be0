"""An own extension repository: Blender installs from it, and an update arrives."""

from __future__ import annotations

import functools
import http.server
import json
import re
import sys
import textwrap
import threading
from collections.abc import Iterator
from pathlib import Path

import build_extension
import build_repository
import pytest
from test_extension import result_of, run_python

NEXT = "99.0.0"
TARGET = build_extension.Target(f"{sys.version_info.major}.{sys.version_info.minor}", "linux-x64")


@pytest.fixture(scope="module")
def zips(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The extension as it is, and as its next version."""
    folder = tmp_path_factory.mktemp("zips")
    now, later = (build_extension.build(TARGET, folder / "dist", folder / "staging", version) for version in ("", NEXT))
    return now, later


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None: ...


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder, and the address it is served at by a plain static server."""
    folder = tmp_path / "served"
    folder.mkdir()
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield folder, f"http://127.0.0.1:{server.server_port}/index.json"
    server.shutdown()
    server.server_close()


def test_an_update_arrives_and_nothing_is_lost(
    zips: tuple[Path, Path], served: tuple[Path, str], tmp_path: Path
) -> None:
    """Settings, a stroke's and a material's choices, and the ID properties that hold bakes and learned materials."""
    folder, address = served
    later = tmp_path / "later"
    build_repository.publish_zips([zips[0]], folder)
    build_repository.publish_zips([zips[1]], later)
    code = """
        import importlib, json, shutil, sys, tomllib, pathlib
        import bpy
        address, folder, later = sys.argv[1:]
        preferences = bpy.context.preferences
        preferences.system.use_online_access = True
        repo = preferences.extensions.repos.new(name='Touch', module='touch', remote_url=address)
        index = list(preferences.extensions.repos).index(repo)
        installed = pathlib.Path(repo.directory) / 'hnf'

        def version():
            manifest = tomllib.loads((installed / 'blender_manifest.toml').read_text())
            module = sys.modules.get('bl_ext.touch.hnf')
            return manifest['version'], module is not None and hasattr(bpy.types.Object, 'hnf_stroke')

        def stored():
            curve, wood = bpy.data.objects['Along'], bpy.data.materials['Wood']
            settings = preferences.addons['bl_ext.touch.hnf'].preferences
            return [settings.output, curve.hnf_stroke.seed, wood.hnf_touch.library, curve['bake'], wood['learned']]

        print(bpy.ops.extensions.repo_sync(repo_index=index))
        print(bpy.ops.extensions.package_install(repo_index=index, pkg_id='hnf'))
        before = version()
        preferences.addons['bl_ext.touch.hnf'].preferences.output = 'virtual'
        curve = bpy.data.objects.new('Along', bpy.data.curves.new('Along', 'CURVE'))
        wood = bpy.data.materials.new('Wood')
        curve.hnf_stroke.seed, wood.hnf_touch.library = 7, 'oak-wood'
        curve['bake'], wood['learned'] = 'baked', 'taught'
        bpy.ops.extensions.repo_sync(repo_index=index)
        bpy.ops.extensions.package_upgrade_all()
        same = version()
        shutil.copytree(later, folder, dirs_exist_ok=True)
        bpy.ops.extensions.repo_sync(repo_index=index)
        bpy.ops.extensions.package_upgrade_all()
        print('RESULT', json.dumps([before, same, version(), stored()]))
    """
    run = run_python(tmp_path, textwrap.dedent(code), address, str(folder), str(later), timeout=120)
    assert run.returncode == 0, run.stdout + run.stderr
    now = [build_extension.read_project_version(), True]
    stored = ["virtual", 7, "oak-wood", "baked", "taught"]
    assert result_of(run) == [now, now, [NEXT, True], stored], run.stdout + run.stderr
    assert "Traceback" not in run.stdout + run.stderr


def test_the_page_offers_each_zip_to_drag(zips: tuple[Path, Path], tmp_path: Path) -> None:
    index = build_repository.publish_zips([zips[0]], tmp_path)
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    (entry,) = index["data"]
    (link,) = re.findall(r'href="([^"]*\.zip[^"]*)"', page)
    assert link.startswith(entry["archive_url"])
    assert "repository=" in link
    assert "platforms=linux-x64" in link
    assert "${" not in page
    assert entry["archive_size"] == zips[0].stat().st_size
    assert entry["python_versions"] == [TARGET.python]


def test_publishing_leaves_no_older_zip(zips: tuple[Path, Path], tmp_path: Path) -> None:
    build_repository.publish_zips([zips[0]], tmp_path)
    index = build_repository.publish_zips([zips[1]], tmp_path)
    assert [path.name for path in tmp_path.glob("*.zip")] == [zips[1].name]
    assert [entry["version"] for entry in index["data"]] == [NEXT]
    assert json.loads((tmp_path / "index.json").read_text()) == index


def test_two_zips_for_the_same_blender_are_refused(zips: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(build_extension.BuildError, match="duplicate"):
        build_repository.publish_zips(list(zips), tmp_path)
