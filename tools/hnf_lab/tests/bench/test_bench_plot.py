"""`hnf bench --plot`: the Pareto front, the growth of cost, and a readable plot."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hnf_core.cli.main import build_parser, main
from hnf_core.errors import UsageError
from hnf_lab.bench.harness import (
    Bench,
    CurvePosition,
    Row,
    Spread,
    add_exponents,
    fit_exponent,
    format_duration,
    format_rows,
    group_curves,
)
from hnf_lab.bench.plots import (
    MARK_PX,
    Point,
    crosses_box,
    dominates,
    find_pareto_front,
    group_trade_offs,
    lay_out,
    lay_out_labels,
    make_decibel_axis,
    make_leader,
    make_log_axis,
    overlaps_any,
    write_plot,
)
from hnf_lab.cli.bench import run_benches

ERRORS = st.one_of(st.floats(-300.0, 10.0), st.just(-math.inf), st.sampled_from([-40.0, -60.0]))
TIMES = st.one_of(st.floats(1e-6, 1e3), st.sampled_from([0.1, 1.0]))
POINTS = st.lists(st.builds(Point, st.text("abc ", min_size=1, max_size=20), ERRORS, TIMES), min_size=1, max_size=20)


def second(value: float) -> Spread:
    return Spread.from_values([value])


@given(POINTS)
@example([Point("a", -40.0, 1.0), Point("b", -40.0, 1.0), Point("c", -40.0, 2.0)])
def test_the_pareto_front_holds_exactly_the_undominated_points(points):
    front = find_pareto_front(points)
    assert front
    assert not [point for point in front if any(dominates(other, point) for other in points)]
    left = [point for point in points if point not in front]
    assert all(any(dominates(best, point) for best in front) for point in left)
    assert sorted([*front, *left], key=repr) == sorted(points, key=repr)


@given(POINTS, st.randoms(use_true_random=False))
def test_the_front_does_not_follow_the_order(points, random):
    shuffled = random.sample(points, len(points))
    assert {(point.error, point.time) for point in find_pareto_front(shuffled)} == {
        (point.error, point.time) for point in find_pareto_front(points)
    }


@given(
    st.lists(st.tuples(st.floats(0, 700), st.floats(0, 900)), min_size=1, max_size=12),
    st.lists(st.integers(3, 25), min_size=12, max_size=12),
)
def test_labels_lie_over_no_mark_and_no_other_label(anchors, letters):
    sizes = np.array([(7.0 * letters[k], 16.0) for k in range(len(anchors))])
    frame, line = (0.0, 0.0, 784.0, 1000.0), (0.0, 480.0, 784.0, 484.0)
    placed = lay_out_labels(np.array(anchors), sizes, frame, [line])
    if placed is None:
        return  # the panel grows then: see below
    boxes = placed.boxes
    marks = [(x - MARK_PX, y - MARK_PX, x + MARK_PX, y + MARK_PX) for x, y in anchors]
    for k, box in enumerate(boxes):
        assert not overlaps_any(box, [*boxes[:k], *boxes[k + 1 :], *marks, line])
        assert (box[2] - box[0], box[3] - box[1]) == pytest.approx(tuple(sizes[k]))
        assert frame[0] <= box[0]
        assert box[2] <= frame[2]
        assert frame[1] <= box[1]
        assert box[3] <= frame[3]


def test_a_name_goes_where_its_line_runs_over_no_other_name():
    """Points close together, as the methods of synthesis are."""
    anchors = [(560, 60), (560, 175), (560, 284), (624, 145), (624, 277), (624, 280), (656, 308), (742, 368)]
    sizes = np.array([(150.0, 16.0)] * len(anchors))
    placed = lay_out_labels(np.array(anchors, dtype=float), sizes, (0.0, 0.0, 784.0, 500.0))
    assert placed is not None
    assert placed.crossed == 0
    for k, (anchor, box) in enumerate(zip(anchors, placed.boxes, strict=True)):
        for other in (*placed.boxes[:k], *placed.boxes[k + 1 :]):
            assert not crosses_box(make_leader(anchor, box), other)


@given(st.tuples(*[st.floats(-9.0, 9.0)] * 4))
def test_a_line_enters_a_box_where_one_of_its_points_does(ends):
    line, box = ((ends[0], ends[1]), (ends[2], ends[3])), (-3.0, -2.0, 4.0, 5.0)
    share = np.linspace(0.0, 1.0, 4001)
    x, y = (line[0][axis] + share * (line[1][axis] - line[0][axis]) for axis in range(2))
    wide = ((x > box[0] - 0.01) & (x < box[2] + 0.01) & (y > box[1] - 0.01) & (y < box[3] + 0.01)).any()
    narrow = ((x > box[0] + 0.01) & (x < box[2] - 0.01) & (y > box[1] + 0.01) & (y < box[3] - 0.01)).any()
    assert narrow <= crosses_box(line, box) <= wide


@given(POINTS)
def test_a_panel_grows_until_every_label_has_room(points):
    rows = [Row("b", each.method, second(each.time), error=each.error, error_unit="dB") for each in points]
    (trade,) = group_trade_offs(rows)
    drawing = lay_out(trade)
    assert len(drawing.labels) == len(points) == len(trade.points)
    assert all(not overlaps_any(box, drawing.labels[:k]) for k, box in enumerate(drawing.labels))
    assert all(drawing.error.low < drawing.error.to_position(each.error) < drawing.error.high for each in points)
    assert all(drawing.time.low < drawing.time.to_position(each.time) < drawing.time.high for each in points)


def test_too_many_names_for_one_panel_are_refused():
    with pytest.raises(UsageError, match="do not fit"):
        lay_out(group_trade_offs([Row("b", "n" * 200, second(1.0), error=1.0)])[0])


def test_each_panel_measures_time_as_most_of_its_rows_do():
    rows = [
        Row("synth", "reference", error=-math.inf, error_unit="dB", realtime_factor=0.5),
        Row("synth", "fast", second(1.0), error=-40.0, error_unit="dB", realtime_factor=100.0),
        Row("synth", "odd", second(1.0), error=math.nan, error_unit="dB", realtime_factor=100.0),
        Row("preview", "whole", second(2.0), error=0.0, error_unit="m"),
        Row("preview", "part", second(1.0), ratio=second(0.5), ratio_to="whole", error=0.0, error_unit="m"),
        Row("pairs", "whole", error=0.0, error_unit="m"),
        Row("pairs", "part", ratio=second(0.25), ratio_to="whole", error=0.1, error_unit="m"),
        Row("timeless", "x", error=1.0),
        Row("faultless", "x", second(1.0)),
    ]
    synth, preview, pairs = group_trade_offs(rows)
    assert [(point.method, point.time) for point in synth.points] == [("reference", 2.0), ("fast", 0.01)]
    assert synth.omitted == 1
    assert [point.time for point in preview.points] == [1.0, 0.5]
    assert [(point.time, point.error) for point in pairs.points] == [(1.0, 0.0), (0.25, 0.1)]


@given(st.floats(-2.0, 3.0), st.floats(1e-3, 1e3), st.lists(st.integers(1, 10**6), min_size=2, max_size=8, unique=True))
def test_the_exponent_of_a_power_is_its_own(power, factor, sizes):
    found = fit_exponent(sizes, [factor * size**power for size in sizes])
    if sum(size >= max(sizes) / 100.0 for size in sizes) < 2:
        assert found is None
    else:
        assert (found.lowest, found.median, found.highest) == pytest.approx((power,) * 3, abs=1e-6 * max(sizes))


def test_the_exponent_is_of_the_upper_decades():
    sizes = (1, 10, 100, 1000, 10_000)
    found = fit_exponent(sizes, [5.0, 5.0, 5.0, 50.0, 500.0])
    assert (found.median, found.count) == (pytest.approx(1.0), 3)
    assert fit_exponent([], []) is None
    assert fit_exponent([10.0, 10.0], [1.0, 2.0]) is None


def sized(count: float, time: float, line: str = "own meshes") -> Row:
    size = CurvePosition("objects", line, count)
    return Row("scale", f"{count}", cpu=second(time), size=size, work={"renders": 3, "rays": 4000})


def test_the_largest_of_a_line_tells_its_exponent():
    rows = add_exponents([
        sized(1, 1.0), sized(10, 10.0), sized(1, 2.0, "one mesh"), sized(10, 2.0, "one mesh"),
        Row("scale", "not run", size=CurvePosition("objects", "own meshes", 100.0)),
    ])  # fmt: skip
    assert [row.exponent and round(row.exponent.median, 9) for row in rows] == [None, 1.0, None, 0.0, None]
    ((own, shared),) = (curve.lines for curve in group_curves(rows))
    assert ([point.count for point in own.points], own.exponent, shared.exponent) == ([1, 10], pytest.approx(1.0), 0.0)
    text = format_rows(rows, {})
    assert "3 renders, 4,000 rays" in text
    assert "1.00 (1–1)" in text
    record = json.loads(json.dumps(rows[1].to_json()))
    assert (record["size"]["count"], record["work"]["rays"]) == (10, 4000)
    assert record["exponent"] == pytest.approx(1.0)


@given(st.lists(st.floats(1e-9, 1e9) | st.just(0.0), min_size=1, max_size=9))
def test_marks_of_an_axis_rise_and_lie_on_it(values):
    axis = make_log_axis(values, format_duration)
    places = [place for place, _ in axis.ticks]
    assert places == sorted(set(places))
    assert all(axis.low <= place <= axis.high for place in places)
    assert all(axis.low < axis.to_position(value) < axis.high for value in values)
    assert (0.0 in values) == ("0" in [text for _, text in axis.ticks])


def test_an_exact_method_is_marked_in_decibels_too():
    axis = make_decibel_axis([-math.inf, -60.0, -40.0])
    assert axis.ticks[0] == (axis.to_position(-math.inf), "−∞")
    assert axis.to_position(-math.inf) < axis.to_position(-60.0) < axis.to_position(-40.0)


ROWS = [
    Row("synth", "per sample", error=-math.inf, error_unit="dB", realtime_factor=0.5),
    Row("synth", "fast", error=-40.0, error_unit="dB", realtime_factor=100.0),
    *(sized(count, 2.0 + 1e-4 * count) for count in (1, 100, 10_000)),
]


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_plot_is_written_and_equal_rows_give_equal_bytes(tmp_path, suffix):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    for name in ("a", "b"):
        write_plot(tmp_path / f"{name}{suffix}", ROWS)
    data = (tmp_path / f"a{suffix}").read_bytes()
    assert data == (tmp_path / f"b{suffix}").read_bytes()
    assert data.startswith(b"\x89PNG" if suffix == ".png" else b"<?xml")


def test_names_as_they_are_drawn_lie_over_each_other_nowhere(monkeypatch, tmp_path):
    """Letters are estimated before; this measures what matplotlib makes of them."""
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from hnf_lab.bench import plots

    boxes = []

    def measure(path, size, draw):
        figure = Figure(figsize=(size[0] / 100, size[1] / 100), dpi=100)
        canvas = FigureCanvasAgg(figure)
        draw(figure)
        renderer = canvas.get_renderer()
        boxes.extend(tuple(text.get_tightbbox(renderer).extents) for text in figure.axes[0].texts)

    # Without leaders: they end at the points, which is meant.
    monkeypatch.setattr(plots, "LEADER_STYLE", None)
    monkeypatch.setattr(plots, "write_figure", measure)
    names = ("float64 per sample", "float32, blocks of 4096", "table", "WWWWWWWWWWWW", "adaptive, 1e-3", "hops")
    rows = [Row("b", name, second(1.0 + 1e-3 * k), error=1e-3, error_unit="m") for k, name in enumerate(names)]
    write_plot(tmp_path / "x.png", rows)
    assert len(boxes) == len(names)
    assert not [k for k, box in enumerate(boxes) if overlaps_any(box, boxes[:k])]


def bench(tmp_path, *words: str) -> int:
    pytest.importorskip("matplotlib", reason="pictures need matplotlib")
    arguments = build_parser(lambda _: 1).parse_args(["bench", *words])
    return run_benches(arguments, [Bench("it", "…", lambda options: ROWS)])


def test_the_command_prints_and_draws(tmp_path, capsys):
    assert bench(tmp_path, "it", "--json", "--plot", str(tmp_path / "plot.png")) == 0
    assert len(json.loads(capsys.readouterr().out)) == len(ROWS)
    assert (tmp_path / "plot.png").stat().st_size > 5000


def test_other_plot_formats_are_refused_before_measuring(tmp_path, capsys):
    assert main(["bench", "faults", "--plot", str(tmp_path / "plot.pdf")], lambda arguments: 1) == 2
    assert ".svg" in capsys.readouterr().err


def test_nothing_to_draw_is_said(tmp_path):
    with pytest.raises(UsageError, match="nothing to plot"):
        write_plot(tmp_path / "plot.png", [Row("b", "said")])
