"""Splat files: both .ply layouts round trip in any number format, order and block size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from splat_files import (
    C0,
    angles_between,
    floats,
    inria_columns,
    ply_bytes,
    random_splats,
    write_compressed,
)

from data_tools.write_splats import write_inria
from hnf_core.errors import UsageError
from hnf_core.scene.ply import PlyHeader, read_ply_header
from hnf_core.scene.splats.gaussians import Box, Splats
from hnf_core.scene.splats.io_ply import detect_up_axis
from hnf_core.scene.splats.splat_file import (
    iter_validated_splats,
    open_splat_file,
    read_splats,
    read_validated_splats,
)

REAL = Path(__file__).resolve().parents[4] / "shared" / "data" / "splats"
FIELDS = ("means", "scales", "rotations", "opacities", "harmonics")


def in_a_folder(examples: int) -> settings:
    """Each example writes over the last one's files."""
    quiet = [HealthCheck.function_scoped_fixture]
    return settings(max_examples=examples, suppress_health_check=quiet, deadline=None)


def same(one: Splats, other: Splats) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def joined(pieces: list[Splats]) -> Splats:
    return Splats(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in FIELDS))


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same 600 splats of degree 1: three layouts."""
    folder = tmp_path_factory.mktemp("splats")
    splats = random_splats(600, 1)
    write_inria(folder / "inria.ply", splats)
    write_compressed(folder / "compressed.ply", splats)
    (folder / "ascii.ply").write_bytes(ply_bytes([("vertex", floats(inria_columns(splats)))], "ascii"))
    return {path.stem: path for path in folder.glob("*.ply")}


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_what_is_written_is_read_back(tmp_path: Path, degree: int) -> None:
    splats = random_splats(300, degree, seed=degree)
    write_inria(tmp_path / "a.ply", splats)
    found = read_validated_splats(tmp_path / "a.ply")
    assert (found.total, found.thickened, sum(found.dropped.values())) == (300, 0, 0)
    assert found.splats.degree == degree
    np.testing.assert_array_equal(found.splats.means, splats.means)
    np.testing.assert_array_equal(found.splats.harmonics, splats.harmonics)
    np.testing.assert_allclose(found.splats.scales, splats.scales, rtol=1e-6)
    np.testing.assert_allclose(found.splats.rotations, splats.rotations, atol=1e-7)
    np.testing.assert_allclose(found.splats.opacities, splats.opacities, atol=1e-7)
    before = (tmp_path / "a.ply").read_bytes()
    write_inria(tmp_path / "a.ply", splats)
    assert (tmp_path / "a.ply").read_bytes() == before


def test_opacities_of_0_and_1_are_kept_with_finite_logits(tmp_path: Path) -> None:
    splats = random_splats(3)
    splats.opacities[:] = [0.0, 1.0, np.nextafter(np.float32(1.0), np.float32(0.0))]
    write_inria(tmp_path / "a.ply", splats)
    np.testing.assert_array_equal(read_splats(tmp_path / "a.ply").opacities, splats.opacities)
    data = (tmp_path / "a.ply").read_bytes()
    header = read_ply_header(tmp_path / "a.ply")
    assert np.isfinite(np.frombuffer(data[header.data_offset :], "<f4")).all()


@in_a_folder(15)
@given(
    random=st.randoms(use_true_random=False),
    form=st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]),
    word=st.sampled_from(["float", "double"]),
    extras=st.booleans(),
)
def test_reading_ignores_order_endianness_width_and_extras(
    tmp_path: Path, random, form: str, word: str, extras: bool
) -> None:
    splats = random_splats(20, 2)
    columns = {name: numbers.astype(np.float32) for name, numbers in inria_columns(splats).items()}
    (tmp_path / "plain.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    typed = floats(columns, word)
    if extras:
        typed |= floats(dict.fromkeys(("nx", "ny", "nz", "error"), np.full(20, 7.0)))
        typed |= {"label": ("uchar", np.full(20, 10))}
    names = list(typed)
    random.shuffle(names)
    elements = [("vertex", {name: typed[name] for name in names})]
    if extras:
        elements = [("camera", floats({"focal": np.ones(3)})), *elements, ("size", {"pixels": ("uint", np.ones(2))})]
    (tmp_path / "other.ply").write_bytes(ply_bytes(elements, form))
    same(read_splats(tmp_path / "plain.ply"), read_splats(tmp_path / "other.ply"))


def test_higher_coefficients_are_stored_channel_by_channel(tmp_path: Path) -> None:
    columns = inria_columns(random_splats(1, 1))
    columns |= {f"f_rest_{number}": np.array([float(number)]) for number in range(9)}
    (tmp_path / "a.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    harmonics = read_splats(tmp_path / "a.ply").harmonics
    np.testing.assert_array_equal(harmonics[0, 1:], [[0, 3, 6], [1, 4, 7], [2, 5, 8]])


@in_a_folder(10)
@given(factor=st.floats(1e-6, 1e6))
def test_the_length_of_a_rotation_does_not_matter(tmp_path: Path, factor: float) -> None:
    splats = random_splats(20)
    columns = inria_columns(splats)
    columns |= {f"rot_{part}": factor * columns[f"rot_{part}"] for part in range(4)}
    (tmp_path / "a.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    np.testing.assert_allclose(read_splats(tmp_path / "a.ply").rotations, splats.rotations, atol=3e-7)


def test_a_plain_colour_is_the_constant_coefficient(tmp_path: Path) -> None:
    """nerfstudio's export in its colour mode 'rgb'."""
    columns = floats(
        {name: each for name, each in inria_columns(random_splats(4)).items() if not name.startswith("f_")}
    )
    painted = np.array([0, 51, 128, 255])
    columns |= dict.fromkeys(("red", "green", "blue"), ("uchar", painted))
    (tmp_path / "a.ply").write_bytes(ply_bytes([("vertex", columns)]))
    colours = 0.5 + C0 * read_splats(tmp_path / "a.ply").harmonics[:, 0]
    np.testing.assert_allclose(colours, np.repeat(painted[:, None] / 255.0, 3, axis=1), atol=1e-6)


def test_two_scales_are_flat_splats(tmp_path: Path) -> None:
    """2-D Gaussian Splatting: the third axis gets the thinnest scale, like a scale of 0."""
    columns = inria_columns(random_splats(4))
    del columns["scale_2"]
    (tmp_path / "two.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    columns["scale_2"] = np.full(4, -np.inf)
    (tmp_path / "three.ply").write_bytes(ply_bytes([("vertex", floats(columns))]))
    found = read_splats(tmp_path / "two.ply")
    same(found, read_splats(tmp_path / "three.ply"))
    assert (found.scales[:, 2] > 0.0).all()
    assert (found.scales[:, 2] < 1e-8).all()


@pytest.mark.parametrize(("count", "degree", "bounds"), [(1, 0, True), (257, 3, True), (300, 1, False), (512, 2, True)])
def test_compressed_agrees_within_its_steps(tmp_path: Path, count: int, degree: int, bounds: bool) -> None:
    splats = random_splats(count, degree, seed=count)
    write_compressed(tmp_path / "a.ply", splats, bounds_of_colour=bounds)
    found = read_splats(tmp_path / "a.ply")
    assert (len(found), found.degree) == (count, degree)
    # Half a step of the range: 2 units of centre, 4 of log-scale, of 11-10-11 bits.
    steps = 0.5 / np.array([2047.0, 1023.0, 2047.0])
    assert (np.abs(found.means - splats.means) <= 2.0 * steps + 1e-6).all()
    assert (np.abs(np.log(found.scales) - np.log(splats.scales)) <= 4.0 * steps + 1e-6).all()
    # Half a step in each of three parts, and what it moves the fourth, which is 1/2 at least: a chord of 2 √3 halves.
    assert (angles_between(found, splats) <= 4.0 * np.sqrt(3.0) * np.sqrt(2.0) * 0.5 / 1023.0 + 1e-6).all()
    assert (np.abs(found.opacities - splats.opacities) <= 0.5 / 255.0 + 1e-6).all()
    wanted, width = (splats.harmonics[:, 0], 4.0) if bounds else (np.clip(splats.harmonics[:, 0], *CLIPPED), 1.0 / C0)
    assert (np.abs(found.harmonics[:, 0] - wanted) <= width * 0.5 / 255.0 + 1e-6).all()
    assert (np.abs(found.harmonics[:, 1:] - splats.harmonics[:, 1:]) <= 4.0 / 256.0 + 1e-6).all()


CLIPPED = (-0.5 / C0, 0.5 / C0)


@pytest.mark.parametrize("layout", ["inria", "compressed", "ascii"])
@in_a_folder(6)
@given(chunk=st.integers(1, 700))
def test_blocks_of_any_size_are_the_whole(files: dict[str, Path], layout: str, chunk: int) -> None:
    chunk = max(chunk, 10 if layout == "ascii" else 3)
    pieces = [reading.splats for reading in iter_validated_splats(files[layout], open_splat_file(files[layout]), chunk)]
    assert [len(piece) for piece in pieces[:-1]] == [chunk] * (len(pieces) - 1)
    same(joined(pieces), read_splats(files[layout]))


@pytest.mark.parametrize("layout", ["inria", "compressed"])
@in_a_folder(10)
@given(data=st.data())
def test_a_box_holds_the_splats_whose_centre_it_holds(files: dict[str, Path], layout: str, data: st.DataObject) -> None:
    ends = np.array(data.draw(st.lists(st.floats(-1.25, 1.25, width=32), min_size=6, max_size=6))).reshape(2, 3)
    box = Box(tuple(ends.min(axis=0).tolist()), tuple(ends.max(axis=0).tolist()))
    whole = read_splats(files[layout])
    inside = [all(box.low[i] <= mean[i] <= box.high[i] for i in range(3)) for mean in whole.means.tolist()]
    found = read_validated_splats(files[layout], within=box)
    same(found.splats, whole.take(np.array(inside)))
    assert found.total == 600
    corner = tuple(whole.means[7].tolist())
    assert len(read_splats(files[layout], within=Box(corner, corner))) == 1


@pytest.mark.parametrize("newline", [b"\n", b"\r\n", b"\r"])
@pytest.mark.parametrize("first", [0x0A, 0x0D, 0x20])
def test_data_begin_after_the_header_whatever_ends_its_lines(tmp_path: Path, newline: bytes, first: int) -> None:
    """Also where the first byte of data looks like another end of line."""
    columns = inria_columns(random_splats(5))
    columns["x"] = np.frombuffer(np.array([first, 0, 0x80, 0x3F], np.uint8).tobytes(), "<f4").repeat(5)
    data = ply_bytes([("vertex", floats(columns))], comments=["end_header is not here"])
    head, end, rest = data.partition(b"\nend_header\n")
    (tmp_path / "a.ply").write_bytes((head + end).replace(b"\n", newline) + rest)
    np.testing.assert_array_equal(read_splats(tmp_path / "a.ply").means[:, 0], columns["x"])


def header(comments: list[str], packed: bool = False) -> PlyHeader:
    names = ("packed_position", "packed_scale") if packed else ("f_dc_0", "opacity", "scale_0", "rot_0")
    return PlyHeader({"vertex": (1, names), **({"chunk": (1, ())} if packed else {})}, comments=tuple(comments))


@pytest.mark.parametrize(
    ("comments", "axis", "direction"),
    [
        (["Generated by Nerfstudio 1.1.5", "Vertical Axis: z"], "z", (0.0, 0.0, 1.0)),
        (["vertical axis: -Y"], "-y", (0.0, -1.0, 0.0)),
        (["Vertical Axis: x"], "x", (1.0, 0.0, 0.0)),
        (["Vertical Axis: up"], "-y", (0.0, -1.0, 0.0)),
        ([], "-y", (0.0, -1.0, 0.0)),
    ],
)
def test_up_is_what_the_file_says_or_what_training_leaves(comments: list[str], axis: str, direction: tuple) -> None:
    for packed in (False, True):
        up = detect_up_axis(header(comments, packed))
        assert (up.axis, up.direction) == (axis, direction)
    assert (comments[-1] in up.reason) if "Axis: z" in str(comments) else up.reason


def test_comments_of_a_written_file_are_its_own(tmp_path: Path) -> None:
    write_inria(tmp_path / "a.ply", random_splats(2), comments=["Vertical Axis: z"])
    assert detect_up_axis(read_ply_header(tmp_path / "a.ply")).axis == "z"
    before = (tmp_path / "a.ply").read_bytes()
    with pytest.raises(UsageError, match="one line"):
        write_inria(tmp_path / "a.ply", random_splats(2), comments=["two\nelement vertex 9"])
    assert (tmp_path / "a.ply").read_bytes() == before


def real(name: str) -> Path:
    if not (REAL / name).is_file():
        pytest.skip(f"{name} is not beside the repository")
    return REAL / name


def test_the_guitar_is_the_same_in_both_layouts() -> None:
    """The one file is the other one unpacked, splat by splat, by an independent reader; it clips opacity at 1 − 1e-6
    and keeps logarithms in float32."""
    packed, plain = (
        read_validated_splats(real("guitar.compressed.ply")),
        read_validated_splats(real("guitar_decoded_inria.ply")),
    )
    assert packed.total == plain.total == 90_854
    assert sum(packed.dropped.values()) + sum(plain.dropped.values()) == 0
    one, other = packed.splats, plain.splats
    np.testing.assert_allclose(one.means, other.means, atol=1e-6)
    np.testing.assert_allclose(np.log(one.scales), np.log(other.scales), atol=3e-6)
    np.testing.assert_allclose(one.opacities, other.opacities, atol=2e-6)
    np.testing.assert_allclose(one.harmonics, other.harmonics, atol=1e-5)
    assert angles_between(one, other).max() < 1e-6


def test_the_biker_is_read() -> None:
    found = read_validated_splats(real("biker.compressed.ply"))
    assert (found.total, len(found.splats), found.splats.degree) == (152_746, 152_746, 0)
    assert np.isfinite(found.splats.means).all()
    np.testing.assert_allclose(np.linalg.norm(found.splats.rotations, axis=1), 1.0, atol=1e-6)
