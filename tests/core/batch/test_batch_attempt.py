"""One attempt at a job, without a cluster: files after success, failure and loss of the worker."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from batch_builders import at_work, direct, half_written, order_for, pipe, processes_with, synth, table, until

from hnf_core.batch import __main__, attempt
from hnf_core.batch import attempt as attempt_module
from hnf_core.batch.attempt import (
    MAX_UNREADABLE_S,
    RUN_FILE_NAME,
    CommandResult,
    Outcome,
    Request,
    State,
    encode_message,
    explain_unsuitable_worker,
    make_continue_check,
    parse_outcome,
    run_attempt,
    run_request,
    summarise_outcome,
)
from hnf_core.batch.jobs import Job
from hnf_core.batch.runner import make_plan
from hnf_core.batch.staging import (
    JobRecord,
    StagingMarker,
    clean_up,
    compute_version,
    hash_outputs,
    hash_referenced_files,
    is_abandoned,
    is_fresh,
    make_staging_folder,
    publish,
    read_record,
    reuse_files,
    write_record,
)
from hnf_core.errors import FileError

if sys.platform == "win32":
    pytest.skip("hnf batch needs file locks of POSIX", allow_module_level=True)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "out"


def run(order: Request) -> Outcome:
    return parse_outcome(run_attempt(encode_message(order)))


def fake(monkeypatch: pytest.MonkeyPatch, code: int | None, writes: str = "x") -> list[tuple[str, ...]]:
    """Commands end with that code and write a file of that text; those that ran are listed."""
    ran: list[tuple[str, ...]] = []

    def run_child(words: tuple[str, ...], *_others: object) -> CommandResult:
        ran.append(tuple(words))
        Path(words[-1]).write_text(writes)
        return CommandResult(code, 0.1, (), ("hnf: no.",))

    monkeypatch.setattr(attempt_module, "run_child", run_child)
    return ran


def test_the_result_is_the_commands_own_and_is_made_once(tmp_path: Path, folder: Path) -> None:
    action = table(tmp_path / "a.csv")
    order = order_for(folder, "a", synth(action), action)
    outcome = run(order)
    assert (outcome.state, outcome.why, outcome.was_fresh) == (State.DONE, "", False)
    assert (folder / "a" / "x.wav").read_bytes() == direct(synth(action), tmp_path / "direct.wav")
    record = read_record(folder / "a")
    assert record is not None
    assert (record.exit_code, record.attempts, record.inputs) == (0, 1, order.inputs)
    assert sorted(path.name for path in (folder / "a").iterdir()) == ["batch.json", "x.wav"]
    assert half_written(folder) == []
    stamp = (folder / "a").stat().st_ino
    assert run(order).was_fresh
    assert (folder / "a").stat().st_ino == stamp


def test_what_changed_is_run_again_and_replaces_the_result(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    action = table(tmp_path / "a.csv")
    ran = fake(monkeypatch, 0)
    make = lambda: order_for(folder, "a", synth(action), action)  # noqa: E731
    for _ in range(2):
        assert run(make()).state is State.DONE
    assert len(ran) == 1
    table(action, force=2.0)
    assert run(make()).state is State.DONE
    assert run(replace(make(), words=tuple(synth(action, "--seed", "1")))).state is State.DONE
    assert len(ran) == 3
    (folder / "a" / "x.wav").write_text("damaged")
    assert run(replace(make(), words=tuple(synth(action, "--seed", "1")))).state is State.DONE
    assert len(ran) == 4
    assert half_written(folder) == []


def test_a_failure_costs_no_result_and_a_success_clears_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake(monkeypatch, 0, "good")
    assert run(order_for(folder, "a", ["synth"])).state is State.DONE
    fake(monkeypatch, 1, "bad")
    outcome = run(order_for(folder, "a", ["synth", "--seed", "1"]))
    assert (outcome.state, outcome.why) == (State.FAILED, "no.")
    assert (folder / "a" / "x.wav").read_text() == "good"
    record = read_record(folder / "a.failed")
    assert record is not None
    assert (record.exit_code, record.stderr) == (1, ("hnf: no.",))
    fake(monkeypatch, 0, "better")
    assert run(order_for(folder, "a", ["synth", "--seed", "2"])).state is State.DONE
    assert (folder / "a" / "x.wav").read_text() == "better"
    assert not (folder / "a.failed").exists()


@pytest.mark.parametrize(
    ("code", "state", "words"),
    [
        (0, State.DONE, ""),
        (1, State.FAILED, "no such scene"),
        (2, State.FAILED, "no such scene"),
        (-11, State.ACCIDENT, "signal 11"),
        (70, State.ACCIDENT, "it broke: hnf: no such scene"),
        (None, State.STOPPED, "stopped"),
    ],
)
def test_an_end_is_judged_by_its_code(code: int | None, state: State, words: str) -> None:
    found, why = summarise_outcome(CommandResult(code, 0.1, (), ("first", "hnf: no such scene", "")))
    assert found is state
    assert words in why


def test_accidents_are_counted_and_only_the_last_leaves_a_folder(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = fake(monkeypatch, -9)
    order, states = order_for(folder, "a", ["synth"], retries=2), []
    while True:
        outcome = run(order)
        states.append(((folder / "a.failed").exists(), len(outcome.earlier)))
        if not order.should_retry(outcome):
            break
        order = replace(order, earlier=(*outcome.earlier, outcome.why))
    assert states == [(False, 0), (False, 1), (True, 2)]
    assert len(ran) == 3
    assert half_written(folder) == []


def test_an_exception_is_an_accident_and_a_refusal_is_a_failure(
    tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    refused = run(order_for(folder, "a", synth(tmp_path / "absent.csv")))
    assert refused.state is State.FAILED
    assert "absent.csv" in refused.why
    monkeypatch.setattr(__main__, "exit_with_parent", lambda **_: None)
    monkeypatch.setattr(__main__, "PROGRAM", "no_such_program")
    code = __main__.main([])
    assert "ModuleNotFoundError" in capsys.readouterr().err
    assert summarise_outcome(CommandResult(code, 0.1, (), ()))[0] is State.ACCIDENT


def left_by(folder: Path, order: Request, finished: bool = False) -> Path:
    """A part folder as a killed worker leaves it: no clean-up has run."""
    with make_staging_folder(folder, order.name, StagingMarker(order.run, "other:1", ())) as (part, _):
        (part / "cache").mkdir()
        (part / "cache" / "closeup.npz").write_bytes(b"seen")
        (part / "w.checkpoint").write_bytes(b"trained")
        (part / "x.wav").write_text("found" if finished else "half")
        if finished:
            write_record(part, record_of(order, part))
        kept = folder / "kept"
        os.rename(part, kept)
    os.rename(kept, part)
    return part


def record_of(order: Request, part: Path) -> JobRecord:
    return JobRecord(
        order.name, order.words, order.key, order.version, order.inputs, {}, hash_outputs(part), 0, 1.0, 1, "w", (), ()
    )


def test_a_lost_worker_is_counted_and_what_it_had_is_begun_with(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = order_for(folder, "a", ["synth"])
    left_by(folder, order)
    ran = fake(monkeypatch, 0)
    outcome = run(order)
    assert outcome.state is State.DONE
    assert outcome.earlier == ("its worker other:1 was lost",)
    assert len(ran) == 1
    assert (folder / "a" / "cache" / "closeup.npz").read_bytes() == b"seen"
    assert (folder / "a" / "w.checkpoint").read_bytes() == b"trained"
    assert (folder / "a" / "x.wav").read_text() == "x"
    assert half_written(folder) == []


def test_lost_workers_are_not_asked_for_ever(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = order_for(folder, "a", ["synth"], retries=0)
    left_by(folder, order)
    ran = fake(monkeypatch, 0)
    outcome = run(order)
    assert (outcome.state, outcome.why) == (State.ACCIDENT, "its worker other:1 was lost")
    assert not order.should_retry(outcome)
    assert ran == []
    again = order_for(folder, "a", ["synth"], run="the next batch", retries=0)
    assert run(again).state is State.DONE  # another batch's losses are not counted


def test_a_finished_but_unrenamed_result_is_reused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    order = order_for(folder, "a", ["synth"])
    left_by(folder, order, finished=True)
    ran = fake(monkeypatch, 0)
    outcome = run(order)
    assert (outcome.state, outcome.was_fresh) == (State.DONE, True)
    assert (folder / "a" / "x.wav").read_text() == "found"
    assert ran == []
    assert half_written(folder) == []


@pytest.mark.parametrize("refused", ["once", "always", "never: the power fails"])
def test_a_failed_rename_loses_neither_old_nor_new_result(
    refused: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran, old, new = fake(monkeypatch, 0), *(order_for(folder, "a", ["synth", "--seed", seed]) for seed in "01")
    assert run(old).state is State.DONE
    if refused.startswith("never"):
        left_by(folder, new, finished=True)
        (folder / "a").rename(folder / ".a~b.old")
        (folder / ".c~d.old").mkdir()  # made, and nothing moved into it
    else:
        rename = Path.rename

        def refuse(path: Path, target: Path) -> Path:
            if path.suffix == ".part" or (refused == "always" and Path(target) == folder / "a"):
                raise OSError(5, "Input/output error")
            return rename(path, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "rename", refuse)
            outcome = run(new)
        assert (outcome.state, "Input/output error" in outcome.why) == (State.ACCIDENT, True)
        assert (folder / "a").exists() is (refused == "once")
    commands = len(ran)
    clean_up(folder)
    assert is_fresh(read_record(folder / "a"), old.key, folder / "a")
    assert [path.suffix for path in half_written(folder)] == [".part"]
    outcome = run(new)
    assert (outcome.state, outcome.was_fresh, len(ran)) == (State.DONE, True, commands)
    assert is_fresh(read_record(folder / "a"), new.key, folder / "a")
    assert half_written(folder) == []


def test_a_folder_that_cannot_be_read_for_a_while_stops_nothing(folder: Path) -> None:
    now, said = 0.0, folder / RUN_FILE_NAME
    look = make_continue_check(order_for(folder, "a", ["synth"]), lambda: now)

    def goes_on(at_s: float, text: str | None) -> bool:
        nonlocal now
        now = at_s
        said.unlink(missing_ok=True) if text is None else said.write_text(text)
        return look()

    last = 40.0 + MAX_UNREADABLE_S - 1.0
    assert all([goes_on(40.0, "r"), goes_on(40.2, None), goes_on(last, None), goes_on(last + 0.2, "r")])
    assert goes_on(last + MAX_UNREADABLE_S, None)
    assert not goes_on(last + 0.2 + MAX_UNREADABLE_S, None)
    assert goes_on(200.0, "r")
    assert not goes_on(200.2, "")
    assert not goes_on(200.4, "another")


def test_a_stopped_attempt_leaves_nothing_half_written(tmp_path: Path, folder: Path) -> None:
    action = pipe(tmp_path / "a.pipe")
    order = order_for(folder, "a", synth(action))
    outcomes: list[Outcome] = []
    thread = threading.Thread(target=lambda: outcomes.append(run_request(order)))
    thread.start()
    until(at_work(folder, "a"), "the attempt")
    until(lambda: processes_with(str(action)), "its command")
    (folder / RUN_FILE_NAME).write_text("")
    thread.join(20)
    assert [outcome.state for outcome in outcomes] == [State.STOPPED]
    assert processes_with(str(action)) == []
    assert sorted(path.name for path in folder.iterdir()) == [RUN_FILE_NAME]


def test_a_command_ends_with_its_worker(tmp_path: Path, folder: Path) -> None:
    """A worker that is killed can clean up nothing."""
    action = pipe(tmp_path / "a.pipe")
    order = order_for(folder, "a", synth(action))
    worker = os.fork()
    if worker == 0:
        try:
            run_attempt(encode_message(order))
        finally:
            os._exit(0)
    marker = until(at_work(folder, "a"), "the attempt")
    assert marker.worker.endswith(f":{worker}")
    until(lambda: processes_with(str(action)), "its command")
    (part,) = half_written(folder)
    assert not is_abandoned(part, 0.0)
    os.kill(worker, signal.SIGKILL)
    os.waitpid(worker, 0)
    until(lambda: not processes_with(str(action)), "the end of the command")
    until(
        lambda: is_abandoned(part, 0.0),
        "the end of its lock: a dying process has no command line before its files close",
    )
    assert clean_up(folder) == []
    assert half_written(folder) == []


def test_a_worker_says_what_it_cannot_see(folder: Path, tmp_path: Path) -> None:
    action = table(tmp_path / "a.csv")
    order = order_for(folder, "a", synth(action), action)
    assert explain_unsuitable_worker(str(folder), "r", compute_version(), [str(action)]) == ""
    assert "absent" in explain_unsuitable_worker(str(folder), "r", compute_version(), [str(tmp_path / "absent")])
    assert "shared file system" in explain_unsuitable_worker(str(tmp_path / "elsewhere"), "r", compute_version(), [])
    assert "same version" in explain_unsuitable_worker(str(folder), "r", "0.0", [])
    action.unlink()
    outcome = run(order)
    assert outcome.state is State.UNSEEN
    assert str(action) in outcome.why
    assert run(replace(order, run="an older batch")).state is State.STOPPED
    assert not order.should_retry(outcome)


def test_only_what_a_batch_made_is_replaced(folder: Path) -> None:
    order = order_for(folder, "a", ["synth"])
    order.result_folder.mkdir()
    (order.result_folder / "mine").touch()
    with (
        make_staging_folder(folder, "a", StagingMarker("r", "w", ())) as (part, _),
        pytest.raises(FileError, match="not made by"),
    ):
        publish(part, order.result_folder)
    with pytest.raises(FileError, match="not made by"):
        make_plan([Job("a", ("synth",), "x.wav")], {"a": ()}, folder, folder, "r", 2)
    assert (order.result_folder / "mine").exists()
    with make_staging_folder(folder, "b", StagingMarker("r", "w", ())) as (part, _):
        (part / ".attempt").unlink()  # another attempt has taken over
        with pytest.raises(FileError):
            publish(part, folder / "b")
    assert not (folder / "b").exists()


MODES = """import sys
from pathlib import Path
from hnf_core.batch.staging import StagingMarker, make_staging_folder
from hnf_core.files import write_text
with make_staging_folder(Path(sys.argv[1]), "a", StagingMarker("r", "w", ())) as (part, _):
    write_text(part / "new", "")
    write_text(Path(sys.argv[1], "old"), "")
    print(*(oct(path.stat().st_mode & 0o777) for path in (part, part / "new", Path(sys.argv[1], "old"))))
"""


def test_new_results_are_for_whom_the_persons_umask_says(tmp_path: Path) -> None:
    (tmp_path / "old").touch()
    (tmp_path / "old").chmod(0o604)
    words = [sys.executable, "-c", MODES, str(tmp_path)]
    told = subprocess.run(words, cwd=attempt.ROOT, umask=0o027, check=True, capture_output=True, text=True)
    assert told.stdout.split() == ["0o750", "0o640", "0o604"]


def test_files_that_a_scene_refers_to_are_inputs_too(folder: Path, tmp_path: Path) -> None:
    picture = tmp_path / "wood.png"
    picture.write_bytes(b"1")
    os.utime(picture, (1e9, 1e9))
    order = order_for(folder, "a", ["touch", "cup.blend"])
    order.result_folder.mkdir()
    (order.result_folder / "report.json").write_text(json.dumps({"files": [str(picture), str(tmp_path / "absent"), 3]}))
    found = hash_referenced_files(order.result_folder, since=2e9)
    assert list(found) == [str(picture)]
    record = replace(record_of(order, order.result_folder), found=found)
    write_record(order.result_folder, record)
    assert read_record(order.result_folder) == record
    assert is_fresh(record, order.key, order.result_folder)
    picture.write_bytes(b"2")
    assert not is_fresh(record, order.key, order.result_folder)
    assert hash_referenced_files(order.result_folder, since=1e9) == {
        str(picture): ""
    }  # it changed while it was read: never fresh


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": "hnf-batch-1"}', '{"schema": 2}', "\0", "[" * 10_000])
def test_a_damaged_record_is_none(text: str, tmp_path: Path) -> None:
    (tmp_path / "batch.json").write_text(text)
    assert read_record(tmp_path) is None


def test_what_is_begun_with_is_not_written_into(tmp_path: Path) -> None:
    source, part = tmp_path / "a", tmp_path / "b"
    for each in (source / "cache", part):
        each.mkdir(parents=True)
    (source / "cache" / "c.npz").write_bytes(b"1")
    (source / "x.wav").write_bytes(b"2")
    reuse_files(source, part)
    reuse_files(source, part)
    assert [path.relative_to(part).as_posix() for path in part.rglob("*") if path.is_file()] == ["cache/c.npz"]


def test_the_childs_program_is_the_hnf_command() -> None:
    assert (attempt.ROOT / __main__.PROGRAM.replace(".", "/")).with_suffix(".py").is_file()
