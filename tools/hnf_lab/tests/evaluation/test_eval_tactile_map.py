"""The report on predicted tactile maps: perfect maps score perfectly, and errors have their size."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_pairs import synthetic_pairs
from tactile_networks import SMALL, random_parameters

from hnf_core.action.synthetic_actions import make_steady_action
from hnf_core.cli.main import main
from hnf_core.datasets import pair_generation
from hnf_core.datasets.pair_generation import PairSizes, list_tile_requests, render_tile
from hnf_core.datasets.tactile_pairs import HELD_OUT_CLASSES, HELD_OUT_INSTANCES, decode_rgb
from hnf_core.errors import FileError, SceneError, UsageError
from hnf_core.export.formats import FORMATS
from hnf_core.export.options import ExportOptions
from hnf_core.field.weights import load_field
from hnf_core.material.encoder_registry import get_encoder
from hnf_core.material.library import get_material
from hnf_core.material.token import ENCODER_ID, LEVELS, TOKEN_DIM, Token
from hnf_core.progress import count_work
from hnf_core.signal import Signal
from hnf_core.tactile.unet import DIFFUSION, REGRESSION, MapConfig, load_map_weights, save_map_weights
from hnf_core.tactile.views import AppearanceView
from hnf_lab.bootstrap import bootstrap_mean, bootstrap_ratio
from hnf_lab.evaluation.held_out import KnownMaterial, predict_spectrum
from hnf_lab.evaluation.tactile_map import run, score, tiles
from hnf_lab.evaluation.tactile_map import tiles as predictions
from hnf_lab.evaluation.tactile_map.end_to_end import (
    EDGES_HZ,
    compare_networks,
    compare_octaves,
    format_networks,
    networks_to_json,
)
from hnf_lab.evaluation.tactile_map.naive_baselines import (
    GREY_HEIGHT_M,
    compute_grey_slopes,
    fit_grey_m,
    fit_naive_baselines,
)
from hnf_lab.evaluation.tactile_map.report import compute_excess, make_tables, report_to_json, write_plots
from hnf_lab.evaluation.tactile_map.run import MapSetup, MapSizes, make_network_entries, measure_maps
from hnf_lab.evaluation.tactile_map.score import (
    SSIM_SIDE,
    SSIM_SIGMA,
    compute_normal_angle_deg,
    compute_psnr_db,
    compute_spectrum_error,
    compute_ssim,
    predict_long_run_spectra,
    score_images,
    score_spectra,
)
from hnf_lab.evaluation.tactile_map.tiles import ArrayCache
from hnf_lab.shared_field.simulated_strokes import make_middle_conditions, make_speed_grid

pytestmark = pytest.mark.filterwarnings("error")
SEED = st.integers(0, 2**31)
ENCODER = get_encoder(ENCODER_ID)
SIZES = MapSizes(
    instances=1, classes=1, varied=1, all_pitches=1, curve=1, steps=2, curve_steps=(1, 2), guidance=(1.0, 2.0), made=2
)  # fmt: skip
NAMES = {DIFFUSION: "predicted (diffusion, 2 steps)", REGRESSION: "predicted (regression)"}


def picture(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(size=shape)


@given(SEED, st.floats(1e-3, 0.5), st.floats(0.5, 300.0))
def test_psnr_of_a_constant_difference(seed: int, difference: float, data_range: float) -> None:
    image = picture(seed, 8, 9, 3)
    assert compute_psnr_db(image, image, data_range) == np.inf
    assert compute_psnr_db(image + difference, image, data_range) == pytest.approx(
        20.0 * np.log10(data_range / difference)
    )


@given(SEED)
@settings(max_examples=20)
def test_ssim_is_one_for_equal_images_and_symmetric(seed: int) -> None:
    one, other = picture(seed, 16, 14), picture(seed + 1, 16, 14)
    assert compute_ssim(one, one, 1.0) == pytest.approx(1.0)
    assert compute_ssim(one, other, 1.0) == pytest.approx(compute_ssim(other, one, 1.0))
    assert compute_ssim(one, other, 1.0) < 0.9


def test_similarity_of_constants_by_hand() -> None:
    """No variance: only the luminance term is left, with C1 = (0.01 · 255)² = 6.5025."""
    one, other = np.full((12, 12), 100.0), np.full((12, 12), 120.0)
    assert compute_ssim(one, other, 255.0) == pytest.approx(
        (2 * 100 * 120 + 6.5025) / (100**2 + 120**2 + 6.5025), abs=1e-9
    )


def test_similarity_is_what_the_published_formula_says() -> None:
    """Equation 13 written out, window by window, in loops."""
    one, other = 255.0 * picture(1, 13, 12), 255.0 * picture(2, 13, 12)
    place = np.arange(SSIM_SIDE) - 5
    weight = np.exp(-(place[:, None] ** 2 + place[None, :] ** 2) / (2 * SSIM_SIGMA**2))
    weight /= weight.sum()
    values = []
    for row in range(3):
        for column in range(2):
            x, y = (each[row : row + SSIM_SIDE, column : column + SSIM_SIDE] for each in (one, other))
            mx, my = (weight * x).sum(), (weight * y).sum()
            vx, vy, cov = ((weight * a * b).sum() for a, b in ((x - mx, x - mx), (y - my, y - my), (x - mx, y - my)))
            values.append((2 * mx * my + 6.5025) * (2 * cov + 58.5225)
                          / ((mx**2 + my**2 + 6.5025) * (vx + vy + 58.5225)))  # fmt: skip
    assert compute_ssim(one, other, 255.0) == pytest.approx(np.mean(values), rel=1e-9)
    coloured = [np.stack([each, each], axis=-1) for each in (one, other)]
    assert compute_ssim(*coloured, 255.0) == pytest.approx(np.mean(values), rel=1e-9)


def test_pictures_that_cannot_be_compared_are_refused() -> None:
    for call in (lambda: compute_psnr_db(np.zeros((3, 3)), np.zeros((3, 4)), 1.0), lambda: compute_ssim(np.zeros((5,
    5)),
                 np.zeros((5, 5)), 1.0), lambda: compute_psnr_db(np.zeros((3, 3)), np.zeros((3, 3)), 0.0)):  # fmt: skip
        with pytest.raises(UsageError):
            call()


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5))
def test_angles_between_normals(gx: float, gy: float) -> None:
    slopes = np.broadcast_to(np.array([gx, gy])[:, None, None], (2, 4, 4))
    assert compute_normal_angle_deg(slopes, slopes) == 0.0
    tilt = np.degrees(np.arctan(np.hypot(gx, gy)))
    assert compute_normal_angle_deg(slopes, np.zeros((2, 4, 4))) == pytest.approx(tilt, abs=1e-9)
    assert compute_normal_angle_deg(slopes, -slopes) == pytest.approx(2.0 * tilt, abs=1e-9)


@given(SEED, st.floats(-20.0, 20.0))
@settings(max_examples=20)
def test_a_gain_is_all_level_and_nothing_shape(seed: int, gain_db: float) -> None:
    spectra = np.exp(np.random.default_rng(seed).normal(0.0, 1.0, (6, 100)))
    error = compute_spectrum_error(spectra * 10.0 ** (gain_db / 10.0), spectra)
    assert error.bias == pytest.approx(gain_db, abs=1e-9)
    assert (error.total, error.level) == (pytest.approx(abs(gain_db)), pytest.approx(abs(gain_db)))
    assert error.shape == pytest.approx(0.0, abs=1e-6)
    other = compute_spectrum_error(
        spectra[:1] * np.exp(np.random.default_rng(seed + 1).normal(0.2, 1.0, (1, 100))), spectra[:1]
    )
    assert other.total**2 == pytest.approx(other.level**2 + other.shape**2)


def test_spectra_are_those_of_whole_steady_strokes() -> None:
    """The batch by states beside evaluation.held_out.expected, which walks through an action and its start."""
    field, one = load_field(), get_material("denim")
    batch = predict_long_run_spectra(
        field, np.stack([one.token, get_material("cork").token]), [one.mechanics, get_material("cork").mechanics]
    )
    for number, each in enumerate(make_middle_conditions()):
        action = make_steady_action(2.0, float(make_speed_grid()[each.speed]), each.force, each.angle)
        known = KnownMaterial("denim", "fabric", one.token, one.mechanics, np.ones(501))
        np.testing.assert_allclose(batch[0, number], predict_spectrum(field, known, action), rtol=2e-3)


@pytest.fixture(scope="module")
def tile() -> tiles.HeldOutTile:
    first, second = list_tile_requests(HELD_OUT_CLASSES, PairSizes(), 0)[:2]
    loaded = tiles.load_tile(first, second, ArrayCache(None))
    # A map shows heights alone; friction's own noise is the same with every map and would hide how they differ.
    return replace(loaded, mechanics=replace(loaded.mechanics, friction_noise_n=0.0))


def test_perfect_is_zero_and_the_second_tile_is_the_floor(tile) -> None:
    maps = {"perfect": ("gelsight", tile.slopes[:, 0]), "perfect DIGIT": ("digit", tile.slopes[:, 1])}
    result = score_spectra(load_field(), ENCODER, tile, maps, None)
    for name in maps:
        assert result.errors[name].total == pytest.approx(0.0, abs=1e-6)
        np.testing.assert_allclose(result.bands_db[name], 0.0, atol=1e-5)
    assert compute_excess([result], score.FLOOR) == [0.0]
    assert result.errors[score.FLOOR].total > 0.1
    assert all(each.angle_deg == 0.0 and each.ssim == pytest.approx(1.0) for each in score_images(tile, maps))


def test_twice_as_high_is_six_decibels_in_every_band(tile) -> None:
    maps = {"doubled": ("gelsight", 2.0 * tile.slopes[:, 0])}
    result = score_spectra(load_field(), ENCODER, tile, maps, None)
    np.testing.assert_allclose(result.bands_db["doubled"], 20.0 * np.log10(2.0), atol=0.1)
    assert 3.0 < result.errors["doubled"].bias < 8.0
    assert all(each.level_db == pytest.approx(20.0 * np.log10(2.0), abs=1e-3) for each in score_images(tile, maps))


def test_blurred_loses_short_waves_and_keeps_long_ones(tile) -> None:
    blurred = tile.slopes[:, 0].copy()
    frequency = np.hypot(np.fft.fftfreq(64)[:, None], np.fft.rfftfreq(64)[None, :])
    near = blurred[1 : tiles.TOKEN_VIEWS]
    keep = np.exp(-0.5 * (frequency / 0.1) ** 2)
    blurred[1 : tiles.TOKEN_VIEWS] = np.fft.irfft2(np.fft.rfft2(near) * keep, s=(64, 64))
    bands = score_spectra(load_field(), ENCODER, tile, {"blurred": ("gelsight", blurred)}, None).bands_db["blurred"]
    assert (np.diff(bands[3:]) < 0.0).all()
    assert bands[-1] < -12.0
    np.testing.assert_allclose(bands[:3], 0.0, atol=1e-6)


def test_a_flat_map_is_far_too_quiet(tile) -> None:
    result = score_spectra(load_field(), ENCODER, tile, {"flat": ("gelsight", 0.0 * tile.slopes[:, 0])}, None)
    assert result.errors["flat"].bias < -20.0


def test_looks_and_slopes_of_a_tile_show_the_same_place(monkeypatch) -> None:
    """The gradient of a photograph that equals the height is the true slope, in every view."""
    monkeypatch.setattr(pair_generation, "NOISE", (0.0, 0.0))
    monkeypatch.setattr(pair_generation, "BLUR_PIXELS", (0.0, 0.0))
    order = list_tile_requests(HELD_OUT_CLASSES, PairSizes(), 0)[0]
    laid = render_tile(order)
    grey = (laid.height - laid.height.min()) / np.ptp(laid.height)
    views = tiles._cut_views(replace(laid, photograph=np.stack([grey] * 3)), order)
    pitches = [view.pitch_m for view in views]
    assert pitches[0] == max(pitches)
    assert (len(set(pitches)), len(pitches)) == (4, 7)
    for view, slopes in zip(views, tiles._cut_true_slopes(laid, 0), strict=True):
        down, across = np.gradient(view.rgb[..., 0].astype(float))
        for seen, true in ((across, slopes[0]), (-down, slopes[1])):
            assert np.corrcoef(seen[2:-2, 2:-2].ravel(), true[2:-2, 2:-2].ravel())[0, 1] > 0.8


def test_the_nearest_neighbour_of_a_training_view_is_itself() -> None:
    pairs = synthetic_pairs(16, 3)
    rows = (5, 10)
    queries = [
        AppearanceView(decode_rgb(pairs.rgb[row]),
        pairs.depth[row].astype(np.float32) * np.float32(pairs.pitch_m[row]), True,
                 float(pairs.pitch_m[row]))
        for row in rows
    ]  # fmt: skip
    found = fit_naive_baselines([synthetic_pairs(16, 4), pairs], queries)
    np.testing.assert_array_equal(found.neighbours, pairs.slopes[list(rows), 0].astype(np.float32))
    assert found.views == 32
    assert set(found.class_name) == {"wood"}
    with pytest.raises(FileError):
        fit_naive_baselines([], queries)


def test_grey_as_height_finds_its_scale() -> None:
    """Pairs whose slopes are those of their own grey, 3 times as high as assumed."""
    pairs = synthetic_pairs(4, 5)
    slopes = np.array(pairs.slopes)
    for row in range(4):
        view = AppearanceView(
            decode_rgb(pairs.rgb[row]), np.zeros((64, 64), np.float32), False, float(pairs.pitch_m[row])
        )
        slopes[row, 0] = compute_grey_slopes(view, 3.0 * GREY_HEIGHT_M)
    assert fit_grey_m(replace(pairs, slopes=slopes)) == pytest.approx(3.0 * GREY_HEIGHT_M, rel=0.02)


@given(SEED)
@settings(max_examples=20, deadline=None)
def test_intervals_hold_their_mean_and_equal_methods_are_level(seed: int) -> None:
    values = np.random.default_rng(seed).uniform(1.0, 3.0, 30)
    found = bootstrap_mean(values, 1)
    assert found.low < found.value < found.high
    assert bootstrap_ratio(values, values, 1).format() == "1.00 (1.00 … 1.00)"
    half = bootstrap_ratio(0.5 * values, values, 1)
    assert (half.low, half.value, half.high) == pytest.approx((0.5, 0.5, 0.5))


def test_what_is_kept_is_made_once_and_damage_is_told(tmp_path) -> None:
    made: list[int] = []

    def make() -> dict[str, np.ndarray]:
        made.append(1)
        return {"values": np.arange(3.0)}

    for _ in range(2):
        np.testing.assert_array_equal(ArrayCache(tmp_path).get_or_make("name", make)["values"], [0.0, 1.0, 2.0])
    assert made == [1]
    next(tmp_path.iterdir()).write_bytes(b"not a file of arrays")
    with pytest.raises(FileError, match="cannot be read"):
        ArrayCache(tmp_path).get_or_make("name", make)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weights")
    for name, objective, seed in ((DIFFUSION, DIFFUSION, 0), (REGRESSION, REGRESSION, 0), ("other", REGRESSION, 1)):
        config = MapConfig(**SMALL, objective=objective)
        save_map_weights(folder / f"{name}.safetensors", config, random_parameters(config, seed), {})
    return folder


def hnf(*words: object) -> int:
    return main([str(word) for word in words], lambda arguments: 1)


@pytest.mark.parametrize(("main", "other"), [(DIFFUSION, REGRESSION), (REGRESSION, DIFFUSION)])
def test_the_whole_report(weights, main, other, tmp_path, monkeypatch, capsys) -> None:
    """Through the command line, in small: every table, JSON, pictures; and again from what was kept, to the byte."""
    pytest.importorskip("matplotlib", reason="draws pictures")
    monkeypatch.setattr(run, "QUICK_SIZES", SIZES)
    command = ("eval", "tactile-map", "--quick", "--weights", weights / f"{main}.safetensors", "--beside",
               weights / f"{other}.safetensors", "--cache", weights / "kept", "--json")  # fmt: skip
    assert hnf(*command, "--pictures", tmp_path) == 0
    told = capsys.readouterr().out
    record = json.loads(told)
    found = record["tables"][f"vibration, {HELD_OUT_CLASSES}"]
    assert record["networks"] == [NAMES[main], NAMES[other]]
    assert set(found) >= {*NAMES.values(), score.NEIGHBOUR, score.CLASS_MEAN, score.NO_DEPTH, score.FUSED}
    # Zero but for float32 rounding: on some machines equal rows of one product are rounded otherwise.
    assert found[score.TRUTH]["total_db"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert found[score.FLOOR]["excess_db"] == [0.0, 0.0, 0.0]
    margins = record["tables"][f"margins, {HELD_OUT_CLASSES}"]
    rivals = {score.NEIGHBOUR: 0.5, score.CLASS_MEAN: 0.5, NAMES[other]: 1.0}
    assert {name: each["aim"] for name, each in margins.items()} == {
        f"{ours} / {rival}": aim for ours in (NAMES[main], score.FUSED) for rival, aim in rivals.items()
    }
    assert [(each["steps"], each["guidance"]) for each in record["tables"]["steps"]["points"]] == [
        (1, 1),
        (2, 1),
        (2, 2),
    ]
    assert len(record["tiles"][HELD_OUT_INSTANCES]) == 1
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "tactile-map-examples.png", "tactile-map-excess.png", "tactile-map-steps.png",
    }  # fmt: skip
    assert hnf(*command) == 0
    assert capsys.readouterr().out == told


def test_two_of_a_kind_are_told_apart(weights) -> None:
    one, other = (load_map_weights(weights / f"{name}.safetensors") for name in (REGRESSION, "other"))
    first, second = make_network_entries(one, other, 20)
    assert (first.name, second.name) == (NAMES[REGRESSION], f"{NAMES[REGRESSION]}, other weights")
    assert first.short_name != second.short_name
    assert (first.weights, second.weights) == (one, other)


@pytest.mark.parametrize("objective", [DIFFUSION, REGRESSION])
def test_the_same_weights_twice_are_refused(weights, objective, tmp_path, capsys) -> None:
    """Known by what they compute: the copy says something else of itself, so that its bytes differ."""
    path, copy = weights / f"{objective}.safetensors", tmp_path / "copy.safetensors"
    read = load_map_weights(path)
    save_map_weights(copy, read.config, read.network.parameters, {"note": "another day"})
    assert copy.read_bytes() != path.read_bytes()
    assert hnf("eval", "tactile-map", "--quick", "--weights", path, "--beside", copy) == 2
    told = capsys.readouterr()
    assert "same weights" in told.err
    assert "--beside" in told.err
    assert told.out == ""


def test_the_curve_is_that_of_the_diffusion_wherever_it_stands(weights) -> None:
    diffusion, regression = (load_map_weights(weights / f"{name}.safetensors") for name in (DIFFUSION, REGRESSION))
    sizes = replace(SIZES, varied=0, all_pitches=0, guidance=(1.0,))
    curves = [
        measure_maps(MapSetup(main, beside, sizes=sizes, cache=weights / "kept")).curve
        for main, beside in ((diffusion, regression), (regression, diffusion))
    ]
    assert len(curves[0]) == 2
    for one, other in zip(*curves, strict=True):
        assert one.results[0].errors[score.PREDICTED] == other.results[0].errors[score.PREDICTED]


def test_no_more_threads_are_asked_than_this_process_may_use(weights, tile, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {3, 5}, raising=False)
    network = load_map_weights(weights / f"{REGRESSION}.safetensors")
    with count_work() as work:
        predictions.predict_tile(network, tile, predictions.Query(views=(0, 1)), 0, ArrayCache(tmp_path))
    assert work.amounts["threads"] == [2]


def test_without_another_network_there_is_no_row_of_it(weights) -> None:
    sizes = replace(SIZES, varied=0, all_pitches=0, steps=1, curve_steps=(1,), guidance=(1.0,))
    setup = MapSetup(load_map_weights(weights / "diffusion.safetensors"), sizes=sizes, cache=weights / "kept")
    measured = measure_maps(setup)
    assert all(REGRESSION not in json.dumps(extra.rows) for extra in make_tables(setup, measured))
    assert report_to_json(setup, measured)["beside"] is None


def test_without_a_diffusion_there_are_no_steps_to_show(weights, tmp_path) -> None:
    pytest.importorskip("matplotlib", reason="draws pictures")
    sizes = replace(SIZES, varied=0, all_pitches=0)
    setup = MapSetup(load_map_weights(weights / "regression.safetensors"), sizes=sizes, cache=weights / "kept")
    measured = measure_maps(setup)
    assert measured.curve == ()
    assert "steps" not in report_to_json(setup, measured)["tables"]
    assert DIFFUSION not in json.dumps(report_to_json(setup, measured))
    write_plots(tmp_path, setup, measured)
    assert {path.name for path in tmp_path.glob("*.png")} == {"tactile-map-examples.png", "tactile-map-excess.png"}


OCTAVES = st.lists(st.floats(-60.0, 40.0), min_size=len(EDGES_HZ) - 1, max_size=len(EDGES_HZ) - 1).map(np.array)


@given(OCTAVES, st.floats(-20.0, 20.0))
def test_octaves_differ_by_the_gain_between_them(levels, gain) -> None:
    assert compare_octaves(levels + gain, levels) == pytest.approx(abs(gain), abs=1e-9)
    quiet = np.where(levels < levels.max() - 30.0, -200.0, levels)
    assert compare_octaves(quiet, levels) == 0.0


class Product:
    """Stands for `hnf touch`: a tone whose amplitude is that of the network, and patches as the product keeps them."""

    def __init__(self, predicts: bool, code: int = 0) -> None:
        self.predicts, self.code, self.runs = predicts, code, []

    def __call__(self, words, limit_s):
        self.runs.append(list(words))
        if self.code:
            return self.code, "note: a note\nhnf: the scene is damaged.\n"
        from hnf_blender.touch.bake_patches import CACHE_FOLDER_NAME
        from hnf_blender.touch.patch_cache import Prediction, save_prediction

        out, network = Path(words[words.index("--out") + 1]), words[-1]
        amplitude = 2.0 if self.predicts and network == DIFFUSION else 1.0
        samples = amplitude * np.sin(2.0 * np.pi * 100.0 * np.arange(4000) / 4000.0)
        (out / CACHE_FOLDER_NAME).mkdir(parents=True)
        FORMATS["wav"].write(out / "a.wav", Signal(samples.astype(np.float32), 4000.0, 0, {}), ExportOptions())
        if self.predicts:
            values = np.zeros(TOKEN_DIM, dtype=np.float32)
            values[LEVELS] = np.log10(amplitude)
            token = Token(values, np.ones(TOKEN_DIM, dtype=bool), np.ones(TOKEN_DIM, dtype=np.float32))
            images = np.zeros((1, 64, 64, 3), dtype=np.float16)
            prediction = Prediction(images, np.array([1e-3]), 1e-3, token, "gelsight", ENCODER_ID, network)
            save_prediction(out / CACHE_FOLDER_NAME, network, prediction)
        route = "predicted" if self.predicts else "measured"
        stroke = {
            "name": "a", "wav": "a.wav", "rms_m_s2": amplitude, "confidence": 0.25, "routes": {"8 mm": route}
        }  # fmt: skip
        report = {"strokes": [stroke], "counts": {"diffusion_calls": int(self.predicts)}}
        (out / "report.json").write_text(json.dumps(report))
        return 0, ""


def test_either_network_is_felt_and_their_difference_is_told(tmp_path) -> None:
    pytest.importorskip("bpy")
    scene = tmp_path / "a.blend"
    scene.touch()
    product = Product(predicts=True)
    first, second = compare_networks([scene], [REGRESSION, DIFFUSION], side_m=0.07, run=product)
    assert [words[-1] for words in product.runs] == [REGRESSION, DIFFUSION]
    assert product.runs[0][:-5] == product.runs[1][:-5]
    assert (first.network, first.predicted_patches, first.used_bands) == (REGRESSION, 1, 1)
    assert np.isnan([first.vibration_db, first.map_db]).all()
    assert second.vibration_db == pytest.approx(20.0 * np.log10(2.0), abs=0.01)
    assert second.map_db == pytest.approx(20.0 * np.log10(2.0), abs=1e-5)
    assert networks_to_json([first, second])[0]["vibration_db"] is None
    assert "| a.blend | diffusion | 1 |" in format_networks([first, second])


def test_a_measured_relief_is_the_same_with_either_network(tmp_path) -> None:
    pytest.importorskip("bpy")
    scene = tmp_path / "a.blend"
    scene.touch()
    _, second = compare_networks([scene], [REGRESSION, DIFFUSION], side_m=0.07, run=Product(predicts=False))
    assert (second.vibration_db, second.predicted_patches, second.used_bands) == (0.0, 0, 0)
    assert np.isnan(second.map_db)


def test_a_surface_that_cannot_be_touched_is_named(tmp_path) -> None:
    scene = tmp_path / "a.blend"
    with pytest.raises(FileError, match="is no file"):
        compare_networks([scene], [REGRESSION], side_m=0.07)
    scene.touch()
    with pytest.raises(SceneError, match="the scene is damaged"):
        compare_networks([scene], [REGRESSION], side_m=0.07, run=Product(False, code=1))
    assert hnf("eval", "tactile-map", "--touch", scene, "--width", 0) == 2
