"""The synthesis rule of HaTT, its published figures, and a local copy of the toolkit."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hatt_files import HATT, TRIANGLES, model_xml, needs_hatt, read, values
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.synthetic_actions import make_random_smooth_action, make_steady_action
from hnf_core.datasets.hatt_models import (
    HattProcess,
    _build_states,
    _draw_noise,
    interpolate_filters,
    polynomial_from_lsf,
    read_texture_model,
    synthesise_autoregressive,
)
from hnf_core.datasets.registry import open_dataset
from hnf_core.errors import FileError, MaterialError, UsageError
from hnf_core.metrics.spectra import welch
from hnf_lab.baselines.piecewise_ar import compute_power_spectrum
from reference.hatt_reference import compute_rms_and_centroid, synthesise_reference

# --- interpolation -----------------------------------------------------------------------------------------------


def test_filters_are_exact_at_vertices_and_linear_in_between(tmp_path):
    model = read(tmp_path)
    at = interpolate_filters(model, [0.1, 0.15], [2.0, 2.0])
    np.testing.assert_allclose(at.ar_lsf[0], model.ar_lsf[4])
    np.testing.assert_allclose(at.variance[0], model.variances[4])
    np.testing.assert_allclose(at.ar_lsf[1], 0.5 * (model.ar_lsf[4] + model.ar_lsf[5]))
    np.testing.assert_allclose(at.variance[1], 0.5 * (model.variances[4] + model.variances[5]))
    assert not at.clamped_speed.any()


@settings(max_examples=100, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 20.0))
def test_any_speed_and_force_gives_a_stable_filter(tmp_path_factory, speed, force):
    path = tmp_path_factory.getbasetemp() / "model.xml"
    if not path.is_file():
        path.write_text(model_xml(), encoding="utf-8")
    at = interpolate_filters(read_texture_model(path), speed, force)
    assert np.abs(np.roots(polynomial_from_lsf(at.ar_lsf)[0])).max() < 1.0
    assert at.weights.min() >= 0.0
    assert at.weights.sum() == pytest.approx(1.0)
    assert bool(at.clamped_speed[0]) == (speed > 0.2 * (1.0 + 1e-9))
    assert bool(at.clamped_force[0]) == (force > 4.0 * (1.0 + 1e-9))


def test_speed_outside_the_hull_is_clamped_with_a_note(tmp_path):
    model = read(tmp_path)
    assert compute_power_spectrum(model, 0.9, 1.0, 300.0) == compute_power_spectrum(model, 0.2 - 1e-5, 1.0, 300.0)
    notes = HattProcess(model).record([make_steady_action(0.5, 0.3, 1.0)], 0)[0].notes
    assert notes == ("speed above 0.2 m/s taken as that, 100.0 % of the time",)
    assert HattProcess(model).record([make_steady_action(0.5, 0.2, 1.0)], 0)[0].notes == ()


def test_a_hull_that_leaves_a_corner_out_clamps_to_its_rim(tmp_path):
    # without the two triangles at the far corner, (200 mm/s, 4 N) is outside though within both maxima
    model = read(tmp_path, swap=[(f'<tri type="array">{values(t)}</tri>', "") for t in TRIANGLES[6:]] + [
        ("<numTri>8<", "<numTri>6<")])  # fmt: skip
    at = interpolate_filters(model, 0.19, 3.9)
    assert at.clamped_speed.all()
    assert at.weights.min() >= 0.0


# --- spectrum and signal -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("ma_order", [0, 4])
def test_the_signals_spectrum_is_the_exact_one(tmp_path, ma_order):
    model = read(tmp_path, ma_order=ma_order)
    recordings = HattProcess(model).record([make_steady_action(2.0, 0.13, 2.5)] * 24, 5)
    frequency, density = welch(np.concatenate([r.samples for r in recordings]), 10_000.0)
    exact = compute_power_spectrum(model, 0.13, 2.5, frequency)
    off = 10.0 * np.log10(density[5:-5] / exact[5:-5])
    assert abs(off.mean()) < 0.1
    assert off.std() < 0.35  # ~950 windows: 4.3 / sqrt(950) = 0.14 dB
    rms = np.sqrt(np.mean([np.square(r.samples) for r in recordings]))
    assert rms == pytest.approx(compute_rms_and_centroid(model, 0.13, 2.5)[0], rel=0.01)


@pytest.mark.parametrize("ma_order", [0, 4])
def test_the_rms_is_that_of_the_impulse_response(tmp_path, ma_order):
    model = read(tmp_path, ma_order=ma_order)
    at = interpolate_filters(model, 0.13, 2.5)
    a, b = polynomial_from_lsf(at.ar_lsf)[0], at.gain[0] * polynomial_from_lsf(at.ma_lsf)[0]
    response = np.zeros(5000)
    for n in range(len(response)):
        driven = b[n] if n < len(b) else 0.0
        response[n] = driven - sum(a[i] * response[n - i] for i in range(1, min(n, len(a) - 1) + 1))
    exact = np.sqrt(at.variance[0] * np.square(response).sum())
    assert compute_rms_and_centroid(model, 0.13, 2.5)[0] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize("ma_order", [0, 4])
def test_the_fast_recursion_equals_the_rule_as_written(tmp_path, ma_order):
    model = read(tmp_path, ma_order=ma_order)
    actions = [make_random_smooth_action(0.2, seed, speed_m_s=(0.02, 0.3), force_n=(0.2, 5.0)) for seed in range(3)]
    states = _build_states(model, actions)
    noise = np.stack([_draw_noise(4, index, states.samples + states.warm_up) for index in range(3)], axis=1)
    plain = synthesise_reference(states, noise)
    assert plain.std() > 0.05
    np.testing.assert_allclose(synthesise_autoregressive(states, noise), plain, rtol=0.0, atol=1e-10 * plain.std())


def test_a_seed_fixes_the_signal_and_company_does_not_change_it(tmp_path):
    process = HattProcess(read(tmp_path))
    actions = [make_random_smooth_action(0.3, seed, speed_m_s=(0.05, 0.2), force_n=(0.5, 3.0)) for seed in range(4)]
    together, alone = process.record(actions, 1), process.record(actions[:1], 1)
    # numpy sums a single column in another order than many: to rounding, not to the bit
    np.testing.assert_allclose(together[0].samples, alone[0].samples, rtol=0.0, atol=1e-12)
    assert process.record(actions, 1)[2].samples.tobytes() == together[2].samples.tobytes()
    other = process.record(actions, 2)[0].samples
    assert abs(np.corrcoef(other, together[0].samples)[0, 1]) < 0.1
    assert abs(np.corrcoef(together[1].samples, together[0].samples)[0, 1]) < 0.1


def test_no_contact_is_silent_and_unequal_lengths_are_refused(tmp_path):
    process = HattProcess(read(tmp_path))
    assert np.all(process.record([make_steady_action(0.5, 0.1, 0.0)], 0)[0].samples == 0.0)
    with pytest.raises(UsageError, match="equally long"):
        process.record([make_steady_action(0.5, 0.1, 1.0), make_steady_action(0.6, 0.1, 1.0)], 0)
    with pytest.raises(UsageError, match="equally long"):
        process.record([], 0)


def test_a_1_khz_model_comes_out_at_10_khz_and_says_so(tmp_path):
    model = read(tmp_path, ma_order=4, rate="1000")
    recording = HattProcess(model).record([make_steady_action(20.0, 0.13, 2.5)], 3)[0]
    assert recording.samples.shape == (200_000,)
    assert "resampled" in recording.notes[0]
    frequency, density = welch(recording.samples, 10_000.0)
    band = (frequency >= 50.0) & (frequency <= 400.0)
    off = 10.0 * np.log10(density[band].sum() / compute_power_spectrum(model, 0.13, 2.5, frequency[band]).sum())
    assert abs(off) < 0.3


# --- the folder --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["Models10000Hz/XML", "models_10khz", "", "HaTT/10 kHz"])
def test_a_folder_of_any_arrangement_is_understood(tmp_path, layout):
    (tmp_path / layout).mkdir(parents=True, exist_ok=True)
    (tmp_path / "Models1000Hz/XML").mkdir(parents=True)
    (tmp_path / "TextureImages").mkdir()
    (tmp_path / layout / "Models_Test_Cloth.xml").write_text(model_xml(), encoding="utf-8")
    (tmp_path / "Models1000Hz/XML/Models_Test Cloth.xml").write_text(model_xml(ma_order=4, rate="1000"))
    (tmp_path / "notes.xml").write_text("<notes/>")
    (tmp_path / "TextureImages/Test Cloth_square.bmp").write_bytes(b"BM")
    data = open_dataset("hatt", tmp_path)
    assert data.materials == ("Test Cloth",)
    process = data.process("test_CLOTH")
    assert (process.name, process.model.sample_rate) == ("Test Cloth", 10_000.0)
    assert data.action_range("testcloth").speed_m_s == pytest.approx((0.1, 0.2))
    assert data.action_range("testcloth").force_n == pytest.approx((2.0, 4.0))
    assert data.image("test cloth") == tmp_path / "TextureImages/Test Cloth_square.bmp"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "Models_Pipe.xml")
    (tmp_path / "Models_Cork.xml").write_text(model_xml())
    assert open_dataset("hatt", tmp_path).materials == ("Cork",)


def test_unknown_names_kinds_and_folders_are_refused(tmp_path):
    (tmp_path / "Models_Cork.xml").write_text(model_xml())
    data = open_dataset("hatt", tmp_path)
    assert data.image("Cork") is None
    with pytest.raises(MaterialError, match="Near ones: Cork"):
        data.process("corck")
    with pytest.raises(MaterialError, match="There are: Cork"):
        data.process("../../../../etc/passwd")
    with pytest.raises(UsageError, match="no data set"):
        open_dataset("hat", tmp_path)
    with pytest.raises(UsageError, match="needs the folder"):
        open_dataset("hatt", None)
    with pytest.raises(FileError, match="no folder"):
        _ = open_dataset("hatt", tmp_path / "none").materials
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileError, match="neither texture models"):
        _ = open_dataset("hatt", tmp_path / "empty").materials


# --- the real files ----------------------------------------------------------------------------------------------

REFERENCE = {
    ("ABS Plastic", 100, 1): ([3, 9, 10], [0.2610, 0.1388, 0.6002], 0.046521, 3.302, 166),
    ("Brick 1", 100, 1): ([25, 33, 34], [0.2435, 0.7463, 0.0102], 1.191072, 13.77, 513),
    ("Brick 1", 200, 1): ([17, 28, 38], None, None, 22.09, 443),
    ("Silk 1", 100, 1): ([4, 9, 14], None, 0.010701, 0.328, 463),
    ("Cork", 200, 1): ([18, 23, 30], None, 0.045356, 2.014, None),
    ("Carpet 1", 100, 1): ([13, 18, 21], None, None, 3.694, 50),
}


@needs_hatt
@pytest.mark.parametrize("condition", REFERENCE, ids=str)
def test_the_published_figures_are_met(condition):
    name, speed, force = condition
    triangle, weights, variance, rms, centroid = REFERENCE[condition]
    model = open_dataset("hatt", HATT).process(name).model
    at = interpolate_filters(model, speed * 1e-3, force)
    assert (model.triangles[at.triangle[0]] + 1).tolist() == triangle
    if weights is not None:
        np.testing.assert_allclose(at.weights[0], weights, atol=6e-5)
    if variance is not None:
        assert at.variance[0] == pytest.approx(variance, abs=6e-7)
    measured = compute_rms_and_centroid(model, speed * 1e-3, force)
    assert measured[0] == pytest.approx(rms, rel=3e-3)
    if centroid is not None:
        assert measured[1] == pytest.approx(centroid, abs=1.0)


@needs_hatt
def test_sandpaper_at_200_mm_s_is_outside_its_hull():
    assert interpolate_filters(open_dataset("hatt", HATT).process("sandpaper 100").model, 0.2, 1.0).clamped_speed.all()


@needs_hatt
def test_every_texture_can_be_stroked_over_its_whole_range():
    data = open_dataset("hatt", HATT)
    assert data.materials
    for name in data.materials:
        where = data.action_range(name)
        action = make_random_smooth_action(0.5, 1, speed_m_s=where.speed_m_s, force_n=where.force_n)
        recording = data.process(name).record([action], 0)[0]
        assert recording.notes == ()
        assert recording.samples.std() > 0.01
        assert data.image(name) is not None


@needs_hatt
@pytest.mark.parametrize("name", ["ABS Plastic", "Brick 1", "Cork"])
def test_both_rates_of_a_texture_agree_at_low_frequencies(name):
    folders = (HATT / "models_10khz", HATT / "models_1khz")
    fine, coarse = (open_dataset("hatt", folder).process(name).model for folder in folders)
    assert (fine.sample_rate, coarse.sample_rate) == (10_000.0, 1000.0)
    frequency = np.arange(20.0, 120.0, 10.0)
    ratio = compute_power_spectrum(coarse, 0.1, 1.0, frequency) / compute_power_spectrum(fine, 0.1, 1.0, frequency)
    assert np.abs(10.0 * np.log10(ratio)).max() < 1.0
