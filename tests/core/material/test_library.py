"""The shipped library: complete, consistent with encoder and simulator, and tolerant of spelling."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hnf_core.errors import MaterialError
from hnf_core.material.band_descriptor import describe
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import LIBRARY_PATH, get_material, load_library, read_library
from hnf_core.material.token import BAND_FEATURES, band_slice
from hnf_core.signal import dft321
from hnf_core.simulation.contact_dynamics import SmoothedMaps
from hnf_core.simulation.simulate import simulate_batch, straight_stroke
from hnf_core.simulation.surface_recipe import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map
from hnf_core.tactile.height import tactile_map_from_height

CATEGORIES = {
    "wood", "metal", "stone", "fabric", "paper", "plastic", "foam", "carpet", "tile", "leather", "rubber", "glass",
}  # fmt: skip
SAMPLE = ("oak-wood", "smooth-metal", "granite", "denim", "copy-paper", "ribbed-plastic", "soft-foam", "loop-carpet",
          "glazed-tile", "leather", "rubber", "clear-glass")  # fmt: skip


def surface_of(name: str) -> SmoothedMaps:
    material = get_material(name)
    return SmoothedMaps(height_map(SurfaceRecipe.from_dict(material.recipe), material.seed))


def test_the_library_covers_every_category_with_unique_names():
    library = load_library()
    names = [material.name for material in library]
    assert len(library) >= 28
    assert len(set(names)) == len(names)
    assert {material.category for material in library} == CATEGORIES
    for material in library:
        assert material.name == "-".join(material.name.lower().split())
        assert len(material.words) == len(set(material.words)) > 0
        assert all(word == word.lower() and word.isalpha() for word in material.words)


def test_everything_physical_is_known_and_in_range():
    for material in load_library():
        mechanics, looks = material.mechanics, material.appearance
        assert 1e3 <= mechanics.stiffness_n_m <= 5e6
        assert 0.02 <= mechanics.damping_ratio <= 0.9
        assert 0.05 <= mechanics.friction <= 1.5
        for value in (*looks.base_color, looks.roughness, looks.metallic, looks.sheen, looks.transmission):
            assert 0.0 <= value <= 1.0


@pytest.mark.parametrize(
    "word", ["leather", "metal", "rubber", "wood", "glass", "lens", "fabric", "velvet", "cloth", "strap"]
)
def test_words_that_artists_use_are_there(word):
    assert any(word in material.words for material in load_library())


@pytest.mark.parametrize("name", ["oak-wood", "denim", "knurled-metal"])
def test_tokens_are_those_of_the_present_encoder(name):
    material, pitch = get_material(name), TILE_SIZE_M / TILE_PIXELS
    height = height_map(SurfaceRecipe.from_dict(material.recipe), material.seed)
    token = describe(tactile_map_from_height(height, None, pitch, 2.0 * pitch))
    assert token.known.all()
    assert material.token == pytest.approx(token.values, abs=2e-3)


def test_at_least_six_materials_feel_their_direction():
    def anisotropy(token: np.ndarray) -> float:
        bands = [token[band_slice(band)] for band in range(7)]
        names = [BAND_FEATURES.index(name) for name in ("cos2", "sin2", "cos4", "sin4")]
        return max(float(np.hypot(*band[names[k : k + 2]])) for band in bands[2:6] for k in (0, 2))

    assert sum(anisotropy(material.token) > 0.4 for material in load_library()) >= 6
    grain = get_material("brushed-metal").token[band_slice(3)]
    assert grain[BAND_FEATURES.index("cos2")] < -0.4  # x along the grain: the waves stand along y
    ribs = get_material("corduroy").token[band_slice(3)]
    assert ribs[BAND_FEATURES.index("cos2")] > 0.3  # ribs along y: the waves stand along x


def test_a_sample_feels_as_real_materials_do():
    conditions = ((0.1, 1.0), (0.05, 1.0), (0.15, 1.0), (0.1, 0.5), (0.1, 2.0))
    angles = np.radians([8.0, 98.0])
    maps, strokes, mechanics = [], [], []
    for name in SAMPLE:
        surface = surface_of(name)
        for speed, force in conditions:
            for angle in angles:
                maps.append(surface)
                strokes.append(straight_stroke(speed, force, 1.0, angle_rad=angle))
                mechanics.append(get_material(name).mechanics)
    acceleration = simulate_batch(maps, strokes, mechanics, oversample=1)[:, 1000:]
    fused = dft321(acceleration - acceleration.mean(axis=1, keepdims=True))
    power = np.abs(np.fft.rfft(fused, axis=1)) ** 2 * 2 / fused.shape[1] ** 2
    frequency = np.fft.rfftfreq(fused.shape[1], 1e-4)
    power = power[:, frequency >= 10.0].reshape(len(SAMPLE), len(conditions), len(angles), -1)
    low = frequency[frequency >= 10.0] < 1000.0
    rms = np.sqrt(power.sum(axis=-1).mean(axis=-1))
    middle = power[:, 0]
    assert np.all((middle.sum(axis=-1) > 0.1**2) & (middle.sum(axis=-1) < 30.0**2))
    assert np.all(middle[..., low].sum(axis=-1) > 0.5 * middle.sum(axis=-1))
    v_exponent = np.log(rms[:, 2] / rms[:, 1]) / np.log(3.0)
    f_exponent = np.log(rms[:, 4] / rms[:, 3]) / np.log(4.0)
    assert np.all((v_exponent > 0.4) & (v_exponent < 1.4)), dict(zip(SAMPLE, v_exponent, strict=True))
    assert np.all((f_exponent > -0.1) & (f_exponent < 0.7)), dict(zip(SAMPLE, f_exponent, strict=True))


def test_names_match_any_spelling_and_close_ones_are_suggested():
    assert get_material("Oak Wood").name == get_material("oak_wood").name == "oak-wood"
    with pytest.raises(MaterialError, match="oak-wood"):
        get_material("oak-wod")
    with pytest.raises(MaterialError, match="denim"):
        get_material("jeans")
    with pytest.raises(MaterialError, match="hnf materials"):
        get_material("xyzzyplugh")


def test_a_library_that_cannot_be_used_says_why(tmp_path: Path):
    with pytest.raises(MaterialError, match="cannot be read"):
        read_library(tmp_path / "none.json")
    damaged = tmp_path / "damaged.json"
    damaged.write_text(LIBRARY_PATH.read_text()[:-100])
    with pytest.raises(MaterialError, match="damaged"):
        read_library(damaged)
    record = json.loads(LIBRARY_PATH.read_text())
    for change, message in (({"encoder": "other"}, "encoder other"), ({"materials": [{"name": "x"}]}, "damaged")):
        damaged.write_text(json.dumps(record | change))
        with pytest.raises(MaterialError, match=message):
            read_library(damaged)
    record["materials"][0]["token"] = record["materials"][0]["token"][:-1]
    damaged.write_text(json.dumps(record))
    with pytest.raises(MaterialError, match="finite numbers"):
        read_library(damaged)


def test_shared_tokens_cannot_be_changed_by_a_caller():
    with pytest.raises(ValueError, match="read-only"):
        load_library()[0].token[0] = 1.0


def test_reading_the_library_needs_neither_simulator_nor_torch():
    code = (
        "import sys; from hnf_core.material.library import load_library; load_library();"
        "print([m for m in sys.modules if m.split('.')[0] in ('torch', 'scipy', 'bpy') or 'simulation' in m])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=LIBRARY_PATH.parents[2]
    )
    assert done.stdout.strip() == "[]"


def test_mechanics_differ_where_pictures_do_not():
    assert get_material("soft-foam").mechanics.stiffness_n_m < 0.1 * get_material("granite").mechanics.stiffness_n_m
    assert get_material("rubber").mechanics != Mechanics()
