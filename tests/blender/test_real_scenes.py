"""Scenes that nobody here made: what their maps resolve is measured, the rest is prior, and it feels like something."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import bpy
import numpy as np
import pytest
from touch_scene import signals, spectrum_db
from touch_scene import touch_without_pictures as touch

from hnf_blender.bridge.scene.stored_data import read_tokens
from hnf_core.field.field import evaluate, steady_amplitude
from hnf_core.field.linear_contact import Condition
from hnf_core.field.weights import load_field

SCENES = Path(__file__).parents[3] / "shared" / "data" / "scenes"

pytestmark = pytest.mark.skipif(not SCENES.is_dir(), reason="the real scenes are not beside the repository")

HELMET = ("LeatherPartsMat", "MetalPartsMat", "RubberWoodMat", "GlassPlasticMat")
CHAIR = ("fabric Mystere Mango Velvet", "wood Brown")


@pytest.fixture(scope="module", params=["FlightHelmet/FlightHelmet.gltf", "SheenChairScene/MixedLightingExample.gltf"])
def touched(request, tmp_path_factory):
    """The whole scene touched by default strokes at 100 mm/s and 1 N."""
    out = tmp_path_factory.mktemp("real")
    code, report = touch(SCENES / request.param, out)
    return code, report, out, HELMET if "Helmet" in request.param else CHAIR


def test_each_material_has_its_signal(touched) -> None:
    code, report, out, materials = touched
    assert code == 0, report["failed"]
    found = {entry["material"]: entry for entry in report["strokes"]}
    assert set(materials) <= set(found)
    loudness, spectra = {}, {}
    for name, signal in signals(out, report).items():
        samples = signal.samples.astype(np.float64)
        assert np.isfinite(samples).all()
        plateau = samples[len(samples) // 3 : -len(samples) // 3]  # at full speed and force
        loudness[name] = float(np.sqrt(np.mean(plateau**2)))
        power = np.abs(np.fft.rfft(plateau * np.hanning(len(plateau)))) ** 2
        below = np.fft.rfftfreq(len(plateau), 1.0 / signal.sample_rate) < 1000.0
        assert power[below].sum() > 0.5 * power.sum(), name
        spectra[name] = spectrum_db(signal)
    for name, rms in loudness.items():
        assert 0.1 <= rms <= 30.0, (name, rms)
    of = {entry["material"]: entry["name"] for entry in report["strokes"]}
    for one, other in itertools.combinations(materials, 2):
        distance = np.sqrt(np.mean((spectra[of[one]] - spectra[of[other]]) ** 2))
        assert distance > 2.0, (one, other, distance)


def test_the_routes_show_what_the_maps_resolve(touched) -> None:
    _, report, _, materials = touched
    for entry in report["strokes"]:
        fine = [entry["routes"][band] for band in ("1 mm", "0.5 mm", "0.25 mm", "0.125 mm")]
        assert fine == ["prior"] * 4, entry["name"]
        resolved_mm = 1e3 * (entry["resolved_wavelength_m"] or math.inf)
        for band, route in entry["routes"].items():
            shortest_mm = float(band.removesuffix(" mm")) / math.sqrt(2.0)
            assert route == "prior" or resolved_mm <= shortest_mm, (entry["name"], band, route)
        if materials is HELMET:
            # Rounding and JPEG leave nothing of some normal maps.
            assert resolved_mm > 1.0
    if materials is HELMET:
        assert report["counts"]["diffusion_calls"] == 0  # every shader has a normal map


def test_photos_without_relief_are_read_where_they_show_enough(touched) -> None:
    """Two texels are 0.9 mm of wood and 0.5 mm of the label's finer side; the velvet shows no wave below 2.4 mm."""
    _, report, _, materials = touched
    if materials is HELMET:
        return
    read = {entry["material"] for entry in report["strokes"] if entry["height_source"]}
    assert read == {"wood Brown", "label"}
    for entry in report["strokes"]:
        if entry["material"] in read:
            # By the measured errors of the network what it predicts there says no more than the material's own prior.
            assert set(entry["routes"].values()) == {"prior"}
            assert entry["height_source"].startswith("estimated from image 'SheenChair")
            assert 0.5e-3 < entry["resolved_wavelength_m"] < 1e-3
        else:
            assert (entry["height_source"], entry["resolved_wavelength_m"]) == ("", None)
    assert 0 < report["counts"]["diffusion_calls"] < report["counts"]["renders"]
    assert any("Velvet" in text and "shows no wave below 2.4 mm" in text for text in report["warnings"])


def test_louder_with_speed_and_force(touched) -> None:
    """Exponents as method and issue define them, of the tokens as they stand in the baked file."""
    _, report, out, materials = touched
    field = load_field()
    bpy.ops.wm.open_mainfile(filepath=str(out / report["baked_blend"]))
    checked = 0
    for entry in report["strokes"]:
        if entry["material"] not in materials:
            continue
        tokens = read_tokens(bpy.data.objects[entry["object"]].data)
        assert tokens is not None
        for token, mechanics, name in zip(
            tokens.palette.tokens, tokens.palette.mechanics, tokens.palette.names, strict=True
        ):
            if name != entry["library_material"]:
                continue

            def rms(speed: float, force: float, token=token, mechanics=mechanics) -> float:
                way, one = np.array([[np.cos(0.3), np.sin(0.3)]]), np.ones(1)
                steady = Condition(
                    token[None].astype(np.float64), (mechanics,), np.zeros(1, np.int32), way, speed * one, force * one,
                    one > 0.0, "pen",
                )  # fmt: skip
                return float(np.linalg.norm(steady_amplitude(field.config, evaluate(field, steady))))

            by_speed = np.log(rms(0.15, 1.0) / rms(0.05, 1.0)) / np.log(3.0)
            by_force = np.log(rms(0.1, 2.0) / rms(0.1, 0.5)) / np.log(4.0)
            assert 0.4 <= by_speed <= 1.4, (name, by_speed)
            assert -0.1 <= by_force <= 0.7, (name, by_force)
            checked += 1
    assert checked >= len(materials)


def test_a_second_run_does_nothing(touched) -> None:
    _, _, out, materials = touched
    scene = SCENES / (
        "FlightHelmet/FlightHelmet.gltf" if materials is HELMET else "SheenChairScene/MixedLightingExample.gltf"
    )
    code, report = touch(scene, out)
    assert code == 0
    assert not any(report["counts"].values()), report["counts"]
