"""`hnf bench scale` without Blender: counted work, and skipped sizes that would take too long. No time is asserted."""

from __future__ import annotations

import pytest

from hnf_lab.bench import harness, strokes
from hnf_lab.bench.harness import BenchOptions, Cost, Sweep, read_available_mb, run_sizes, run_with_peak
from hnf_lab.cli.bench_catalogue import CORE_BENCHES

QUICK = BenchOptions(repeats=1, quick=True)


def line(measure, sizes=(1, 10, 100, 1000), most_s=5.0, prepare=lambda count: None) -> Sweep:
    return Sweep("things", "one kind", sizes, measure, most_s, prepare)


def test_a_size_that_would_take_too_long_is_skipped_with_a_note():
    begun = []

    def measure(count: int) -> Cost:
        begun.append(count)
        return Cost(0.01 * count, 0.01 * count, {"renders": count})

    rows = run_sizes("scale", line(measure), QUICK)
    assert begun == [1, 10, 100]
    assert [row.size.count for row in rows] == [1, 10, 100, 1000]
    assert [row.seconds is None for row in rows] == [False, False, False, True]
    assert "about 10 s" in rows[-1].note
    assert rows[1].work == {"renders": 10}


def test_a_size_that_would_not_fit_into_memory_says_so(monkeypatch):
    peaks = iter([100.0, 1000.0])
    monkeypatch.setattr(harness, "run_with_peak", lambda function: (function(), next(peaks)))
    monkeypatch.setattr(harness, "read_available_mb", lambda: 8000.0)
    rows = run_sizes("scale", line(lambda count: Cost(1e-3, 1e-3, {}), sizes=(1, 10, 100)), QUICK)
    assert [row.peak_mb for row in rows] == [100.0, 1000.0, None]
    assert "about 10.0 GB, and 8.0 GB are free" in rows[-1].note


def test_every_measurement_is_prepared_and_repeated():
    prepared, measured = [], []

    def measure(count: int) -> Cost:
        measured.append(count)
        return Cost(1e-3, 1e-3, {})

    (row,) = run_sizes("scale", line(measure, (5,), prepare=prepared.append), BenchOptions(repeats=3))
    assert prepared == measured == [5, 5, 5]
    assert row.seconds.count == row.cpu.count == 3


def test_the_peak_is_what_was_held_at_once():
    free = read_available_mb()
    held, peak = run_with_peak(lambda: len(bytearray(b"x") * 50_000_000))
    assert held == 50_000_000
    if free is None or peak is None:
        pytest.skip("this system does not tell what a process holds")
    assert free > 0.0
    assert 40.0 < peak < 200.0


def test_signals_of_any_length_count_their_samples_and_states():
    (bench,) = (bench for bench in CORE_BENCHES if bench.name == "scale")
    rows = bench.measure(QUICK)
    assert {row.size.line for row in rows} == {"in one piece", "in portions", "in portions, 10 s in contact"}
    for row in rows:
        assert row.work["samples"] == 10_000 * row.size.count
        assert row.work["F_Θ states"] > 0
    assert sum(row.exponent is not None for row in rows) == 3


def test_contact_that_ends_makes_a_stroke_silent_after_it():
    stroke = strokes.make_scrape(3.0, contact_s=1.0)
    assert stroke.action.contact.sum() == 201
    assert (stroke.action.force[~stroke.action.contact] == 0.0).all()
