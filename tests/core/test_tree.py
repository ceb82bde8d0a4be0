"""The house keeps its shape: who may import whom, what is never used, and how large a file may grow.

Every rule is a function from one file's syntax tree to the lines that break it; each is first shown to catch a breach.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import pytest
from build_extension import rewrite_imports
from syntax_trees import drop_trees, parse, python_files, read, walk

ROOT = Path(__file__).resolve().parents[2]
CORE, BRIDGE = ROOT / "hnf_core", ROOT / "hnf_blender"
LINE_LIMIT = 800

# docs/architecture.md: a package may import from lower layers only, not from packages of its own layer.
LAYERS = (
    ("errors", "text", "progress", "child_process"),
    ("units", "files", "signal", "threads"),
    ("kernel",),
    ("json_io", "safetensors_io", "tables"),
    ("scene", "metrics"),
    ("tactile",),
    ("action", "material"),
    ("field",),
    ("simulation",),
    ("datasets",),
    ("training",),
    ("export",),
    ("actuators",),
    ("batch", "diagnostics", "study", "touch_request"),
    ("api", "cli"),
)
LAYER_OF = {package: layer for layer, packages in enumerate(LAYERS) for package in packages}

BLENDER_MODULES = {"bpy", "bpy_extras", "bmesh", "mathutils", "gpu", "addon_utils", "hnf_blender"}
TRAINING_MODULES = {"torch", "scipy", "torchvision"}
LABORATORY_MODULES = {"hnf_lab", "data_tools", "reference", "tests"}
UNSAFE_MODULES = {"pickle", "cPickle", "dill", "joblib", "marshal", "shelve", "cloudpickle"}
UNSAFE_CALLS = {"eval", "exec"}

Rule = Callable[[Path, ast.Module], list[str]]


@pytest.fixture(autouse=True, scope="module")
def last_to_parse() -> Iterator[None]:
    """The tests of names and of circles, which come before, share these trees."""
    yield
    drop_trees()


def absolute_imports(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, top-level module) of every absolute import, at module level or inside a function."""
    for node in walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name.partition(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.lineno, (node.module or "").partition(".")[0]


def rooms_used(path: Path, tree: ast.Module) -> Iterator[tuple[int, str]]:
    """(line, package) of every relative import in a file of hnf_core."""
    here = path.relative_to(CORE).with_suffix("").parts
    for node in walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level > 0:
            base = here[: len(here) - node.level]
            names = [node.module] if node.module else [alias.name for alias in node.names]
            yield from ((node.lineno, (*base, *name.split("."))[0]) for name in names)


def knows_blender(path: Path, tree: ast.Module) -> list[str]:
    return [f"line {line}: {name}" for line, name in absolute_imports(tree) if name in BLENDER_MODULES]


def uses_training_modules_elsewhere(path: Path, tree: ast.Module) -> list[str]:
    if path.is_relative_to(CORE / "training"):
        return []
    return [f"line {line}: {name}" for line, name in absolute_imports(tree) if name in TRAINING_MODULES]


def uses_the_laboratory(path: Path, tree: ast.Module) -> list[str]:
    return [f"line {line}: {name}" for line, name in absolute_imports(tree) if name in LABORATORY_MODULES]


def imports_itself_absolutely(path: Path, tree: ast.Module) -> list[str]:
    return [f"line {line}: {name}" for line, name in absolute_imports(tree) if name == "hnf_core"]


def imports_a_higher_layer(path: Path, tree: ast.Module) -> list[str]:
    package = path.relative_to(CORE).with_suffix("").parts[0]
    if package == "__init__":  # the front door: it loads names when they are used, and nothing when it is imported
        imported_at_once = ast.Module([node for node in tree.body if isinstance(node, ast.ImportFrom)], [])
        return [f"line {line}: {used}" for line, used in rooms_used(path, imported_at_once)]
    return [
        f"line {line}: {package} uses {used}"
        for line, used in rooms_used(path, tree)
        if used not in (package, "__version__") and LAYER_OF.get(used, len(LAYERS)) >= LAYER_OF.get(package, -1)
    ]


def is_unsafe(path: Path, tree: ast.Module) -> list[str]:
    found = [f"line {line}: {name}" for line, name in absolute_imports(tree) if name in UNSAFE_MODULES]
    for node in walk(tree):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name) and node.func.id in UNSAFE_CALLS:
            found.append(f"line {node.lineno}: {node.func.id}()")
        if isinstance(node.func, ast.Attribute) and node.func.attr == "load" and ast.unparse(node.func) == "torch.load":
            found.append(f"line {node.lineno}: torch.load unpickles; use safetensors")
        found += [
            f"line {node.lineno}: allow_pickle"
            for word in node.keywords
            if word.arg == "allow_pickle" and not (isinstance(word.value, ast.Constant) and word.value.value is False)
        ]
    return found


def asks_for_the_version(path: Path, tree: ast.Module) -> list[str]:
    if path == BRIDGE / "compat.py":
        return []
    return [
        f"line {node.lineno}: {ast.unparse(node)}"
        for node in walk(tree)
        if isinstance(node, ast.Attribute) and ast.unparse(node).startswith("bpy.app.version")
    ]


def is_called_back_by_a_property(path: Path, tree: ast.Module) -> list[str]:
    """Such a callback hangs bpy 4.5 and crashes 4.2 when the process ends, whatever it does."""
    calls = [node for node in walk(tree) if isinstance(node, ast.Call)]
    return [
        f"line {call.lineno}: {word.arg}="
        for call in calls
        if ast.unparse(call.func).startswith("bpy.props.")
        for word in call.keywords
        if word.arg in {"update", "poll", "get", "set", "search"}
    ]


def names_what_the_addon_lacks(path: Path, tree: ast.Module) -> list[str]:
    """Window tests take modules by their text, ours("ui.tab").name: else only the window fails."""
    found, modules = [], {}
    for node in walk(tree):
        if isinstance(node, ast.Assign) and (name := taken_module(node.value)):
            modules[ast.unparse(node.targets[0])] = name
    for node in walk(tree):
        if (name := taken_module(node)) and module_file(name) is None:
            found.append(f"line {node.lineno}: {name}")
        if isinstance(node, ast.Attribute):
            name = taken_module(node.value) or modules.get(ast.unparse(node.value), "")
            if name and (file := module_file(name)) is not None and not defines(file, node.attr):
                found.append(f"line {node.lineno}: {name}.{node.attr}")
    return found


def taken_module(node: ast.AST) -> str:
    """The name in ours("name"), "" of anything else."""
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "ours" and isinstance(node.args[0], ast.Constant):
        return str(node.args[0].value)
    return ""


def module_file(name: str) -> Path | None:
    parts = name.split(".")
    place = (ROOT if parts[0] == "hnf_core" else BRIDGE).joinpath(*parts)
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)


def defines(file: Path, name: str) -> bool:
    """True where a module has this name: defined, assigned or imported anywhere at its top, or a module of its own."""
    if (file.parent / f"{name}.py").is_file() and file.name == "__init__.py":
        return True
    for node in parse(read(file)).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == name:
            return True
        if isinstance(node, ast.Import | ast.ImportFrom) and name in {each.asname or each.name for each in node.names}:
            return True
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            if name in {part.id for target in targets for part in ast.walk(target) if isinstance(part, ast.Name)}:
                return True
    return False


def imports_what_is_not_there(path: Path, tree: ast.Module) -> list[str]:
    """Imports inside of functions fail only where they run: a move would be noticed minutes later."""
    found = []
    for node in walk(tree):
        if not isinstance(node, ast.ImportFrom) or node.level or not node.module or node.module == "hnf_core":
            continue
        top = node.module.partition(".")[0]
        if top not in OWN_ROOTS:
            continue
        file = own_module(node.module)
        there = set() if file is None else names_in(file)
        found += [
            f"line {node.lineno}: {node.module}.{each.name}"
            for each in node.names
            if each.name not in there and own_module(f"{node.module}.{each.name}") is None
        ]
    return found


OWN_ROOTS = {"hnf_core": ROOT, "hnf_blender": ROOT, "hnf_lab": ROOT / "tools"}


def own_module(name: str) -> Path | None:
    place = OWN_ROOTS[name.partition(".")[0]].joinpath(*name.split("."))
    return next((file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()), None)


@lru_cache
def names_in(file: Path) -> set[str]:
    """All names that a module binds, wherever it does."""
    names: set[str] = set()
    for node in walk(parse(read(file))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {each.asname or each.name for each in node.names}
    return names


def breaches(rule: Rule, *folders: Path) -> list[str]:
    return [
        f"{path.relative_to(ROOT)} {found}"
        for path in python_files(*folders)
        for found in rule(path, parse(read(path)))
    ]


@pytest.mark.parametrize(
    ("rule", "folders"),
    [
        (knows_blender, (CORE,)),
        (uses_training_modules_elsewhere, (CORE, BRIDGE)),
        (uses_the_laboratory, (CORE, BRIDGE)),
        (imports_itself_absolutely, (CORE,)),
        (imports_a_higher_layer, (CORE,)),
        (is_unsafe, (CORE, BRIDGE, ROOT / "tools", ROOT / "tests")),
        (asks_for_the_version, (BRIDGE,)),
        (is_called_back_by_a_property, (BRIDGE,)),
        (names_what_the_addon_lacks, (ROOT / "tests" / "app",)),
        (imports_what_is_not_there, (ROOT / "tests", ROOT / "tools", ROOT / "examples")),
    ],
)
def test_no_file_breaks_the_rule(rule: Rule, folders: tuple[Path, ...]) -> None:
    assert python_files(*folders)
    assert breaches(rule, *folders) == []


@pytest.mark.parametrize(
    ("rule", "where", "source"),
    [
        (knows_blender, "scene/x.py", "def f():\n    import bpy.types"),
        (knows_blender, "scene/x.py", "from mathutils import Vector"),
        (uses_training_modules_elsewhere, "field/x.py", "def f():\n    from scipy.signal import lfilter"),
        (uses_the_laboratory, "cli/x.py", "def f():\n    from hnf_lab.cli import bench"),
        (uses_the_laboratory, "scene/x.py", "from data_tools.write_splats import write_inria"),
        (uses_the_laboratory, "scene/x.py", "import reference.geometry"),
        (imports_itself_absolutely, "field/x.py", "from hnf_core.units import G"),
        (imports_a_higher_layer, "scene/x.py", "from ..tactile.tactile_map import TactileMap"),
        (imports_a_higher_layer, "scene/x.py", "from .. import cli"),
        (imports_a_higher_layer, "action/x.py", "from ..material import token"),
        (imports_a_higher_layer, "errors.py", "from .files import write_text"),
        (imports_a_higher_layer, "__init__.py", "from .api import touch"),
        (is_unsafe, "files.py", "import pickle"),
        (is_unsafe, "files.py", "value = eval('1')"),
        (is_unsafe, "files.py", "np.load('x', allow_pickle=True)"),
        (is_unsafe, "training/x.py", "torch.load('x')"),
        (is_unsafe, "training/x.py", "torch.load('x', weights_only=True)"),
        (asks_for_the_version, "x.py", "if bpy.app.version >= (5, 0, 0): pass"),
        (is_called_back_by_a_property, "x.py", "class X:\n    on: bpy.props.BoolProperty(update=told)"),
        (names_what_the_addon_lacks, "x.py", 'ours("bridge.scene.stored_data").get_artist_choice(1)'),
        (names_what_the_addon_lacks, "x.py", 'state = ours("compat")\nstate.no_such_name'),
        (names_what_the_addon_lacks, "x.py", 'ours("bridge.no_such_module")'),
        (imports_what_is_not_there, "x.py", "def f():\n    from hnf_blender.ops import no_such_module"),
        (imports_what_is_not_there, "x.py", "from hnf_core.units import no_such_name"),
        (imports_what_is_not_there, "x.py", "from hnf_lab.no_such_package.x import y"),
    ],
)
def test_the_rule_catches_a_breach(rule: Rule, where: str, source: str) -> None:
    assert rule(CORE / where, ast.parse(source)) != []


def test_every_room_stands_on_a_floor() -> None:
    packages = {path.relative_to(CORE).with_suffix("").parts[0] for path in python_files(CORE)} - {"__init__"}
    assert packages <= set(LAYER_OF)


def test_bridge_imports_can_move_into_the_extension() -> None:
    files = python_files(BRIDGE)
    assert files
    for path in files:
        level = len(path.relative_to(BRIDGE).parts)
        rewrite_imports(read(path), level, str(path.relative_to(ROOT)))


def test_every_folder_with_code_is_a_package() -> None:
    folders = {path.parent for path in python_files(CORE, BRIDGE)}
    assert [str(folder) for folder in sorted(folders) if not (folder / "__init__.py").is_file()] == []


def test_no_file_is_too_long() -> None:
    files = python_files(CORE, BRIDGE, ROOT / "tools", ROOT / "tests")
    long = {str(path.relative_to(ROOT)): len(read(path).splitlines()) for path in files}
    assert {name: lines for name, lines in long.items() if lines > LINE_LIMIT} == {}


def test_importing_the_core_loads_numpy_and_nothing_heavier() -> None:
    """In a fresh process: every module of hnf_core but training, then a look at what has been loaded."""
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in python_files(CORE)
        if not path.is_relative_to(CORE / "training")
    ]
    heavy = ["bpy", "torch", "scipy", "matplotlib", "OpenEXR", "embreex", "safetensors", "dask", "distributed"]
    code = (
        "import importlib, sys\n"
        f"for name in {modules!r}: importlib.import_module(name)\n"
        f"print(sorted(set({heavy!r}) & set(sys.modules)), 'numpy' in sys.modules)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "[] True"
