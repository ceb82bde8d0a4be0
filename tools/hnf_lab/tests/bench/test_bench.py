"""`hnf bench`: its table, its options, and the rows of benches without Blender. No time is asserted."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest

from data_tools.bench_strokes import make_keyed_stroke, make_scrape
from hnf_core.cli.main import build_parser, main
from hnf_core.field import field as network
from hnf_core.field.field import evaluate
from hnf_core.field.prepare import prepare_stroke
from hnf_core.field.weights import load_field
from hnf_lab.bench import synth
from hnf_lab.bench.harness import (
    Bench,
    BenchOptions,
    Row,
    Spread,
    Times,
    describe_machine,
    format_duration,
    format_rows,
    measure_peak_mb,
)
from hnf_lab.bench.synth import make_texture_model, synthesise_autoregressive
from hnf_lab.cli.bench_catalogue import CORE_BENCHES

SPREAD = Spread.from_values([0.3, 0.1, 0.2])


def hnf(*words: str) -> int:
    return main(["bench", *words], lambda arguments: 1)


def test_a_spread_is_of_what_was_measured():
    assert (SPREAD.median, SPREAD.lowest, SPREAD.highest, SPREAD.count) == (0.2, 0.1, 0.3, 3)
    assert SPREAD.median <= SPREAD.p99 <= SPREAD.highest
    assert Spread.from_values([7.0]) == Spread(7.0, 7.0, 7.0, 7.0, 1)


def test_a_row_as_json_has_medians_and_the_spread_beside():
    record = Row("b", "fast", SPREAD, SPREAD, SPREAD, "slow", 1e-3, "m/s²", 2.5, "a note").to_json()
    assert json.loads(json.dumps(record)) == record
    assert record["seconds"] == record["cpu"] == record["ratio"] == 0.2
    assert record["seconds_spread"]["count"] == 3
    assert (record["bench"], record["method"], record["error"], record["peak_mb"]) == ("b", "fast", 1e-3, 2.5)
    empty = Row("b", "said").to_json()
    assert empty["seconds"] is None
    assert empty["error"] is None


def test_the_table_fills_every_column_and_lists_the_machine():
    rows = [
        Row("b", "slow", cpu=SPREAD, peak_mb=1.0),
        Row("b", "fast", SPREAD, ratio=SPREAD, ratio_to="slow", error=0.0, error_unit="m/s²"),
    ]
    text = format_rows(rows, {"processor": "P", "cores": "2"})
    lines = text.splitlines()
    assert {line.count("|") for line in lines[:4]} == {13}
    assert lines[2] == "| b | slow |  |  |  | 200 ms | 300 ms | 3 |  |  | 1.0 |  |"
    assert "0 m/s²" in lines[3]
    assert "0.2 × slow (0.1–0.3)" in lines[3]
    assert lines[-1] == "processor P, cores 2"


def test_the_real_time_factor_column_is_optional():
    plain = Row("b", "slow", SPREAD, error=1e-3, error_unit="m/s²")
    paced = Row("b", "fast", SPREAD, error=-47.5, error_unit="dB", realtime_factor=123.4)
    assert "× real time" not in format_rows([plain], {})
    lines = format_rows([plain, paced], {}).splitlines()
    assert {line.count("|") for line in lines[:4]} == {14}
    at = lines[0].split("|").index(" × real time ")
    assert [line.split("|")[at].strip() for line in lines[2:4]] == ["", "123"]
    assert "error_db" not in plain.to_json()
    assert (paced.to_json()["error_db"], paced.to_json()["realtime_factor"]) == (-47.5, 123.4)


@pytest.mark.parametrize(
    ("seconds", "words"), [(12.34, "12.3 s"), (1.0, "1 s"), (0.0123, "12.3 ms"), (4.5e-6, "4.5 µs"), (0.0, "0 µs")]
)
def test_durations_have_three_digits(seconds, words):
    assert format_duration(seconds) == words


def test_measure_returns_the_result_and_counts_peak_memory():
    times, others = Times(), Times()
    assert [times.measure(lambda: sum(range(10_000))) for _ in range(2)] == [49_995_000] * 2
    with pytest.raises(ZeroDivisionError):
        others.measure(lambda: 1 / 0)
    others.measure(lambda: sum(range(10_000)))
    assert (times.seconds.count, times.cpu.count, times.compute_ratio(others).count) == (2, 2, 2)
    assert 0.0 < times.cpu.lowest <= times.seconds.highest
    told = Times(iter([1.0, 4.0]).__next__)
    told.measure(lambda: None)
    assert told.cpu.median == 3.0
    noted = Times()
    noted.add_wall_time(2.0)
    assert (noted.seconds.median, noted.cpu) == (2.0, None)
    assert 8.0 < measure_peak_mb(lambda: bytearray(10_000_000)) < 12.0


def test_the_machine_is_described():
    facts = describe_machine()
    assert {"processor", "cores", "system", "python", "hnf", "numpy"} <= facts.keys()
    assert all(facts.values())


def test_the_machine_lists_versions_of_loaded_packages_only():
    """bfloat16 is torch's work; pictures and rays have packages of their own. In a process that has loaded none yet."""
    code = (
        "import json; from hnf_lab.bench.harness import describe_machine; before = describe_machine();"
        "import torch, scipy, OpenEXR, embreex; print(json.dumps([before, describe_machine()]))"
    )
    for name in ("torch", "scipy", "OpenEXR", "embreex"):
        pytest.importorskip(name)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    before, after = json.loads(done.stdout.splitlines()[-1])
    assert not {"torch", "scipy", "OpenEXR", "embreex"} & before.keys()
    for name in ("torch", "scipy", "OpenEXR", "embreex"):
        assert after[name][0].isdigit()


def test_a_changed_key_gives_the_very_samples_of_all_anew():
    (bench,) = (bench for bench in CORE_BENCHES if bench.name == "preview")
    whole, part = bench.measure(BenchOptions(repeats=2, quick=True))
    assert part.ratio_to == whole.method
    assert (part.error, part.error_unit) == (0.0, "m/s²")
    assert part.seconds.count == whole.seconds.count == part.ratio.count == 2
    assert part.peak_mb > 0.0
    share = float(part.note.partition("%")[0])
    assert 0.0 < share < 100.0


def test_one_bench_as_a_list_of_objects(capsys):
    assert hnf("preview", "--quick", "--repeats", "1", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["bench"] for row in rows] == ["preview", "preview"]
    assert all(row["seconds"] > 0.0 and row["machine"]["numpy"] for row in rows)


def test_an_unknown_bench_lists_those_there_are(capsys):
    assert hnf("speed") == 2
    said = capsys.readouterr().err
    assert all(bench.name in said for bench in CORE_BENCHES)


def test_no_repeats_is_no_measurement(capsys):
    assert hnf("preview", "--repeats", "0") == 2
    assert "--repeats" in capsys.readouterr().err


def test_help_is_there(capsys):
    assert hnf("--help") == 0
    assert "--repeats" in capsys.readouterr().out


def test_all_that_are_asked_for_run_in_order(capsys):
    from hnf_lab.cli.bench import run_benches

    seen = []

    def rows_of(name: str):
        def rows(options: BenchOptions) -> list[Row]:
            seen.append((name, options.repeats, options.quick))
            return [Row(name, "it", SPREAD)]

        return rows

    benches = [Bench(name, "…", rows_of(name)) for name in ("one", "two")]
    arguments = build_parser(lambda _: 1).parse_args(["bench", "--repeats", "4"])
    assert run_benches(arguments, benches) == 0
    assert seen == [("one", 4, False), ("two", 4, False)]
    assert [line.split(" | ")[0] for line in capsys.readouterr().out.splitlines()[2:4]] == ["| one", "| two"]


def test_synthesis_has_a_row_and_an_error_for_every_method(capsys):
    assert hnf("synth", "--quick", "--repeats", "1", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    reference, *ours, rival = rows
    assert all({"method", "realtime_factor", "peak_mb", "error_db"} <= set(row) for row in rows)
    assert (reference["method"], reference["error_db"]) == ("literal, float64", None)
    assert all(row["seconds"] > 0.0 and row["cpu"] > 0.0 for row in rows)
    assert reference["seconds"] == pytest.approx(0.3 / reference["realtime_factor"])  # of all, not of its 50 ms
    written = next(row for row in ours if row["method"] == "every sample, float32")
    assert written["seconds"] < reference["seconds"]
    assert written["error_db"] < min(row["error_db"] for row in ours if row["method"].startswith("every state"))
    assert (rival["error_db"], rival["note"]) == (None, "another model: time only")
    assert all(row["realtime_factor"] > 0.0 for row in rows)
    errors = {row["method"]: row["error_db"] for row in ours}
    assert all(error < 0.0 for error in errors.values())
    assert errors["within -40 dB"] < min(-40.0, errors["from a table, carriers kept"])
    assert errors["every state"] == pytest.approx(errors["every state, plain carriers"], abs=0.5)
    compared = [row for row in rows if row["ratio_to"]]
    assert compared == [row for row in rows if row["method"] != "every state"]
    assert {row["ratio_to"] for row in compared} == {"every state"}
    assert all(row["ratio"] > 0.0 for row in compared)


def test_layers_in_bfloat16_are_nearly_those_in_float32():
    pytest.importorskip("torch")
    from hnf_lab.bench import bfloat16
    from hnf_lab.bench.synth import evaluate_in_bfloat16

    field = load_field()
    x = np.random.default_rng(0).standard_normal((5, field.parameters["layer0.weight"].shape[1])).astype(np.float32)
    plain = network.run_network(field.parameters, field.config.layers, x)
    for exact, found in zip(
        plain, bfloat16.evaluate_heads_bfloat16(field.parameters, field.config.layers, x), strict=True
    ):
        assert found.dtype == np.float32
        off = np.sqrt(np.mean(np.square(found - exact)) / np.mean(np.square(exact)))
        assert 1e-5 < off < 2e-2
    exact, found = (
        prepare_stroke(field, make_scrape(1.0), seed=0, evaluator=each).amplitude
        for each in (evaluate, evaluate_in_bfloat16)
    )
    off = np.sqrt(np.mean(np.square(found - exact)) / np.mean(np.square(exact)))
    assert 1e-5 < off < 5e-2


def test_synthesis_methods_alternate_with_carriers_of_their_own(monkeypatch):
    """Three rounds of a cold and a warm one; forgetting is in no one's time, nor is what fills what is kept."""
    said, clock = [], iter(range(1000))

    def method(name: str, cold: bool) -> synth.SynthMethod:
        return synth.SynthMethod(name, lambda field, stroke, seed: said.append((name, seed)), cold)

    class Noted(Times):
        def measure(self, function):
            said.append("timed")
            return super().measure(function)

    monkeypatch.setattr(synth, "clear_carrier_caches", lambda: said.append("forgotten"))
    monkeypatch.setattr(synth, "Times", lambda _: Noted(lambda: float(next(clock))))
    times = synth._time_in_turn([method("cold", True), method("kept", False)], None, None, BenchOptions(repeats=3))
    kept = ("kept", synth.SEED)
    assert said == [
        each
        for number in (1, 2, 3)
        for each in ("forgotten", "timed", ("cold", synth.SEED + number), "forgotten", kept, "timed", kept)
    ]
    once, longer = times["kept"], times["kept"].scale(20.0)
    assert (longer.seconds.median, longer.cpu.median) == (20.0 * once.seconds.median, 20.0 * once.cpu.median)
    assert times["kept"].compute_ratio(times["cold"]) == Spread(1.0, 1.0, 1.0, 1.0, 3)


def test_the_texture_of_the_rivals_loop_is_one_of_its_own_kind():
    """Stable filters, triangles that fill the plane, silence on the axes, and the same draw for the same seed."""
    model, action = make_texture_model(), make_keyed_stroke(1.0).action
    corner = np.stack([model.speeds / model.max_speed, model.forces / model.max_force], axis=1)[model.triangles]
    sides = corner[:, 1:] - corner[:, :1]
    assert 0.5 * np.abs(np.linalg.det(sides)).sum() == pytest.approx(1.0)
    assert np.all(np.diff(model.ar_lsf, axis=1, prepend=0.0, append=np.pi) > 0.0)
    assert not model.variances[model.speeds * model.forces == 0.0].any()
    samples = synthesise_autoregressive(action, 1)
    assert samples.shape == (10_000,)
    assert np.std(samples) > 1e-3
    np.testing.assert_array_equal(samples, synthesise_autoregressive(action, 1))


def test_maps_have_an_error_beside_narrower_numbers(capsys):
    assert hnf("maps", "--quick", "--repeats", "1", "--json") == 0
    rows = {row["method"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["D_φ of one view in float32"]["error"] < 1e-5
    assert 0.0 < rows["E of an image in float16"]["error"] < 0.1
    assert all(row["seconds"] > 0.0 and row["peak_mb"] > 0.0 for row in rows.values())


def test_splat_images_match_the_reference_and_crops_cost_less(capsys):
    assert hnf("splats", "--quick", "--repeats", "1", "--json") == 0
    rows = json.loads(capsys.readouterr().out)
    reference, naive, one, two, *crops = rows
    assert [row["ratio_to"] for row in (reference, naive, one, two)] == [
        "",
        "",
        "a loop over splats",
        "a loop over splats",
    ]
    assert max(row["error"] for row in (one, two, *crops)) < 1e-4
    assert naive["error"] < 0.01  # float32 puts a splat on the other side of the cutoff here and there
    pairs = [row["work"]["pairs"] for row in (one, *crops)]
    assert pairs == sorted(pairs, reverse=True)
    assert pairs[-1] < pairs[0] / 10


def test_splats_are_measured_on_a_file_and_broken_ones_refused(tmp_path, capsys):
    from data_tools.write_splats import write_inria
    from hnf_lab.bench.splats import make_ball

    path = tmp_path / "ball.ply"
    write_inria(path, make_ball(50))
    assert hnf("splats", "--quick", "--repeats", "1", "--json", "--scene", str(path)) == 0
    assert sum("ball, 50 at" in row["method"] for row in json.loads(capsys.readouterr().out)) == 7
    path.write_bytes(path.read_bytes()[:-5])
    assert hnf("splats", "--quick", "--repeats", "1", "--scene", str(path)) == 1
    assert str(path) in capsys.readouterr().err
