"""HaTT recordings: XML files in the arrangements that are known, one quantity a file or all in one."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hatt_files import model_xml
from hypothesis import given, settings
from hypothesis import strategies as st

from hnf_core.action.action import Action
from hnf_core.action.synthetic_actions import make_random_smooth_action
from hnf_core.datasets.hatt_models import TextureModel
from hnf_core.datasets.recording import Recording
from hnf_core.datasets.registry import open_dataset
from hnf_core.errors import FileError

RATE = 10_000
SECONDS = 0.5
TIME = np.arange(round(SECONDS * RATE)) / RATE
ACCELERATION = np.random.default_rng(1).standard_normal((len(TIME), 3))
FORCE = 1.0 + 0.3 * np.sin(2 * np.pi * 4 * TIME)
SPEED_MM = 100.0 + 30.0 * np.cos(2 * np.pi * 2 * TIME)


def listed(tag: str, numbers, **settings_) -> str:
    extra = "".join(f"<{key}>{value}</{key}>" for key, value in settings_.items())
    return f"<data>{extra}<{tag}>{''.join(f'<value>{x:.6g}</value>' for x in numbers)}</{tag}></data>"


def separate(folder: Path, take: str = "", material: str = "Test Cloth") -> None:
    """One folder per quantity, <prefix>_<Material>.xml, one <value> per sample."""
    one = ACCELERATION[:, 2]
    for name, numbers, more in (
        ("Accel", one, {"AccelUnits": "m/s^2", "SampleRate": "10000"}),
        ("Force", FORCE, {"ForceUnits": "N", "SampleRate": "10000"}),
        ("Speed", SPEED_MM, {"SpeedUnits": "mm/s", "SampleRate": "10000"}),
    ):
        (folder / name).mkdir(parents=True, exist_ok=True)
        (folder / name / f"{name}Data_{material}{take}.xml").write_text(listed(name, numbers, **more), encoding="utf-8")


def compound(
    acceleration=ACCELERATION, force=FORCE, angle=0.5, units="m/s^2", rate="10000", body=lambda tag, text: text
) -> str:
    """All in one file, numbers in one element per axis, positions along a straight line."""
    place = np.cumsum(SPEED_MM)[:, None] / RATE * [np.cos(angle), np.sin(angle)]
    columns = {"ForceNormal": force, "ForceTangential": 7.0 + 0 * force, "PositionX": place[:, 0],
               "PositionY": place[:, 1]}  # fmt: skip
    columns |= {f"Accel{axis}": acceleration[:, k] for k, axis in enumerate("XYZ")}
    inner = "".join(
        f"<{tag}>{body(tag, ' '.join(f'{x:.9g}' for x in column))}</{tag}>" for tag, column in columns.items()
    )
    return f"<recording><SampleRate>{rate}</SampleRate><AccelUnits>{units}</AccelUnits>{inner}</recording>"


def one_file(tmp_path: Path, text: str) -> list[Recording]:
    (tmp_path / "Recording_Test Cloth.xml").write_text(text, encoding="utf-8")
    return open_dataset("hatt", tmp_path).recordings("test cloth")


def test_a_folder_per_quantity(tmp_path):
    separate(tmp_path / "recorded")
    data = open_dataset("hatt", tmp_path)
    assert data.materials == ("Test Cloth",)
    (recording,) = data.recordings("test_cloth")
    assert recording.known == {"speed", "force"}
    assert recording.notes == ("no position in a plane was recorded: direction +x assumed",)
    one = ACCELERATION[: len(recording.samples), 2]
    np.testing.assert_allclose(recording.samples, one - ACCELERATION[:, 2].mean(), atol=1e-5)
    action = recording.action
    np.testing.assert_allclose(action.speed[10:-10], SPEED_MM[::50][10 : len(action.speed) - 10] * 1e-3, rtol=0.01)
    np.testing.assert_allclose(action.force[10:-10], FORCE[::50][10 : len(action.force) - 10], rtol=0.02)
    assert data.process("test cloth") is None
    low, high = data.action_range("test cloth").speed_m_s
    assert 0.07 <= low < high <= 0.13


def test_all_in_one_file_with_three_axes_and_positions(tmp_path):
    (recording,) = one_file(tmp_path, compound())
    assert recording.known == {"direction", "speed", "force"}
    assert recording.notes == ("units of force are missing: taken as N", "units of position are missing: taken as mm")
    # DFT321 keeps the power of three axes
    power = np.square(ACCELERATION - ACCELERATION.mean(axis=0)).sum(axis=1).mean()
    assert np.mean(np.square(recording.samples)) == pytest.approx(power, rel=0.02)
    angle = np.arctan2(recording.action.direction[:, 1], recording.action.direction[:, 0])
    np.testing.assert_allclose(angle, 0.5, atol=1e-3)
    np.testing.assert_allclose(recording.action.speed[10:-10], SPEED_MM[::50][10 : len(angle) - 10] * 1e-3, rtol=0.02)
    assert recording.action.force.mean() == pytest.approx(1.0, abs=0.05)


def test_units_and_rates_of_the_file_count(tmp_path):
    (first,) = one_file(tmp_path, compound())
    (in_g,) = one_file(tmp_path, compound(units="g"))
    np.testing.assert_allclose(in_g.samples, 9.80665 * first.samples, rtol=1e-9)
    (slower,) = one_file(tmp_path, compound(rate="5 kHz"))
    assert slower.duration_s == pytest.approx(2.0 * first.duration_s, abs=0.006)
    assert slower.sample_rate == 10_000.0


def test_takes_and_models_stand_side_by_side(tmp_path):
    for take in ("_1", "_2"):
        separate(tmp_path / "rec", take)
    (tmp_path / "Models_Test Cloth.xml").write_text(model_xml(), encoding="utf-8")
    data = open_dataset("hatt", tmp_path)
    assert data.materials == ("Test Cloth",)
    first, second = data.recordings("Test Cloth")
    assert first.source != second.source
    assert data.process("Test Cloth") is not None


def test_a_vibrating_force_does_not_enter_the_action(tmp_path):
    (recording,) = one_file(tmp_path, compound(force=1.0 + 0.2 * np.sin(2 * np.pi * 90 * TIME)))
    assert recording.action.force[10:-10].std() < 1e-3


def test_force_of_the_other_sign_is_turned_and_said(tmp_path):
    (recording,) = one_file(tmp_path, compound(force=-FORCE))
    assert recording.action.force.mean() == pytest.approx(1.0, abs=0.05)
    assert "force is negative on average: its sign is turned" in recording.notes


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not well-formed"),
        (compound()[:5000], "not well-formed"),
        ("\x00\x01\x02accel", "not well-formed"),
        ('<!DOCTYPE a [<!ENTITY x "1 2 3 4">]><accel>&x;</accel>', "DTD"),
        ("<accel/>", "no signal"),
        (compound(units="stone"), "stone.*acceleration"),
        (compound(rate="fast"), "'fast' is no sample rate"),
        (compound(rate="-10000"), "no sample rate"),
        (compound(body=lambda tag, text: text + " nan" * (tag == "AccelX")), "AccelX.*value 5001 is not finite"),
        (compound(body=lambda tag, text: text + " x" * (tag == "AccelX")), "AccelX.*'x'"),
        (compound(body=lambda tag, text: text[:9000] if tag == "AccelX" else text), "axes of acceleration"),
        (compound(body=lambda tag, text: text[:9000] if tag == "ForceNormal" else text), "do not belong together"),
        (compound(body=lambda tag, text: "" if tag.startswith("Accel") else text), "no acceleration"),
        (listed("accel", range(20)), "0.002 s only"),
        ("<accel>" + "<value>1</value>" * 9 + "<value/></accel>", r"\[0, 1\] numbers each"),
    ],
    ids=["empty", "truncated", "binary", "bomb", "bare", "unit", "rate", "negative", "nan", "word", "axes", "lengths",
         "force only", "short", "blank"],
)  # fmt: skip
def test_a_bad_file_is_refused_with_what_and_where(tmp_path, text, message):
    (tmp_path / "Accel").mkdir()
    (tmp_path / "Accel" / "Recording_Test Cloth.xml").write_text(text, encoding="utf-8")
    data = open_dataset("hatt", tmp_path)
    with pytest.raises(FileError, match=rf"Recording_Test Cloth\.xml.*{message}"):
        data.recordings("test cloth")


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 60_000), st.binary(min_size=1, max_size=4))
def test_damage_anywhere_is_a_recording_or_a_file_error(tmp_path_factory, place, junk):
    data = compound(np.round(ACCELERATION[:2000], 3), FORCE[:2000]).encode()
    folder = tmp_path_factory.getbasetemp() / "Accel"
    folder.mkdir(exist_ok=True)
    place %= len(data)
    (folder / "a_Cloth.xml").write_bytes(data[:place] + junk + data[place + len(junk) :])
    try:
        recordings = open_dataset("hatt", folder.parent / "Accel").recordings("Cloth")
    except FileError:
        return
    assert all(np.isfinite(recording.samples).all() for recording in recordings)


def test_only_plain_arrays_leave_the_room(tmp_path):
    """A recording from a model is what one built from arrays is: same fields and bytes, nothing of the model."""
    (tmp_path / "Models_Test Cloth.xml").write_text(model_xml(), encoding="utf-8")
    action = make_random_smooth_action(0.3, 1, speed_m_s=(0.1, 0.2), force_n=(2.0, 4.0))
    recording = open_dataset("hatt", tmp_path).process("test cloth").record([action], 5)[0]
    plain = Recording(
        action=Action(
            200.0, action.direction.copy(), action.speed.copy(), action.force.copy(), action.position.copy(),
            action.contact.copy(),
        ),
        samples=np.array(recording.samples.tolist()),
        sample_rate=10_000.0,
        material="Test Cloth",
        source=recording.source,
        known=frozenset({"speed", "force"}),
    )  # fmt: skip
    assert type(recording) is type(plain)
    for ours, theirs in zip(leaves(recording), leaves(plain), strict=True):
        assert ours == theirs
    assert recording.samples.base is None  # a view would hold on to the company's noise
    assert not any(isinstance(leaf, TextureModel) for leaf in leaves(recording))


def leaves(thing) -> list:
    """Everything a recording holds, arrays as type and bytes; fails on what is not array, text, number or tuple."""
    if dataclasses.is_dataclass(thing):
        assert set(vars(thing)) == {field.name for field in dataclasses.fields(thing)}
        return [leaf for field in dataclasses.fields(thing) for leaf in leaves(getattr(thing, field.name))]
    if isinstance(thing, np.ndarray):
        return [(thing.dtype.str, thing.shape, thing.tobytes())]
    if isinstance(thing, tuple | frozenset):
        return [leaf for part in sorted(thing) for leaf in leaves(part)]
    assert thing is None or isinstance(thing, str | float), type(thing)
    return [thing]
