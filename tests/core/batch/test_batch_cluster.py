"""`hnf batch` with real workers: a killed worker, a failure, a change, a stop, and a second run."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from batch_builders import at_work, direct, half_written, jobs_file, let_go, pipe, processes_with, synth, table, until
from hatt_files import model_xml

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed: the extra [batch]")

from hnf_core.batch.staging import read_record
from hnf_core.cli.main import main

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Somebody else's cluster of two workers."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=None,
        memory_limit=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    ) as cluster:
        yield cluster.scheduler_address


def batch(*words: object) -> int:
    return main(["batch", *(str(word) for word in words)], lambda _arguments: 1)


def told(capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, float], str]:
    """The counts without their seconds, and what went to stderr."""
    said = capsys.readouterr()
    counts = json.loads(said.out.splitlines()[-1])
    assert counts.pop("seconds") >= 0
    return counts, said.err


def attempts(folder: Path) -> dict[str, tuple[int, int]]:
    """Finished job → attempts its record counts, and the folder's own number, another one where it was made anew."""
    records = {path.name: read_record(path) for path in folder.glob("[!.]*")}
    return {name: (record.attempts, (folder / name).stat().st_ino) for name, record in records.items() if record}


def listening(pid: int) -> set[str]:
    """Addresses that a process and its children accept connections on."""
    import psutil

    found = set()
    for one in [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]:
        with contextlib.suppress(psutil.NoSuchProcess):
            found |= {each.laddr.ip for each in one.net_connections("inet") if each.status == "LISTEN"}
    return found


def test_a_killed_worker_or_a_stop_leaves_no_partial_result(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out, action = tmp_path / "out", table(tmp_path / "a.csv")
    waiting = {name: pipe(tmp_path / f"{name}.pipe") for name in ("killed", "stopped")}
    quick = {f"quick-{seed}": synth(action, "--seed", str(seed)) for seed in range(3)}
    commands = quick | {name: synth(path) for name, path in waiting.items()}
    jobs = jobs_file(tmp_path / "jobs.json", **commands)
    command = [sys.executable, "-c", "import sys; from hnf_blender.cli import main; sys.exit(main())", "batch"]
    stdout = tmp_path / "stdout"
    process = subprocess.Popen(
        [*command, str(jobs), "--retries", "1", "--out", str(out), "--workers", "3"],
        cwd=ROOT, stdout=stdout.open("w"), stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        until(lambda: len(attempts(out)) == 3 if out.is_dir() else False, "three quick results")
        before = attempts(out)
        marker = until(at_work(out, "killed"), "the one that waits")
        until(at_work(out, "stopped"), "the other one that waits")
        assert listening(process.pid) == {"127.0.0.1"}
        os.kill(int(marker.worker.rpartition(":")[2]), signal.SIGKILL)
        until(at_work(out, "killed", attempt=2), "its second attempt")
        until(lambda: len(processes_with(str(waiting["killed"]))) == 1, "one command, the first one's being gone")
        let_go(waiting["killed"])
        until(lambda: "killed: " in stdout.read_text(), "its result")
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to everybody
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 1
    assert "What was finished before is kept." in errors
    assert f"its worker {marker.worker} was lost; another has done it" in errors
    assert "Traceback" not in errors
    assert {line.partition(":")[0] for line in stdout.read_text().splitlines()} == {*quick, "killed"}
    after = attempts(out)
    assert {name: after[name] for name in before} == before
    assert after["killed"][0] == 2
    assert half_written(out) == []
    assert not (out / "stopped").exists()
    assert processes_with(str(tmp_path)) == []

    waiting["stopped"].unlink()
    table(waiting["stopped"])
    capsys.readouterr()
    assert batch(jobs, "--out", out, "--scheduler", scheduler, "--json") == 0
    assert told(capsys)[0] == {"jobs": 5, "finished": 1, "skipped": 4, "failed": 0, "retried": 0, "workers": 2}
    assert {name: attempts(out)[name] for name in after} == after
    waiting["killed"].unlink()
    table(waiting["killed"])
    for name, words in commands.items():
        assert (out / name / "x.wav").read_bytes() == direct(words, tmp_path / f"{name}.wav")


def test_a_failure_stops_no_other_job_and_only_changes_rerun(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    actions = [table(tmp_path / f"{name}.csv", force) for name, force in (("a", 1.0), ("b", 2.0))]
    words = ["synth", "--material", "oak-wood", "--out", out, "--scheduler", scheduler, "--json"]
    words += [word for path in (*actions, tmp_path / "absent.csv") for word in ("--action", path)]
    assert batch(*words) == 1
    counts, errors = told(capsys)
    assert counts == {"jobs": 3, "finished": 2, "skipped": 0, "failed": 1, "retried": 0, "workers": 2}
    assert "oak-wood-absent failed: " in errors
    assert "give the same command again: only what failed is run." in errors
    first = attempts(out)
    table(tmp_path / "absent.csv")
    table(actions[1], force=0.5)
    assert batch(*words) == 0
    assert told(capsys)[0] == {"jobs": 3, "finished": 2, "skipped": 1, "failed": 0, "retried": 0, "workers": 2}
    second = attempts(out)
    assert sorted(second) == ["oak-wood-a", "oak-wood-absent", "oak-wood-b"]
    assert second["oak-wood-a"] == first["oak-wood-a"]
    assert second["oak-wood-b"] != first["oak-wood-b"]
    assert batch(*words) == 0
    assert told(capsys)[0] == {"jobs": 3, "finished": 0, "skipped": 3, "failed": 0, "retried": 0, "workers": 0}
    assert attempts(out) == second


def test_a_command_that_dies_is_tried_again_and_then_given_up(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import threading

    action, out = pipe(tmp_path / "a.pipe"), tmp_path / "out"
    jobs = jobs_file(tmp_path / "jobs.json", a=synth(action))
    codes: list[int] = []
    words = (jobs, "--out", out, "--scheduler", scheduler, "--json", "--retries", "1")
    thread = threading.Thread(target=lambda: codes.append(batch(*words)))
    thread.start()
    for attempt in (1, 2):
        until(at_work(out, "a", attempt), f"attempt {attempt}")
        (command,) = until(lambda: processes_with(str(action)), "its command")
        os.kill(command, signal.SIGSEGV)
        until(lambda gone=command: gone not in processes_with(str(action)), "its death")
    thread.join(30)
    assert codes == [1]
    counts, errors = told(capsys)
    assert counts == {"jobs": 1, "finished": 0, "skipped": 0, "failed": 1, "retried": 1, "workers": 2}
    assert "a: it was killed by signal 11; it is tried again" in errors
    assert "a failed: it was killed by signal 11" in errors
    record = read_record(out / "a.failed")
    assert record is not None
    assert (record.exit_code, record.attempts) == (-11, 2)
    assert half_written(out) == []


def test_a_killed_training_job_is_retried_to_the_same_weights(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import threading

    pytest.importorskip("torch", reason="training needs torch")
    out, codes, models = tmp_path / "out", [], tmp_path / "HaTT" / "Models10000Hz" / "XML"
    models.mkdir(parents=True)
    (models / "Models_Cloth.xml").write_text(model_xml(), encoding="utf-8")
    run = ("train", "field", "--data", "hatt", str(tmp_path / "HaTT"), "--material", "Cloth", "--seconds", "6")
    run += ("--epochs", "1", "--hidden", "8", "--layers", "1")
    words = (*run, "--seed", 0, "--seed", 1, "--out", out, "--scheduler", scheduler, "--json")
    thread = threading.Thread(target=lambda: codes.append(batch(*words)))
    thread.start()
    os.kill(until(lambda: processes_with(str(out)), "a training's process")[0], signal.SIGKILL)
    thread.join(120)
    assert codes == [0]
    counts, errors = told(capsys)
    assert counts == {"jobs": 2, "finished": 2, "skipped": 0, "failed": 0, "retried": 1, "workers": 2}
    assert "killed by signal 9; it is tried again" in errors
    first, second = (path.read_bytes() for path in sorted(out.glob("*/*.safetensors")))
    assert first == direct([*run, "--seed", "0"], tmp_path / "alone.safetensors")
    assert first != second
    capsys.readouterr()
    assert batch(*words) == 0
    assert told(capsys)[0] == {"jobs": 2, "finished": 0, "skipped": 2, "failed": 0, "retried": 0, "workers": 0}


def test_missing_schedulers_and_mismatched_workers_are_errors(
    tmp_path: Path, scheduler: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("synth", "--material", "oak-wood", "--stroke", "rub-slow", "--out", tmp_path / "out")
    monkeypatch.setattr("hnf_core.batch.runner.CONNECT_S", 0.5)
    assert batch(*words, "--scheduler", "tcp://127.0.0.1:9") == 1
    assert "no scheduler answers at tcp://127.0.0.1:9" in capsys.readouterr().err
    monkeypatch.setattr("hnf_core.batch.runner.compute_version", lambda: "0.0")
    assert batch(*words, "--scheduler", scheduler) == 1
    assert "Install the same version there" in capsys.readouterr().err
    assert [path.name for path in (tmp_path / "out").iterdir()] == [".hnf-batch"]
