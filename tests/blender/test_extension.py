"""The add-on as a user gets it: built, validated, installed into an empty profile, and used for its main job.

Blender runs in a process of its own for each step, because an installed extension stays in a process for good.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import textwrap
import tomllib
import zipfile
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import build_extension
import pytest

from hnf_core.field.weights import DEFAULT_WEIGHTS, EVERY_ENCODER_WEIGHTS, HELD_OUT_WEIGHTS, load_field, read_encoders
from hnf_core.material.alexnet_encoder import DEFAULT_ENCODER
from hnf_core.material.encoder_registry import PREFERRED_ENCODERS, get_default_encoder
from hnf_core.material.token import ALEXNET_ID, ENCODER_ID
from hnf_core.tactile.unet import DEFAULT_WEIGHTS as DEFAULT_MAP_WEIGHTS

PACKAGE = "bl_ext.user_default.hnf"
PYTHON = f"{sys.version_info.major}.{sys.version_info.minor}"
MEGABYTE = 1_000_000

# What an installed add-on must never load: training's modules, and itself by another name.
FOREIGN = ("torch", "scipy", "hnf_core", "hnf_blender")

# What switching it on must not load: Blender starts with it every day, and touches on some.
LATER = ("matplotlib", "OpenEXR", "embreex", "safetensors", "PIL", "serial", "sounddevice", "pythonosc")
OWN_LATER = tuple(
    f"{PACKAGE}.hnf_core.{name}"
    for name in ("material.library", "material.token", "actuators.limits", "actuators.response", "field")
)
"""Of ours: the panels name materials and actuators before anybody asks what they are."""
TIMES = 50

# As `blender -b` starts: preferences read, their add-ons on. The 4.2 module crashes in read_userpref, on any profile;
# there the extension is switched on by hand.
START = f"""
import bpy, sys  # first: it puts Blender's modules on the path
import addon_utils
if bpy.app.version >= (4, 5, 0):
    bpy.ops.wm.read_userpref()
else:
    addon_utils.extensions_refresh()
    addon_utils.enable('{PACKAGE}', default_set=True)
"""


@dataclass(frozen=True)
class Profile:
    """A clean Blender profile with the extension installed."""

    folder: Path
    install_log: str

    def run(self, code: str, *arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
        """Run code in a Blender started afresh on this profile, the extension switched on."""
        return run_python(self.folder, START + textwrap.dedent(code), *arguments, timeout=timeout)


def run_python(profile: Path, code: str, *arguments: str, timeout: float) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("BLENDER_", "PYTHON"))}
    environment |= {"BLENDER_USER_RESOURCES": str(profile), "HOME": str(profile), "PYTHONUNBUFFERED": "1"}
    environment["no_proxy"] = "127.0.0.1"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=profile,
        env=environment,
        capture_output=True,
        text=True,
        timeout=timeout,
        stdin=subprocess.DEVNULL,
    )


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("extension")
    target = build_extension.Target(PYTHON, "linux-x64")
    return build_extension.build(target, folder / "dist", folder / "staging")


@pytest.fixture(scope="module")
def profile(archive: Path, tmp_path_factory: pytest.TempPathFactory) -> Profile:
    folder = tmp_path_factory.mktemp("profile")
    code = """
        import sys, bpy
        print(bpy.ops.extensions.package_install_files(
            filepath=sys.argv[1], repo='user_default', enable_on_install=True, overwrite=True))
        bpy.ops.wm.save_userpref()
    """
    run = run_python(folder, textwrap.dedent(code), str(archive), timeout=240)
    log = run.stdout + run.stderr
    assert run.returncode == 0, log
    assert "FINISHED" in run.stdout, log
    return Profile(folder, log)


def test_blenders_own_validator_accepts_the_zip(archive: Path) -> None:
    assert "Success" in build_extension.run_blender_tool("validate", str(archive))


def test_the_validator_can_refuse(archive: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(archive) as zipped:
        manifest = zipped.read("blender_manifest.toml").decode()
    (tmp_path / "__init__.py").touch()
    (tmp_path / "blender_manifest.toml").write_text(re.sub(r'tagline = "[^"]*"', f'tagline = "{"x" * 80}"', manifest))
    with pytest.raises(build_extension.BuildError, match="tagline"):
        build_extension.run_blender_tool("validate", str(tmp_path))


def test_the_zip_holds_only_code_data_licence_and_wheels(archive: Path) -> None:
    with zipfile.ZipFile(archive) as zipped:
        names = set(zipped.namelist())
    assert {"__init__.py", "blender_manifest.toml", "LICENSE", "hnf_core/__init__.py"} <= names
    assert {Path(name).suffix for name in names if name.startswith("wheels/")} == {".whl"}
    assert not [name for name in names if "__pycache__" in name or name.startswith(("hnf_blender/", "tests/"))]
    assert not [name for name in names if {"hnf_lab", "bench", "tools", "batch", "study"} & set(Path(name).parts)]
    paths = [path for path in (build_extension.ROOT / "hnf_core" / "data").rglob("*") if path.is_file()]
    data = {str(path.relative_to(build_extension.ROOT)) for path in paths}
    assert any(path.suffix == ".toml" for path in paths)
    assert data >= build_extension.OMITTED_FILES
    assert data & names == data - build_extension.OMITTED_FILES
    assert archive.stat().st_size < 51 * MEGABYTE  # 5 MB of them the diffusion


def test_no_route_needs_what_the_zip_leaves_out() -> None:
    """E's network has to go into the zip together with the first field that knows its tokens."""
    left_out = {build_extension.ROOT / name for name in build_extension.OMITTED_FILES}
    assert {DEFAULT_ENCODER, EVERY_ENCODER_WEIGHTS, HELD_OUT_WEIGHTS} == left_out
    assert left_out.isdisjoint({DEFAULT_WEIGHTS, DEFAULT_MAP_WEIGHTS})
    known = read_encoders(load_field().metadata)
    assert {get_default_encoder(route, known).name for route in PREFERRED_ENCODERS} == {ENCODER_ID}


def test_asked_for_what_the_zip_leaves_out_it_says_what_to_do(profile: Profile) -> None:
    code = f"""
        import importlib, json
        ours = lambda name: importlib.import_module('{PACKAGE}.' + name)
        seeing, family = ours('touch.bake_patches').ReliefPredictor, ours('hnf_core.errors')
        try:
            seeing('{ALEXNET_ID}')
        except family.HnfError as error:
            said = [type(error).__name__, str(error)]
        usual = seeing()
        print('RESULT', json.dumps([said, usual.measured_encoder.name, usual.predicted_encoder.name,
        usual.missing_reason]))
    """
    run = profile.run(code)
    assert run.returncode == 0, run.stdout + run.stderr
    (kind, message), *usual = result_of(run)
    assert kind == "MaterialError"
    assert ALEXNET_ID in message
    assert f"Choose {ENCODER_ID}" in message
    assert usual == [ENCODER_ID, ENCODER_ID, ""]


def test_no_wheel_brings_numpy_torch_or_scipy(archive: Path) -> None:
    with zipfile.ZipFile(archive) as zipped:
        wheels = [Path(name).name.lower() for name in zipped.namelist() if name.startswith("wheels/")]
    assert wheels
    assert not [name for name in wheels if name.startswith(("numpy-", "torch", "scipy"))]


def test_it_installs_and_enables_without_a_complaint(profile: Profile) -> None:
    for word in ("Traceback", "Error", "Warning: ", "WARNING"):
        assert word not in profile.install_log, profile.install_log


def test_enabled_it_loads_nothing_foreign(profile: Profile) -> None:
    code = f"""
        import json
        print('RESULT', json.dumps({{
            'enabled': '{PACKAGE}' in bpy.context.preferences.addons,
            'loaded': '{PACKAGE}' in sys.modules,
            'foreign': [name for name in {(*FOREIGN, *LATER, *OWN_LATER)!r} if name in sys.modules],
        }}))
    """
    run = profile.run(code)
    assert run.returncode == 0, run.stderr
    assert result_of(run) == {"enabled": True, "loaded": True, "foreign": []}
    assert "Traceback" not in run.stdout + run.stderr


def test_its_wheels_are_unpacked_into_the_profile_and_work(profile: Profile) -> None:
    """Blender puts them before other packages on the path, so these are the wheels' own files beside its numpy."""
    code = """
        import importlib, json, OpenEXR, embreex.rtcore_scene, matplotlib, numpy, safetensors.numpy
        import _cffi_backend, pythonosc.udp_client, serial.tools.list_ports
        matplotlib.use('Agg')
        import matplotlib.pyplot as plt
        plt.figure().add_subplot().plot([0, 1], [0, 1])
        plt.savefig('figure.png')
        saved = safetensors.numpy.save({'a': numpy.ones(3, numpy.float32)})
        assert safetensors.numpy.load(saved)['a'].tolist() == [1.0, 1.0, 1.0]
        OpenEXR.File({}, {'Y': numpy.ones((4, 4), numpy.float32)}).write('image.exr')
        scene = embreex.rtcore_scene.EmbreeScene()
        modules = [OpenEXR, embreex, matplotlib, safetensors, serial, pythonosc, _cffi_backend]
        assert importlib.import_module(sys.argv[1] + '.hnf_core.kernel.loader').why_unavailable() == sys.argv[2]
        modules += [] if sys.argv[2] else [sys.modules['hnf_kernel']]
        print('RESULT', json.dumps({'files': [module.__file__ for module in modules]}))
    """
    run = profile.run(code, PACKAGE, "" if find_spec("ziglang") else "not installed")
    assert run.returncode == 0, run.stdout + run.stderr
    files = result_of(run)["files"]
    assert isinstance(files, list)
    assert [name for name in files if not name.startswith(str(profile.folder / "extensions" / ".local"))] == []


def test_an_actuator_is_driven_from_the_installed_extension(profile: Profile) -> None:
    """Its process finds the inside of the zip, where hnf_core is no package of its own."""
    code = f"""
        import importlib, json, time
        import numpy as np
        ours = lambda name: importlib.import_module('{PACKAGE}.' + name)
        ours('actuator.actuator_state').ACTUATOR.selected = 'virtual'
        settings = ours('state.addon_settings').get_settings()
        if hasattr(settings, 'bl_rna'):
            settings.output = 'virtual'
        link = ours('actuator.player_client').PLAYER_CLIENT
        finder = ours('actuator.player_process').DEVICE_SCANNER
        finder.start()
        tone = (2.0 * np.sin(np.arange(3000) * 0.1)).astype(np.float32)
        link.play(ours('actuator.sound').Sound(tone, 10000.0, ours('hnf_core.actuators.profile').GENERIC))
        end = time.monotonic() + 40.0
        while (link.is_playing or ours('actuator.actuator_state').ACTUATOR.is_scanning) and time.monotonic() < end:
            link.tick(); finder.tick(); time.sleep(0.01)
        heard, state = link.current_status, ours('actuator.actuator_state').ACTUATOR
        link.release()
        print('RESULT', json.dumps({{
            'problem': link.problem, 'peak': heard.status.peak if heard else 0.0, 'looked': state.is_scanned,
            'missing': [name for name in ('pyserial', 'python-osc') if name in state.missing_packages],
            'foreign': 'hnf_core' in sys.modules,
        }}))
    """
    run = profile.run(code)
    assert run.returncode == 0, run.stdout + run.stderr
    told = result_of(run)
    assert told.pop("peak") == pytest.approx(2.0 / 30.0, rel=0.1)
    assert told == {"problem": "", "looked": True, "missing": [], "foreign": False}


def test_training_code_in_the_zip_runs_without_blender(profile: Profile) -> None:
    """As far as the material's name, which training comes after: with no other hnf_core in reach, and no bpy."""
    inside = next(profile.folder.glob("extensions/user_default/hnf"))
    lesson = {"kind": "simulated", "folder": "", "material": "unobtainium", "seconds": 5.0, "epochs": 1}
    site = next(entry for entry in sys.path if entry.endswith("site-packages"))
    guard = f"import sys; sys.path.append({site!r}); sys.modules['bpy'] = None; import runpy; sys.argv.pop(0); "
    worker, core = str(inside / "jobs" / "worker.py"), str(inside / "hnf_core")
    words = [worker, core, "learn", json.dumps(lesson), "out.safetensors"]
    start = f"{guard}runpy.run_path(sys.argv[0], run_name='__main__')"
    with subprocess.Popen(
        [sys.executable, "-S", "-I", "-c", start, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        cwd=profile.folder,
    ) as child:  # fmt: skip
        assert child.stdout is not None
        said = child.stdout.read().decode()
    assert child.returncode == 1, said
    assert "@hnf Failed" in said
    assert "unobtainium" in said


def test_enabling_and_disabling_fifty_times_leaves_no_traces(profile: Profile) -> None:
    """Counted in Blender itself: classes, properties, handlers, keymap items, menu entries, threads."""
    code = f"""
        import addon_utils, json, threading

        def traces():
            keymaps = bpy.context.window_manager.keyconfigs.addon
            return {{
                'classes': sorted(name for name in dir(bpy.types) if 'hnf' in name.lower()),
                'subclasses': sum('hnf' in each.__name__.lower() for kind in
                    (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup) for each in kind.__subclasses__()
                    if getattr(each, 'is_registered', False)),
                'properties': [f'{{kind}}.{{name}}' for kind in ('Object', 'Scene', 'Material', 'Mesh', 'WindowManager')
                    for name in dir(getattr(bpy.types, kind)) if 'hnf' in name.lower()],
                'handlers': [f'{{name}}: {{each!r}}'[:60] for name in dir(bpy.app.handlers)
                    if isinstance(getattr(bpy.app.handlers, name), list)
                    for each in getattr(bpy.app.handlers, name) if 'hnf' in getattr(each, '__module__', '')],
                'keys': [item.idname for keymap in (keymaps.keymaps if keymaps else ()) for item in keymap.keymap_items
                    if 'hnf' in item.idname],
                'menus': sum(any('hnf' in getattr(each, '__module__', '') for each in kind.draw._draw_funcs)
                    for kind in bpy.types.Menu.__subclasses__() if hasattr(getattr(kind, 'draw', None), '_draw_funcs')),
                'threads': threading.active_count(),
            }}

        on = traces()
        addon_utils.disable('{PACKAGE}')
        off = traces()
        for _ in range({TIMES}):
            addon_utils.enable('{PACKAGE}')
            again = traces()
            addon_utils.disable('{PACKAGE}')
        print('RESULT', json.dumps([on, off, again, traces()]))
    """
    run = profile.run(code)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "Traceback" not in run.stdout + run.stderr
    on, off, again, last = result_of(run)
    assert "HNF_OT_import_material" in on["classes"]
    assert "Object.hnf_stroke" in on["properties"]
    assert (again, last) == (on, off)
    threads = on["threads"]
    assert off == {name: threads if name == "threads" else type(value)() for name, value in on.items()}


def test_blender_takes_the_dropped_zip_for_an_extension(profile: Profile, archive: Path) -> None:
    """A drop opens a dialog, which needs a window; what it decides before and does after does not."""
    code = """
        import json
        from bl_pkg.bl_extension_utils import pkg_is_legacy_addon, pkg_manifest_dict_from_archive_or_error
        manifest = pkg_manifest_dict_from_archive_or_error(sys.argv[1])
        print('RESULT', json.dumps([pkg_is_legacy_addon(sys.argv[1]), manifest['id'], manifest['type']]))
    """
    assert result_of(profile.run(code, str(archive))) == [False, "hnf", "add-on"]


def test_it_asks_for_the_permissions_it_needs_and_no_other(archive: Path) -> None:
    with zipfile.ZipFile(archive) as zipped:
        manifest = tomllib.loads(zipped.read("blender_manifest.toml").decode())
        code = "".join(zipped.read(name).decode() for name in zipped.namelist() if name.endswith(".py"))
    needed = {"files"} | ({"clipboard"} if ".clipboard" in code else set()) | ({"network"} if "osc" in code else set())
    assert set(manifest["permissions"]) == needed
    assert not re.search(r"^\s*(?:import|from) (?:urllib.request|http|requests|ssl)\b", code, re.MULTILINE)  # "network"


def test_its_assets_come_along(archive: Path) -> None:
    with zipfile.ZipFile(archive) as zipped:
        sizes = {
            Path(entry.filename).name: entry.file_size for entry in zipped.infolist() if "assets/" in entry.filename
        }
    assert {"touch_materials.blend", "touch_strokes.blend", "blender_assets.cats.txt"} <= sizes.keys()
    assert sum(sizes.values()) < MEGABYTE


def test_the_main_job_runs_through_the_installed_addon(profile: Profile, tmp_path: Path) -> None:
    scene, out = tmp_path / "plane.blend", tmp_path / "out"
    write_scene(profile, scene)
    code = f"""
        import importlib, json
        cli = importlib.import_module('{PACKAGE}.cli')
        code = cli.main(['touch', sys.argv[1], '--out', sys.argv[2], '--stroke', 'left-right-soft', '--on', 'Plane'])
        print('RESULT', json.dumps({{
            'code': code, 'foreign': [name for name in {FOREIGN!r} if name in sys.modules]}}))
    """
    run = profile.run(code, str(scene), str(out), timeout=280)
    assert run.returncode == 0, run.stdout + run.stderr
    result = result_of(run)
    assert (result["code"], result["foreign"]) == (0, []), run.stdout + run.stderr
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["failed"] == []
    (stroke,) = report["strokes"]
    assert (out / stroke["wav"]).stat().st_size > 1000
    assert 0.0 < stroke["rms_m_s2"] < 100.0


@pytest.mark.parametrize(
    ("arguments", "code"),
    [(["touch", "no-such-scene.blend", "--out", "out"], 1), (["touch", "x.blend"], 2), (["no-such-verb"], 2)],
)
def test_exit_codes_of_the_installed_command_line(profile: Profile, arguments: list[str], code: int) -> None:
    script = f"""
        import importlib
        sys.exit(importlib.import_module('{PACKAGE}.cli').main({arguments!r}))
    """
    run = profile.run(script)
    assert run.returncode == code, run.stdout + run.stderr
    assert "Traceback" not in run.stderr


def write_scene(profile: Profile, path: Path) -> None:
    """A 100 mm square with a sine bump of 2 mm, facing up."""
    code = """
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.ops.mesh.primitive_plane_add(size=0.1)
        material = bpy.data.materials.new('Ribs')
        material.use_nodes = True
        nodes, links = material.node_tree.nodes, material.node_tree.links
        wave, bump = nodes.new('ShaderNodeTexWave'), nodes.new('ShaderNodeBump')
        wave.inputs['Scale'].default_value = 20.0
        bump.inputs['Distance'].default_value = 1e-4
        shader = next(node for node in nodes if node.type == 'BSDF_PRINCIPLED')
        links.new(wave.outputs['Fac'], bump.inputs['Height'])
        links.new(bump.outputs['Normal'], shader.inputs['Normal'])
        bpy.context.object.data.materials.append(material)
        bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
    """
    run = profile.run(code, str(path))
    assert path.is_file(), run.stdout + run.stderr


def result_of(run: subprocess.CompletedProcess[str]) -> Any:
    """The JSON after the word RESULT."""
    lines = [line for line in run.stdout.splitlines() if line.startswith("RESULT ")]
    assert len(lines) == 1, run.stdout + run.stderr
    return json.loads(lines[0].removeprefix("RESULT "))
