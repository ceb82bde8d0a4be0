"""Jobs of a batch: what a list of them may say, what a command line makes of them, and what crosses the wire."""

from __future__ import annotations

import itertools
import json
import math
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hnf_core.batch import staging
from hnf_core.batch.attempt import Outcome, Request, State, encode_message, parse_outcome, parse_request
from hnf_core.batch.jobs import (
    FAILED_SUFFIX,
    make_combined_jobs,
    make_folder_name,
    make_job,
    make_scene_jobs,
    parse_jobs,
    read_jobs,
    reject_duplicates,
)
from hnf_core.batch.staging import compute_digest, find_named_files
from hnf_core.cli.main import main
from hnf_core.errors import FileError, UsageError
from hnf_core.kernel import loader
from hnf_core.progress import count_work

SYNTH = "synth --material oak-wood --stroke rub-slow --out x.wav"
ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
TEXTS = st.lists(st.text(max_size=6), max_size=4).map(tuple)


def one(**fields: object) -> dict[str, object]:
    return {"schema": 1, "job": [{"name": "a", "command": SYNTH} | fields]}


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda _arguments: 1)


def test_both_forms_of_a_file_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(f'schema = 1\n[[job]]\nname = "a"\ncommand = "hnf {SYNTH}"\ninputs = ["b"]\n')
    (tmp_path / "a.json").write_text(json.dumps(one(command=SYNTH.split(), inputs=["b"])))
    (job,) = read_jobs(tmp_path / "a.toml")
    assert (job,) == read_jobs(tmp_path / "a.json")
    assert job.command == tuple(SYNTH.split())
    assert (job.name, job.out, job.inputs) == ("a", "x.wav", ("b",))


@given(ANYTHING)
def test_whatever_a_file_holds_it_is_refused_in_words_or_taken(record: object) -> None:
    with pytest.raises((ValueError, UsageError)) as refused:
        parse_jobs(record)
    assert str(refused.value)


@given(st.sampled_from(["name", "command", "inputs", "retries"]), ANYTHING)
def test_a_bad_field_is_refused_with_the_place_of_its_job(field: str, value: object) -> None:
    try:
        said = f"{len(parse_jobs(one(**{field: value})))} taken"
    except ValueError as refused:
        said = str(refused)
    assert said.startswith("job 1") or (said == "1 taken" and field != "retries")


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({"job": []}, "no schema = 1"),
        ({"schema": True, "job": []}, "no schema = 1"),
        ({"schema": 1, "job": []}, "no list with something"),
        ({"schema": 1, "job": [], "jobs": []}, "unknown: jobs"),
        (one(colour="red"), "job 1 has unknown: colour"),
        (one(name="../a"), "cannot be the name"),
        (one(name=f"a{FAILED_SUFFIX}"), "cannot be the name"),
        (one(name=".a"), "cannot be the name"),
        (one(command="synth 'oak"), "cannot be split"),
        (one(command="stream x.wav --to virtual"), "none of: touch"),
        (one(command="synth --material oak-wood"), "which file it writes"),
        (one(command=f"{SYNTH} --out y.wav"), "more than one --out"),
        (one(command="synth --ou y.wav"), "in full"),
        (one(command=["synth", "--", "--out", "y.wav"]), "no '--'"),
        ({"schema": 1, "job": [*one()["job"], *one(name="A")["job"]]}, "two jobs would write into one folder"),  # type: ignore[misc]
    ],
)
def test_the_error_says_what_is_wrong(record: object, words: str, tmp_path: Path) -> None:
    path = tmp_path / "jobs.json"
    path.write_text(json.dumps(record))
    with pytest.raises(FileError, match=words) as refused:
        read_jobs(path)
    assert "jobs.json" in str(refused.value)
    assert "docs/batch.md" in str(refused.value)


@given(st.text(alphabet="ab./\\~:-\0 ", max_size=10))
def test_no_out_leaves_the_folder_of_its_job(out: str) -> None:
    try:
        job = make_job("a", ["synth", "--out", out])
    except UsageError:
        return
    parts = PurePosixPath(job.out).parts
    assert parts
    assert not PurePosixPath(job.out).is_absolute()
    assert not {"..", "", "."} & set(parts)


@given(st.text(max_size=30))
def test_a_name_is_one_folder(text: str) -> None:
    for name in (text, make_folder_name(text)):
        try:
            job = make_job(name, SYNTH.split())
        except UsageError:
            assert name != make_folder_name(text) or not name
        else:
            assert (Path("/x") / job.name).parent == Path("/x")
            assert not job.name.startswith(".")
            assert "~" not in job.name  # it ends the name of a folder in the making


@given(st.dictionaries(st.sampled_from(["--material", "--stroke", "--seed"]), st.sets(st.integers(0, 9), max_size=3)))
def test_a_job_for_each_combination_and_a_folder_for_each_job(values: dict[str, set[int]]) -> None:
    varied = {option: [str(value) for value in sorted(chosen)] for option, chosen in values.items()}
    jobs = make_combined_jobs(["synth"], varied, ["--rate", "8000"], ".wav")
    assert len(jobs) == math.prod(len(each) for each in varied.values() if each)
    assert len({job.name for job in jobs}) == len(jobs)
    told = {tuple(word for word in job.words[1:-2] if not word.startswith("-")) for job in jobs}
    assert told == set(itertools.product(*(each for each in varied.values() if each)))
    assert all(job.out == f"{job.name}.wav" and job.words[-2:] == ("--rate", "8000") for job in jobs)


def test_scenes_of_one_name_are_refused_not_mixed() -> None:
    jobs = make_scene_jobs(["a/cup.blend", "b/bowl.gltf"], ["--scale", "0.01"])
    assert [(job.name, job.out) for job in jobs] == [("cup", "."), ("bowl", ".")]
    assert jobs[0].words == ("touch", "a/cup.blend", "--scale", "0.01")
    with pytest.raises(UsageError, match="one folder"):
        make_scene_jobs(["a/cup.blend", "b/Cup.gltf"], [])
    with pytest.raises(UsageError, match="no scene"):
        make_scene_jobs([], ["--scale", "0.01"])
    with pytest.raises(UsageError, match="one folder"):
        reject_duplicates([make_job("\u212b", SYNTH.split()), make_job("\u00e5", SYNTH.split())])


@given(st.builds(Outcome, st.text(), st.sampled_from(State), st.text(), st.floats(0, 1e9), TEXTS))
def test_an_outcome_crosses_the_wire(outcome: Outcome) -> None:
    assert parse_outcome(encode_message(outcome)) == outcome


@given(
    st.builds(
        Request, st.text(), TEXTS, st.text(), st.dictionaries(st.text(), st.text(), max_size=3), st.text(), st.text(),
        st.text(), st.text(), st.integers(0, 9), TEXTS,
    )
)  # fmt: skip
def test_an_order_crosses_the_wire_and_keeps_its_key(order: Request) -> None:
    again = parse_request(encode_message(order))
    assert again == order
    assert again.key == order.key == replace(order, run="another", earlier=("lost",)).key
    changed = [replace(order, version=order.version + "1"), replace(order, words=(*order.words, "x"))]
    changed += [replace(order, inputs={**order.inputs, "new": "x"}), replace(order, out=order.out + "x")]
    assert order.key not in {each.key for each in changed}


@given(ANYTHING | ANYTHING.map(lambda value: json.dumps(value)))
def test_what_is_no_message_is_refused(sent: object) -> None:
    for read in (parse_request, parse_outcome):
        with pytest.raises(FileError, match="same version"):
            read(sent)  # type: ignore[operator]


def test_a_digest_follows_content_and_a_folders_listing(tmp_path: Path) -> None:
    file, folder = tmp_path / "a", tmp_path / "b"
    folder.mkdir()
    file.write_bytes(b"1")
    shutil.copy(file, folder / "c")
    seen = [compute_digest(file), compute_digest(folder), compute_digest(tmp_path / "none")]
    assert seen[2] == ""
    assert compute_digest(shutil.copy(file, tmp_path / "d")) == seen[0]
    file.write_bytes(b"2")
    (folder / "e").touch()
    assert compute_digest(file) != seen[0]
    assert compute_digest(folder) != seen[1]
    found = find_named_files(["a", ["b", ("none", None, 3)], tmp_path / "a", "x\0", "y" * 5000], tmp_path)
    assert found == (str(file), str(folder))
    assert find_named_files(["a", "b"], tmp_path, results_folder=folder) == (str(file),)


def test_the_version_follows_the_code_the_data_and_the_kernel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not their times, nor what Python compiles beside them: the same program has the same version on every machine."""
    core, guest = tmp_path / "hnf_core", tmp_path / "hnf_blender"
    for path in (core / "data" / "library.json", core / "field" / "a.py", guest / "b.py", guest / "data" / "de.json"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("1")
    monkeypatch.setattr(staging, "PACKAGES", (core, guest, tmp_path / "absent"))
    monkeypatch.setattr(staging, "DATA_FOLDER", core / "data")

    def version() -> str:
        staging.compute_version.cache_clear()
        return staging.compute_version()

    try:
        first = version()
        os.utime(core / "field" / "a.py", (1.0, 1.0))
        (core / "field" / "__pycache__").mkdir()
        (core / "field" / "__pycache__" / "a.pyc").write_text("compiled")
        (core / "data" / ".hidden").touch()
        assert version() == first
        seen = [first]
        for path in (core / "data" / "library.json", core / "field" / "a.py", guest / "b.py"):
            path.write_text("2")
            seen.append(version())
        (core / "field" / "a.py").rename(core / "field" / "c.py")
        seen.append(version())
        monkeypatch.setattr(loader, "get_build_id", lambda: "another")
        seen.append(version())
        assert len(set(seen)) == len(seen)
    finally:
        staging.compute_version.cache_clear()


def test_the_version_of_the_program_itself_counts_its_own_code() -> None:
    staging.compute_version.cache_clear()
    with count_work() as work:
        first = staging.compute_version()
        files = work.items["hashed_files"]
        assert {staging.__file__, str(staging.DATA_FOLDER / "library.json")} <= set(files)
        count = len(files)
        assert staging.compute_version() == first
        assert len(files) == count  # once a process


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("touch",), "no scene"),
        (
            ("synth", "--stroke", "rub-slow"),
            "a material is needed. Give --material NAME, --touch IMAGE or --weights FILE.",
        ),
        (("synth", "--material", "oak-wood", "--stroke", "dance"), "dance"),
        (("train",), "what is to be trained"),
        (("jobs.txt",), "neither a file of jobs"),
        (("absent.toml",), "cannot be read"),
        (("synth", "--material", "oak-wood", "--stroke", "rub-slow", "--scheduler", "somewhere"), "no address"),
        (("synth", "--material", "oak-wood", "--stroke", "rub-slow", "--workers", "0"), "at least 1"),
    ],
)
def test_wrong_words_are_refused_before_anything_starts(
    words: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert hnf("batch", *words, "--out", tmp_path / "out") in (1, 2)
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_no_folder_and_a_foreign_folder_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("synth", "--material", "oak-wood", "--stroke", "rub-slow")
    assert hnf("batch", *words) == 2
    assert "--out DIR" in capsys.readouterr().err
    precious = tmp_path / "oak-wood-rub-slow" / "mine.txt"
    precious.parent.mkdir()
    precious.write_text("mine")
    assert hnf("batch", *words, "--out", tmp_path) == 1
    assert "was not made by a batch" in capsys.readouterr().err
    assert precious.read_text() == "mine"


def test_without_dask_it_says_how_to_get_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    words = ("synth", "--material", "oak-wood", "--stroke", "rub-slow", "--out", tmp_path / "out")
    assert hnf("batch", *words) == 1
    assert "pip install dask distributed" in capsys.readouterr().err
