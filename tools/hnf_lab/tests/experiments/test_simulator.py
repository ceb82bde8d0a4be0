"""Statistics of the simulator against recorded ranges, and the tables of the documentation page."""

from __future__ import annotations

import numpy as np
import pytest

from hnf_lab.evaluation.texture_statistics import TextureStatistics, aggregate_strokes
from hnf_lab.experiments.simulator import HATT_RANGES, check_ranges, compute_instrument_noise, fill_markers, make_row

MIDDLE = TextureStatistics(1.0, 1.0, 1.0, 250.0, 0.97, 0.9, 0.2)


def test_range_checks_round_to_the_published_decimals():
    limits = HATT_RANGES["Wood"].below_1k
    assert limits == (0.95, 0.99)
    just, over = (TextureStatistics(0.8, 0.8, 0.8, 250.0, share, 0.9, 0.2) for share in (0.9949, 0.9951))
    assert check_ranges(just, "Wood")["below_1k"]
    assert not check_ranges(over, "Wood")["below_1k"]
    assert set(check_ranges(MIDDLE, "Carbon fibre")) == {"rms", "centroid_hz", "below_1k", "v_exponent"}
    assert check_ranges(MIDDLE, "") == {}


def test_instrument_noise_matches_soft_recordings_at_high_bands():
    frequency = np.arange(10.0, 5000.0)
    density = compute_instrument_noise(frequency)
    assert np.sqrt(density[frequency >= 1300.0].sum()) == pytest.approx(0.12, rel=0.03)
    silence = aggregate_strokes(np.zeros((10, len(frequency))), frequency, compute_instrument_noise)
    assert 1500.0 < silence.centroid_hz < 3000.0
    assert silence.v_exponent == pytest.approx(0.0, abs=1e-9)


def test_a_row_lists_shares_and_medians_with_recorded_ones():
    outside = TextureStatistics(10.0, 10.0, 10.0, 250.0, 0.97, 0.9, 0.2)
    felt = [MIDDLE, MIDDLE, outside, MIDDLE]
    row = make_row("Wood", 2, felt, [check_ranges(each, "Wood") for each in felt], True)
    assert row[3] == "1.00 (0.79)"
    assert row[7:] == ["75 %", "100 %", "100 %", "100 %", "100 %", "95 %", "75 %"]


def test_tables_go_between_their_markers_and_nowhere_else(tmp_path):
    document = tmp_path / "page.md"
    document.write_text("before\n<!-- a -->\nold\n<!-- /a -->\nafter\n")
    fill_markers(document, {"a": "| new \\1 |"})
    assert document.read_text() == "before\n<!-- a -->\n| new \\1 |\n<!-- /a -->\nafter\n"
    with pytest.raises(SystemExit, match="markers"):
        fill_markers(document, {"b": "x"})
