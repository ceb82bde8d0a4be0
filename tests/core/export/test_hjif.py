"""`.hjif`: round trips, conformance with the reference software, and errors for damaged files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hjif_rules import check_hjif
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from touched_surfaces import RATE, rough_tone, touched_sheet

from hnf_core.errors import FileError
from hnf_core.export.gltf import build_vertex_table, decode_glb, encode_surface
from hnf_core.export.hjif import MAX_WRITTEN_SAMPLES, encode_hjif, make_texture, read_hjif, write_hjif
from hnf_core.export.options import ExportOptions, ImportOptions
from hnf_core.export.touched_surface import StrokePath
from hnf_core.signal import Signal

PLAIN = ExportOptions()
DATE = "2026-11-21"
SIGNALS = st.builds(
    Signal,
    hnp.arrays(np.float32, st.integers(0, 400), elements=st.floats(-1e4, 1e4, width=32)),
    st.sampled_from([1.0, 7.0, 100.0, 8000.0, 10_000.0, 48_000.0]),
    st.integers(-(2**63), 2**63),
    st.dictionaries(st.sampled_from(["stroke", "material", "model"]) | st.text(max_size=9), st.text(max_size=300)),
)


def back(folder: Path, tree: dict, options: ImportOptions = ImportOptions()) -> Signal:  # noqa: B008
    path = folder / "read.hjif"
    path.write_text(json.dumps(tree), encoding="utf-8")
    return read_hjif(path, options)


def file_of(*effects: dict, band_type: str = "Curve", **band) -> dict:
    """A file of others: one channel with one band."""
    band = {"band_type": band_type, "lower_frequency_limit": 0, "upper_frequency_limit": 1000, **band}
    channel = {
        "id": 0, "description": "", "gain": 1.0, "mixing_coefficient": 1.0, "body_part_mask": 0,
        "bands": [{**band, "effects": list(effects)}],
    }  # fmt: skip
    perception = {
        "id": 0, "avatar_id": 0, "description": "other", "perception_modality": "Vibrotactile", "reference_devices": [],
        "effect_library": [], "channels": [channel],
    }  # fmt: skip
    return {
        "version": "2023", "profile": "Main", "level": 1, "date": "2024-01-01", "description": "other",
        "timescale": 1000, "avatars": [], "perceptions": [perception], "syncs": [],
    }  # fmt: skip


def effect(*keys: tuple[int, float | None, float | None], position: int = 0, phase: float = 0.0, **more) -> dict:
    names = ("relative_position", "amplitude_modulation", "frequency_modulation")
    frames = [{name: value for name, value in zip(names, key, strict=True) if value is not None} for key in keys]
    own = {"effect_type": "Basis", "position": position, "phase": phase, "base_signal": "Sine", "keyframes": frames}
    return {**own, **more}


@settings(deadline=None)
@given(signal=SIGNALS)
def test_a_stroke_comes_back_bit_for_bit(signal: Signal, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Loud ones too: nothing is clipped."""
    tree = json.loads(json.dumps(encode_hjif(signal, PLAIN, date=DATE)))
    check_hjif(tree)
    found = back(tmp_path_factory.getbasetemp(), tree)
    assert np.array_equal(found.samples, signal.samples)
    assert (found.sample_rate, found.seed) == (signal.sample_rate, signal.seed)
    assert dict(found.provenance).items() <= dict(signal.provenance).items()


def test_the_reference_synthesiser_hears_each_sample_once(tmp_path: Path) -> None:
    """Effects share their border; as Band::EvaluationBand joins them, nothing is doubled and nothing is missing."""
    signal = rough_tone(2.5)
    path = tmp_path / "x.hjif"
    (said,) = write_hjif(path, signal, PLAIN)
    assert "baked scene" in said
    tree = json.loads(path.read_text(encoding="utf-8"))
    check_hjif(tree)
    channel = tree["perceptions"][0]["channels"][0]
    (band,) = channel["bands"]
    heard = np.zeros(channel["sample_count"])
    for number, each in enumerate(band["effects"]):
        values = [key["amplitude_modulation"] for key in each["keyframes"]]
        assert [key["relative_position"] for key in each["keyframes"]] == list(range(len(values)))
        if number + 1 < len(band["effects"]):
            assert band["effects"][number + 1]["position"] == each["position"] + len(values) - 1
            values = values[:-1]
        heard[each["position"] : each["position"] + len(values)] += values
    assert len(band["effects"]) == 3
    np.testing.assert_allclose(heard * channel["gain"] * PLAIN.full_scale_m_s2, signal.samples, atol=1e-6)


def test_what_is_too_loud_for_the_device_is_not_clipped() -> None:
    tree = encode_hjif(rough_tone(peak=45.0), PLAIN, date=DATE)
    channel = tree["perceptions"][0]["channels"][0]
    assert channel["gain"] == pytest.approx(1.5)
    assert max(key["amplitude_modulation"] for key in channel["bands"][0]["effects"][0]["keyframes"]) <= 1.0
    check_hjif(tree)


def test_a_texture_on_a_surface_lists_vertices_under_the_stroke(tmp_path: Path) -> None:
    surface = touched_sheet()
    signal, path = rough_tone(), tmp_path / "x.hjif"
    (said,) = write_hjif(path, signal, ExportOptions(surface=surface))
    assert "30 mm" in said
    assert "100 mm/s" in said
    tree = json.loads(path.read_text(encoding="utf-8"))
    check_hjif(tree)
    (perception,) = tree["perceptions"]
    assert perception["perception_modality"] == "VibrotactileTexture"
    assert perception["unit_exponent"] == -5
    assert tree["avatars"] == [{"id": 1, "lod": 0, "type": "Custom", "mesh": "x.hjif.glb"}]
    assert perception["avatar_id"] == 1
    table = build_vertex_table(surface)
    assert (tmp_path / "x.hjif.glb").read_bytes() == encode_surface(surface, table, signal)
    parts, block = decode_glb((tmp_path / "x.hjif.glb").read_bytes(), path)
    accessor = parts["accessors"][parts["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    view = parts["bufferViews"][accessor["bufferView"]]
    positions = np.frombuffer(block, "<f4", 3 * accessor["count"], view["byteOffset"]).reshape(-1, 3)
    under = positions[perception["channels"][0]["vertices"]]
    assert under[:, 0].min() == 0.0
    assert under[:, 0].max() == pytest.approx(0.04)
    # The stroke runs along the first row of squares: z of glTF is minus y of Blender.
    assert {round(float(z), 6) for z in under[:, 2]} == {0.0, -0.01}
    found = read_hjif(path, ImportOptions())
    assert found.sample_rate == RATE
    assert len(found.samples) == len(signal.samples) + 1  # both ends of the way
    np.testing.assert_allclose(found.samples[:-1], signal.samples, atol=2e-3)


@given(speed=st.floats(0.005, 0.5))
@settings(deadline=None, max_examples=30)
def test_a_texture_is_the_signal_over_the_way(speed: float) -> None:
    """At any constant speed: one period of the tone is speed / tone long, and played at the speed it is the tone."""
    seconds, hertz = 0.3, 40.0
    time = np.linspace(0.0, seconds, 61)
    path = StrokePath(time, speed * time, np.zeros(61, np.int32))
    texture = make_texture(rough_tone(seconds, hertz), path, np.zeros(0, np.int32), "x.hjif.glb")
    tick = 10.0**texture.exponent
    assert texture.rate <= 48_000
    assert texture.rate == pytest.approx(speed / tick, abs=0.5)
    way = np.arange(len(texture.samples)) * tick
    assert way[-1] <= speed * seconds * (1 + 1e-9) < way[-1] + 2 * tick
    inside = way / speed <= seconds - 1.0 / RATE  # after its last sample, a signal stays as it is
    expected = 12.0 * np.sin(2 * np.pi * hertz * way / speed)
    np.testing.assert_allclose(texture.samples[inside], expected[inside], atol=0.02)


def test_where_the_hand_rests_a_texture_has_nothing() -> None:
    time = np.linspace(0.0, 0.3, 61)
    distance = 0.1 * np.minimum(time, 0.1) + 0.1 * np.maximum(time - 0.2, 0.0)
    rest = (np.arange(3000) > 1010) & (np.arange(3000) < 1990)
    signal = Signal(np.where(rest, 9.0, 1.0).astype(np.float32), RATE, 0)
    texture = make_texture(
        signal, StrokePath(time, distance, np.zeros(61, np.int32)), np.zeros(0, np.int32), "x.hjif.glb"
    )
    assert len(texture.samples) == 2001
    assert np.count_nonzero(texture.samples > 1.5) <= 60  # of the 5 ms in which the hand comes to rest
    assert texture.rate == RATE


def test_a_surface_without_a_way_is_said(tmp_path: Path) -> None:
    (said,) = write_hjif(tmp_path / "x.hjif", rough_tone(), ExportOptions(surface=touched_sheet(path=False)))
    assert "vertices" in said
    assert not (tmp_path / "x.hjif.glb").exists()


@pytest.mark.parametrize(
    ("signal", "why"),
    [
        (Signal(np.array([np.nan], np.float32), RATE, 0), "finite"),
        (Signal(np.zeros(4, np.float32), 44_100.5, 0), "44100.5 Hz"),
        (Signal(np.zeros(4, np.float32), 96_000.0, 0), "96000 Hz"),
        (Signal(np.zeros(MAX_WRITTEN_SAMPLES + 1, np.float32), RATE, 0), "480000"),
    ],
)
def test_what_the_format_cannot_hold_is_refused(signal: Signal, why: str, tmp_path: Path) -> None:
    path = tmp_path / "x.hjif"
    with pytest.raises(FileError, match=why):
        write_hjif(path, signal, PLAIN)
    assert not path.exists()


def test_curves_of_others(tmp_path: Path) -> None:
    """Lines, and cubics level at each keyframe; 10 samples a tick; gain and exponent count."""
    keys = ((0, 0.0, None), (10, 1.0, None), (20, 0.0, None))
    tree = file_of(effect(*keys, position=5), curve_type="Linear")
    tree["perceptions"][0]["channels"][0]["gain"] = 0.5
    tree["perceptions"][0]["perception_unit_exponent"] = 1
    found = back(tmp_path, tree, ImportOptions(full_scale_m_s2=2.0))
    assert found.sample_rate == 10_000.0
    assert len(found.samples) == 251
    time = np.arange(251) / 10.0 - 5.0
    line = np.clip(1.0 - np.abs(time - 10.0) / 10.0, 0.0, None)
    np.testing.assert_allclose(found.samples, 10.0 * line, atol=1e-5)
    assert "states none" in found.provenance["scale"]
    cubic = back(tmp_path, file_of(effect(*keys, position=5), curve_type="Cubic"), ImportOptions(full_scale_m_s2=1.0))
    np.testing.assert_allclose(cubic.samples, line * line * (3.0 - 2.0 * line), atol=1e-6)


def test_waves_of_others(tmp_path: Path) -> None:
    """A chirp from 50 to 250 Hz: its phase is the integral of its frequency."""
    tree = file_of(effect((0, 0.2, 50), (500, 1.0, 250), phase=0.7), band_type="VectorialWave")
    found = back(tmp_path, tree, ImportOptions(full_scale_m_s2=1.0))
    time = np.arange(5001) / 10_000.0
    expected = (0.2 + 1.6 * time) * np.sin(0.7 + 2 * np.pi * (50.0 * time + 200.0 * time**2))
    np.testing.assert_allclose(found.samples, expected, atol=1e-5)


@pytest.mark.parametrize("shape", ["Square", "Triangle", "SawToothUp", "SawToothDown"])
def test_other_shapes_have_the_period_and_swing_of_a_sine(shape: str, tmp_path: Path) -> None:
    tree = file_of(effect((0, 1.0, 100), (100, 1.0, 100), phase=0.03, base_signal=shape), band_type="VectorialWave")
    found = back(tmp_path, tree, ImportOptions(full_scale_m_s2=1.0)).samples
    np.testing.assert_allclose(found[3:800], found[103:900], atol=1e-5)
    assert found.max() == pytest.approx(1.0, abs=0.03)
    assert found.min() == pytest.approx(-1.0, abs=0.03)


def test_transients_and_library_effects_of_others(tmp_path: Path) -> None:
    tree = file_of({"effect_type": "Reference", "id": 4, "position": 10}, band_type="Transient")
    tree["perceptions"][0]["effect_library"] = [{"id": 4, **effect((0, 0.5, 90))}]
    found = back(tmp_path, tree, ImportOptions(full_scale_m_s2=1.0)).samples
    time = np.arange(len(found)) / 10_000.0 - 0.010
    inside = (time >= 0.0) & (time < 0.022)
    np.testing.assert_allclose(found[inside], 0.5 * np.sin(4 * np.pi * time[inside] / 0.022), atol=1e-5)
    assert not found[~inside].any()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (lambda tree: tree.pop("perceptions"), "perceptions"),
        (lambda tree: tree["perceptions"].clear(), "0 channels"),
        (lambda tree: tree["perceptions"].append(tree["perceptions"][0]), "2 channels"),
        (lambda tree: tree.update(timescale=0), "timescale"),
        (lambda tree: tree["perceptions"][0].update(effect_library=3), "effect_library"),
        (lambda tree: _band(tree).update(band_type="WaveletWave"), "WaveletWave"),
        (lambda tree: _band(tree).update(curve_type="Akima"), "Akima"),
        (lambda tree: _band(tree).update(effects=[3]), "no object"),
        (lambda tree: _band(tree)["effects"][0].update(effect_type="Timeline"), "Timeline"),
        (lambda tree: _band(tree)["effects"][0]["keyframes"].reverse(), "fall"),
        (lambda tree: _band(tree)["effects"][0].update(position=2**31 - 1), "can be held"),
        (lambda tree: _channel(tree).update(gain="loud"), "gain"),
        (lambda tree: _channel(tree).update(sample_count=-1), "sample_count"),
    ],
)
def test_damage_is_named(change, why: str, tmp_path: Path) -> None:
    tree = file_of(effect((0, 0.0, None), (9, 1.0, None)), curve_type="Linear")
    assert len(back(tmp_path, tree).samples) == 91
    change(tree)
    with pytest.raises(FileError, match=why):
        back(tmp_path, tree)


def _channel(tree: dict) -> dict:
    return tree["perceptions"][0]["channels"][0]


def _band(tree: dict) -> dict:
    return _channel(tree)["bands"][0]


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_any_part_may_be_anything(data, tmp_path_factory: pytest.TempPathFactory) -> None:
    """One value of a good file is replaced by nonsense: a signal, or one FileError."""
    tree = file_of(effect((0, 0.0, None), (9, 1.0, None)), curve_type="Linear")
    owner, key = data.draw(st.sampled_from(list(_places(tree))))
    owner[key] = data.draw(
        st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(max_size=4) | st.just([]) | st.just({}) | st.just([{}])
    )  # fmt: skip
    try:
        found = back(tmp_path_factory.getbasetemp(), tree)
    except FileError:
        return
    assert np.isfinite(found.samples).all()


def _places(value):
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in pairs:
        yield value, key
        yield from _places(inner)
