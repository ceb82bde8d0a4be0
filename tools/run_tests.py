"""Run every check in its environment, two at a time, and end with one merged summary in pytest's own form.

    .venv/bin/python tools/run_tests.py             lint, types, core on numpy 1.26, 1.24 and (parts) 2.5, and
                                                    tests/blender on bpy 5.2, 5.0, 4.5 and 4.2
    .venv/bin/python tools/run_tests.py app         the real, windowed Blender
    .venv/bin/python tools/run_tests.py core types  some of them by name

Each check runs in a process group of its own with a time limit, writes build/test/NAME.log and NAME.xml, and is printed
when it ends, so that logs of parallel checks never mix. The exit code is 0 only when everything passed.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

import merge_summary
import setup_env
from merge_summary import Case

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "build" / "test"
WORKERS = 2
PRINTED_LINES = 80
RUNNER = re.compile(r"[/\\](_pytest|pytest|pluggy)[/\\]|<frozen|pytest_in_bpy")
STOPPING = threading.Event()
RUNNING: set[subprocess.Popen[bytes]] = set()


@dataclass(frozen=True)
class Check:
    """Check that runs as one process: its environment's folder, the arguments and the time limit [s].

    can_end is False where bpy hangs the process at its exit; see tools/pytest_in_bpy.py. Such a check is run once more
    if a signal ended it: these modules leave their sound device's threads running, and one crashed in a run that passed
    whole before and after. The summary lists the crash and its place among what was skipped; a second is an error.
    """

    name: str
    venv: str
    arguments: tuple[str, ...]
    timeout_s: float
    is_pytest: bool = True
    can_end: bool = True


def exclude_tests(folder: str, *names: str) -> tuple[str, ...]:
    """Return pytest's arguments for a folder without the named test files."""
    return (folder, *(f"--ignore-glob=*/{name}.py" for name in names))


# Messages, other processes and counted work, which do not depend on the version of Blender.
BLENDER_INDEPENDENT = (
    "test_batch_touch", "test_touch_words", "test_jobs_choices", "test_repository", "test_docs_reference",
    "test_example_scene",
)  # fmt: skip
# Long tests of networks, counted work and numbers, for which Blender 5.0 is enough.
MAIN_ONLY = (
    "test_predicted_route", "test_probe_predicted", "test_touch_predicted", "test_jobs_predicted", "test_stress",
    "test_lazy", "test_learn", "test_touch_again", "test_touch_bad_input", "test_touch_certainty",
    "test_touch_own_field", *BLENDER_INDEPENDENT,
)  # fmt: skip
# Long tests on which Blender 4.2 and 5.0 agree; test_jobs runs the main job, and `make test-app` a later Blender still.
NOT_ON_NEWEST = (
    "test_real_scenes", "test_touch", "test_probe", "test_extension", "test_preview_export", "test_cache_truth",
    "test_splats_touch", "test_demo_scene", "test_actuator*", "test_modal_job", "test_namesakes",
    "test_doubtful_relief", "test_placement", *MAIN_ONLY,
)  # fmt: skip
# What calls Blender's API most; the rest of it runs on the versions before and after.
ON_MIDDLE = (
    "test_assets", "test_closeup", "test_closeup_materials", "test_closeup_textures", "test_compat", "test_drop",
    "test_export_ops", "test_handlers", "test_importers", "test_jobs", "test_keys", "test_linked_strokes",
    "test_material_ops", "test_meshes", "test_nerfstudio", "test_overviews", "test_panel_texts", "test_panels",
    "test_preview", "test_preview_pictures", "test_scene_properties", "test_scene_views", "test_splats_closeup",
    "test_splats_cloud", "test_splats_from_scene", "test_splats_ops", "test_stroke_ops", "test_stroke_tool",
    "test_strokes", "test_strokes_in_motion", "test_surface_formats", "test_survival", "test_touchable",
    "test_translations", "test_version_0_1", "test_views",
)  # fmt: skip
# Blender 4.2 imports and touches only the smaller of the two real scenes.
OLDEST_ARGUMENTS = (*exclude_tests("tests/blender", *MAIN_ONLY), "-k", "not FlightHelmet")
# Real time, other processes, compilers, words and messages, which do not depend on the version of numpy.
NUMPY_INDEPENDENT = (
    "test_audio_sink", "test_player", "test_serial_s*", "test_osc_sink", "test_firmware_*", "test_measure_sound",
    "test_stream_cli", "test_make_tools", "test_tree", "test_docs", "test_startup", "test_lazy_rendering",
    "test_nearby_mesh", "test_names", "test_front_door", "test_no_circles", "test_phrasings", "test_release",
)  # fmt: skip
# Numpy 1.24 is that of Blender 4.2, which never trains, simulates, evaluates or studies; its own tests play and stream
# with it.
NOT_USED_IN_BLENDER = (
    "test_live*", "test_limiter", "test_numerics_streaming", "test_stream*", "test_incremental_rendering",
    "test_virtual_*", "test_serial_protocol", "test_fading_queue", "test_extrapolation", "test_train_needs",
)  # fmt: skip
FOLDERS_NOT_USED_IN_BLENDER = ("batch", "datasets", "simulation", "study", "training")
# With bpy 5.2, numpy 2 runs most of the library; these are its numbers by themselves.
NEW_NUMPY_ARGUMENTS = tuple(f"tests/core/{name}" for name in ("kernel", "material", "metrics", "scene", "tactile"))

LABORATORY_TESTS = "tools/hnf_lab/tests"
OLD_NUMPY_ARGUMENTS = (
    *exclude_tests("tests/core", *NUMPY_INDEPENDENT, *NOT_USED_IN_BLENDER),
    *(f"--ignore=tests/core/{folder}" for folder in FOLDERS_NOT_USED_IN_BLENDER),
    *("-k", "not simulator or test_library"),  # fields beside the simulator
)

# The longest first, so that two workers end at about the same time.
CHECKS = (
    Check("lint", ".venv", ("-m", "ruff", "check", "."), 120, is_pytest=False),
    Check("core", ".venv", ("tests/core",), 2400),
    Check("blender-5.0", ".venv", ("tests/blender",), 2400),
    Check("lab", ".venv", (LABORATORY_TESTS, f"--ignore={LABORATORY_TESTS}/blender"), 1800),
    Check("lab-blender", ".venv", (f"{LABORATORY_TESTS}/blender",), 1200),
    Check("blender-4.2", ".venv-4.2", OLDEST_ARGUMENTS, 2400, can_end=False),
    Check("blender-5.2", ".venv-5.2", exclude_tests("tests/blender", *NOT_ON_NEWEST), 2400, can_end=False),
    Check("core-numpy-1.24", ".venv-4.2", OLD_NUMPY_ARGUMENTS, 1800),
    Check("blender-4.5", ".venv-4.5", tuple(f"tests/blender/{name}.py" for name in ON_MIDDLE), 1800, can_end=False),
    Check("core-numpy-2.5", ".venv-5.2", NEW_NUMPY_ARGUMENTS, 600),
    Check("types", ".venv", ("-m", "mypy"), 600, is_pytest=False),
)
APP = Check("app", ".venv", ("tests/app",), 1200)


def build_command(check: Check) -> list[str]:
    """Build the command line of one check."""
    python = str(ROOT / check.venv / "bin" / "python")
    if not check.is_pytest:
        return [python, *check.arguments]
    options = ["-o", f"cache_dir=build/test/cache-{check.name}", f"--basetemp={RESULTS / f'tmp-{check.name}'}"]
    pytest = ["-m", "pytest"] if check.can_end else ["tools/pytest_in_bpy.py"]
    return [python, *pytest, *check.arguments, "-rfE", *options, f"--junitxml={RESULTS / check.name}.xml"]


def run(check: Check) -> tuple[list[Case], str]:
    """Run one check, and a crashed one again where Check says so; returns its cases and its log."""
    cases, log = run_once(check)
    if check.can_end or not cases or not re.match(r"ended with exit code -\d", cases[-1].reason):
        return cases, log
    crash = Case(check.name, "first run", "skipped", cases[-1].reason.partition("; see")[0] + ": run again")
    again, second_log = run_once(check)
    return [crash, *again], f"{log}\n---- run again ----\n{second_log}"


def run_once(check: Check) -> tuple[list[Case], str]:
    """Run one check to its end or its time limit; returns its cases and its log."""
    log_path, xml_path = RESULTS / f"{check.name}.log", RESULTS / f"{check.name}.xml"
    for stale in RESULTS.glob(f"{check.name}*.xml"):
        stale.unlink()
    missing = setup_env.get_reason_path(check.venv)
    if missing.is_file():
        skipped = [Case(check.name, check.name, "skipped", missing.read_text(encoding="utf-8"))]
        merge_summary.write_cases(xml_path, skipped)
        return skipped, f"skipped: {skipped[0].reason}"
    if STOPPING.is_set():
        return [Case(check.name, check.name, "error", "not run: stopped before")], ""
    profile = RESULTS / f"profile-{check.name}"  # so that no test reads or writes a person's own Blender settings
    environment = os.environ | {
        "OMP_NUM_THREADS": "1",
        "PYTHONFAULTHANDLER": "1",
        # The environments come without bytecode: unless it is kept, each process that a test starts compiles torch.
        "PYTHONPYCACHEPREFIX": str(RESULTS / "bytecode"),
        "BLENDER_USER_RESOURCES": str(profile),
    }
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    with log_path.open("wb") as log:
        process = subprocess.Popen(
            build_command(check),
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        RUNNING.add(process)
        try:
            code = process.wait(timeout=check.timeout_s)
            ending = f"ended with exit code {code}"
        except subprocess.TimeoutExpired:
            ending, code = f"was ended after {check.timeout_s:.0f} s", -1
        finally:
            RUNNING.discard(process)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    text = log_path.read_text(encoding="utf-8", errors="replace")
    return collect_cases(check, code, ending + describe_crash(text), xml_path), text


def describe_crash(log: str) -> str:
    """Return where Python's fault handler saw the process crash, as `, Segmentation fault in FILE:LINE NAME < …`.

    The frames are those of the thread that crashed, innermost first, outside of pytest; nothing where none crashed.
    """
    crash = re.search(r"Fatal Python error: (.+)\n(?:.*\n)*?(?:Current t|T)hread .*\n((?: +File .*\n?)*)", log)
    if not crash:
        return ""
    frames = re.findall(r'File "([^"]+)", line (\d+) in (\S+)', crash[2])
    ours = [f"{Path(file).name}:{line} {name}" for file, line, name in frames if not RUNNER.search(file)]
    return f", {crash[1]} in " + (" < ".join(ours[:6]) or "no Python code")


def collect_cases(check: Check, code: int, ending: str, xml_path: Path) -> list[Case]:
    """Collect the cases of one ended check. A bad exit code without a failed test is itself an error."""
    if not check.is_pytest:
        outcome = [Case(check.name, check.name, "passed" if code == 0 else "failed", ending if code else "")]
        merge_summary.write_cases(xml_path, outcome)
        return outcome
    cases = merge_summary.read_cases(xml_path) if xml_path.is_file() else []
    if not cases or (code != 0 and not merge_summary.has_failed(cases)):
        bad_end = [Case(check.name, "pytest", "error", f"{ending}; see build/test/{check.name}.log")]
        merge_summary.write_cases(xml_path.with_name(f"{check.name}-ending.xml"), bad_end)
        cases += bad_end
    return cases


def stop(_number: int, _frame: object) -> None:
    """Kill every running check on a signal, so that none outlives this process; the summary still follows."""
    STOPPING.set()
    for process in list(RUNNING):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def select(names: list[str]) -> list[Check]:
    """Select checks by name, or all but `app` if no name is given. Raises KeyError for an unknown name."""
    known = {check.name: check for check in (*CHECKS, APP)}
    return [known[name] for name in names] if names else list(CHECKS)


def main(names: list[str]) -> int:
    """Run the checks; print each log as it ends, and the merged summary last."""
    try:
        checks = select(names)
    except KeyError as error:
        print(f"No check is called {error}. There are: {', '.join(c.name for c in (*CHECKS, APP))}.", file=sys.stderr)
        return 2
    RESULTS.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    cases: list[Case] = []
    with ThreadPoolExecutor(WORKERS) as pool:
        running = {pool.submit(run, check): check for check in checks}
        for future in as_completed(running):
            check = running[future]
            new_cases, log = future.result()
            cases += new_cases
            lines = log.rstrip().splitlines()
            print(f"\n---- {check.name}, {time.monotonic() - started:.0f} s after the start " + "-" * 60, flush=True)
            if len(lines) > PRINTED_LINES:
                print(f"… {len(lines) - PRINTED_LINES} lines before this in build/test/{check.name}.log")
            print("\n".join(lines[-PRINTED_LINES:]), flush=True)
    files = sorted(path for check in checks for path in RESULTS.glob(f"{check.name}.xml"))
    properties = [line for path in files for line in merge_summary.read_properties(path)]
    print("\n" + merge_summary.format_summary(cases, time.monotonic() - started, properties), flush=True)
    return int(merge_summary.has_failed(cases))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
