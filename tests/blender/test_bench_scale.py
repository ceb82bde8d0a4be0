"""`hnf bench scale`: its counted work. No time is asserted."""

from __future__ import annotations

from hnf_blender.bench import scale
from hnf_core.bench.frame import Options
from hnf_core.bench.growth import grown


def test_others_beside_a_touched_object_cost_no_work(tmp_path):
    alone, own = scale.among_others(Options(repeats=1, quick=True), tmp_path)
    assert own.work == alone.work == {"renders": 2, "rays": alone.work["rays"], "F_Θ calls": 1}
    assert (own.ratio_to, own.ratio.count) == (alone.method, 1)


def test_work_follows_what_is_touched(tmp_path):
    """Not the faces or the other materials of an object; strokes over one place share its close-up."""
    options = Options(repeats=1, quick=True)
    lines = {line.name: line for line in (*scale.faces(options, tmp_path), *scale.touched(options, tmp_path))}
    work = {name: grown("scale", line, options)[-1].work for name, line in lines.items()}
    close_up = work["of the touched object"]
    assert close_up["renders"] == close_up["F_Θ calls"] == 1
    assert work["on the touched object"] == close_up
    apart, shared = work["over places of their own"], work["over one place"]
    assert (apart["renders"], apart["F_Θ calls"], apart["rays"]) == (2, 2, 2 * close_up["rays"])
    assert (shared["renders"], shared["F_Θ calls"]) == (1, 2)
    assert shared["rays"] < 1.01 * close_up["rays"]
