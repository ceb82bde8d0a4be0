"""The page of a study: what it holds, and a session in a real browser, by mouse and by keyboard."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shutil
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from study_builders import build_study, write_methods, write_noise
from web_browser import Browser, needs_browser

from hnf_core.errors import HnfError
from hnf_core.export.wav import read_wav
from hnf_core.study.plan import compare_files, compare_methods, find_stimulus, load_key, make_study, order_trials
from hnf_core.study.presentation import write_page
from hnf_core.study.results import evaluate_study, read_responses

READY = "return document.getElementById('again').disabled === false && !document.getElementById('trial').hidden"
MASKED = "return document.getElementById('trial').hidden"


def read_data(page: Path) -> dict:
    return json.loads(re.search(r'type="application/json">(.*?)</script>', page.read_text("utf-8"), re.DOTALL)[1])


def test_the_page_holds_every_sample_with_one_gain(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    full_scale = write_page(tmp_path / "page.html", tmp_path / "study", plan)
    stimuli = read_data(tmp_path / "page.html")["stimuli"]
    assert stimuli.keys() == {stimulus.id for stimulus in plan.stimuli}
    peak = 0.0
    for name, stored in stimuli.items():
        signal = read_wav(find_stimulus(tmp_path / "study", name))
        samples = np.frombuffer(base64.b64decode(stored["samples"]), "<f4")
        assert samples * full_scale == pytest.approx(signal.samples, rel=1e-6)
        assert stored["rate"] == signal.sample_rate
        peak = max(peak, float(np.abs(samples).max()))
    assert peak == pytest.approx(10 ** (-1 / 20), rel=1e-6)


def test_the_page_needs_no_network_and_runs_its_program_alone(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path, question='Which <b> & "why" </script>?')
    write_page(tmp_path / "page.html", tmp_path / "study", plan)
    text = (tmp_path / "page.html").read_text("utf-8")
    assert (
        re.findall(r"(?:https?:)?//[a-z]|src=|@import|url\(", re.sub(r"^ *//.*$", "", text, flags=re.MULTILINE)) == []
    )
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    assert "unsafe" not in policy
    assert policy.startswith("default-src 'none'")
    for tag in ("script", "style"):
        content = re.search(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL)[1]
        digest = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in policy
    assert text.count("</script>") == 2
    assert read_data(tmp_path / "page.html")["question"] == plan.question
    assert "Which &lt;b&gt; &amp; &quot;why&quot; &lt;/script&gt;?" in text
    assert "{{" not in text
    for word in ("alpha", "beta", "gamma", "texture"):
        assert word not in text


def test_what_a_browser_cannot_play_is_refused(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    with pytest.raises(HnfError, match="would clip"):
        write_page(tmp_path / "page.html", tmp_path / "study", plan, 1.0)
    slow = [write_noise(tmp_path / f"{seed}.wav", seed, rate_hz=3000.0) for seed in (1, 2)]
    plan, _ = make_study(tmp_path / "slow", compare_files([slow], None))
    with pytest.raises(HnfError, match="3000 Hz"):
        write_page(tmp_path / "page.html", tmp_path / "slow", plan)
    assert not (tmp_path / "page.html").exists()


@needs_browser
def test_a_session_in_a_browser_is_one_of_the_terminals(tmp_path: Path) -> None:
    """By mouse: the trials are those of the terminal, in its order; the CSV is read and evaluated."""
    plan, key = build_study(tmp_path, ("alpha", "beta"))
    write_page(tmp_path / "page.html", tmp_path / "study", plan)
    trials = order_trials(plan, "web-1")
    with Browser(tmp_path) as browser:
        browser.go((tmp_path / "page.html").as_uri())
        browser.type("#participant", "web-1")
        browser.click("#begin")
        for trial in trials:
            browser.wait(f"{READY} && document.getElementById('count').innerText === 'Trial {trial.number} of 4'")
            if trial.number == 2:
                browser.click("#again")
                browser.wait(READY)
            browser.click("#choose-first" if key[trial.first].method == "alpha" else "#choose-second")
        browser.wait("return !document.getElementById('end').hidden")
        browser.click("#download")
        csv = tmp_path / "downloads" / "web-1.csv"
        browser.wait("return true")
        for _ in range(500):
            if csv.exists():
                break
            browser.run("return 0")
        assert browser.read_log() == []
    (tmp_path / "study" / "responses").mkdir()
    responses = read_responses(Path(shutil.copy(csv, tmp_path / "study" / "responses" / "web-1.csv")), plan)
    assert [(row.trial, row.pair, row.repeat, row.reference, row.first, row.second) for row in responses] == [
        astuple(trial) for trial in trials
    ]
    assert [row.plays for row in responses] == [1, 2, 1, 1]
    assert all(row.seconds >= 2 * 0.05 + 0.5 for row in responses)
    results = evaluate_study(plan, key, {"web-1": responses})
    assert results.pairs[0].chosen.share == 1.0


@needs_browser
def test_the_browser_orders_trials_as_the_terminal_does(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path, stimuli=5, repeats=3)
    write_page(tmp_path / "page.html", tmp_path / "study", plan)
    names = [f"p{number}" for number in range(50)] + ["A-b_9", "x" * 40]
    with Browser(tmp_path) as browser:
        browser.go((tmp_path / "page.html").as_uri())
        orders = browser.run("return arguments[0].map((name) => orderTrials(name).map(Object.values))", names)
    assert orders == [[list(astuple(trial)) for trial in order_trials(plan, name)] for name in names]


@needs_browser
def test_by_keyboard_alone_interrupted_with_a_reference(tmp_path: Path) -> None:
    """Tab, Enter and 1, 2, R suffice; keys during a presentation count for nothing; a closed page goes on."""
    folders = write_methods(tmp_path / "in", ("alpha", "beta", "real"), 1)
    plan, _ = make_study(tmp_path / "study", compare_methods(folders, reference="real"))
    assert load_key(tmp_path / "study", plan)
    write_page(tmp_path / "page.html", tmp_path / "study", plan)
    with Browser(tmp_path) as browser:
        browser.go((tmp_path / "page.html").as_uri())
        browser.press("\ue004")
        for letter in "k1":
            browser.press(letter)
        browser.press("\ue007")
        browser.wait("return document.querySelector('.playing') !== null")
        browser.press("1")
        assert browser.run("return rows.length") == 0
        browser.wait(READY)
        assert browser.run("return document.getElementById('status').getAttribute('aria-live')") == "polite"
        assert "Press 1 or 2" in browser.run("return document.getElementById('status').textContent")
        browser.press("r")
        browser.wait(READY)
        browser.press("2")
        assert browser.run("return rows.map((row) => [row.trial, row.response, row.plays])") == [[1, "second", 2]]
        browser.go((tmp_path / "page.html").as_uri())
        browser.type("#participant", "k1")
        browser.press("\ue007")
        browser.wait(f"{READY} && document.getElementById('count').innerText === 'Trial 2 of 2'")
        browser.press("1")
        browser.wait("return !document.getElementById('end').hidden")
        assert browser.run("return document.activeElement.id") == "download"
        assert browser.run("return rows.map((row) => [row.trial, row.response])") == [[1, "second"], [2, "first"]]
        assert browser.run("return rows.every((row) => row.reference !== '')")
        assert browser.read_log() == []


@needs_browser
def test_a_name_that_is_none_does_not_begin(tmp_path: Path) -> None:
    plan, _ = build_study(tmp_path)
    write_page(tmp_path / "page.html", tmp_path / "study", plan)
    with Browser(tmp_path) as browser:
        browser.go((tmp_path / "page.html").as_uri())
        browser.type("#participant", "../p")
        browser.click("#begin")
        assert browser.run(MASKED)
        assert browser.run("return !document.getElementById('participant').validity.valid")


@needs_browser
def test_a_page_that_was_changed_does_not_run(tmp_path: Path) -> None:
    """The policy is in force: another script, or a changed one, is not executed."""
    plan, _ = build_study(tmp_path)
    page = tmp_path / "page.html"
    write_page(page, tmp_path / "study", plan)
    page.write_text(page.read_text("utf-8").replace("const GAP_S = 0.5", "const GAP_S = 0.4"), "utf-8")
    with Browser(tmp_path) as browser:
        browser.go(page.as_uri())
        assert browser.run("return typeof orderTrials") == "undefined"
        assert any("Content Security Policy" in message for message in browser.read_log())
