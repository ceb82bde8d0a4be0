"""Lines of a regular surface, such as a weave, a rib or a knurl: where they are in a token, and what F_Θ gives them.

A lattice sounds at κ |cos δ| v for each of its waves. Each token band has two lines, along the axis of its waves and
across it; each of them and its second and third harmonic have an output of F_Θ of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...material.token import BAND_FEATURES, BAND_WAVELENGTHS_M, CLEAR_PEAK_SHARE
from ..carriers import ARC_PER_OCTAVE, Carriers

Float = NDArray[np.float64]

LINE_COUNT = 2 * len(BAND_WAVELENGTHS_M)
HARMONICS = (1, 2, 3)
HARMONIC_START_DB = (0.0, -25.0, -30.0)
"""Initial level of each harmonic relative to the tone [dB]."""
HARMONIC_SHIFTS = tuple(round(ARC_PER_OCTAVE * float(np.log2(harmonic))) for harmonic in HARMONICS)
HARMONIC_START_LOG = tuple(level * np.log(10.0) / 20.0 for level in HARMONIC_START_DB)
LINE_GAIN_COUNT = LINE_COUNT * len(HARMONICS)
"""Outputs of the α head for tones: by harmonic, then by line."""
LINE_FLOOR_M_S2 = 1e-5


@dataclass(frozen=True)
class SpectralLines:
    """Tones of a regular surface (weave, knurl, grating) under n states of the hand.

    power: (2, n, LINE_COUNT) acceleration power [(m/s²)²] in the two arc carriers (bands along the path) on either side
    of each tone. low: (n, LINE_COUNT) index of the lower one, which may lie outside the carriers.
    """

    power: Float
    low: NDArray[np.intp]


def encode_line_prior(lines: SpectralLines) -> Float:
    """Return the tones as columns (n, 3 LINE_COUNT), which are appended to the prior of the network.

    Log amplitude in the lower and in the upper of the two carriers about each tone, then the index of the lower one.
    """
    level = 0.5 * np.log(lines.power + LINE_FLOOR_M_S2**2)
    return np.concatenate([level[0], level[1], lines.low.astype(np.float64)], axis=1)


def compute_line_power(gains: Float, columns: Float, count: int, ceiling: float) -> Float:
    """Compute the power of the tones per arc carrier, (n, count).

    gains: (n, LINE_GAIN_COUNT) learned log gains of the tones and their harmonics. columns: (n, 3 LINE_COUNT) of
    encode_line_prior. count: number of arc carriers. ceiling: largest log amplitude.
    """
    rows = np.broadcast_to(np.arange(len(gains))[:, None], (len(gains), LINE_COUNT))
    low = columns[:, 2 * LINE_COUNT :].astype(np.intp)
    out = np.zeros((len(gains), count))
    for order, (shift, start) in enumerate(zip(HARMONIC_SHIFTS, HARMONIC_START_LOG, strict=True)):
        gain = gains[:, order * LINE_COUNT : (order + 1) * LINE_COUNT] + start
        for tap in range(2):
            power = np.exp(2.0 * np.minimum(gain + columns[:, tap * LINE_COUNT : (tap + 1) * LINE_COUNT], ceiling))
            index = low + (shift + tap)
            inside = (index >= 0) & (index < count)
            np.add.at(out, (rows[inside], index[inside]), power[inside])
    return out


def split_bands(tokens: NDArray[np.float32] | Float) -> dict[str, Float]:
    """Return each of BAND_FEATURES of tokens (n, TOKEN_DIM) in their bands, (n, bands)."""
    bands = len(BAND_WAVELENGTHS_M)
    values = np.asarray(tokens, dtype=np.float64)[:, : bands * len(BAND_FEATURES)]
    return dict(zip(BAND_FEATURES, np.moveaxis(values.reshape(-1, bands, len(BAND_FEATURES)), 2, 0), strict=True))


def compute_line_wavenumbers(feature: dict[str, Float]) -> Float:
    """Return the wavenumber (n, bands) of the line that each band may have [cycles/m].

    A token scales the offset of a weak wave down, so that similar surfaces keep similar tokens.
    """
    scale = np.clip(feature["peak"] / CLEAR_PEAK_SHARE, LEAST_OFFSET_SCALE, 1.0)
    return np.asarray(2.0 ** np.clip(feature["offset"] / scale, -0.5, 0.5) / BAND_WAVELENGTHS_M)


LINE_SHARES = (2.0, 0.85, 0.5, 0.2, 0.1, 0.08, 0.05)
"""Share of a token band's power in its strongest wave from which on it is a line and no noise, by band.

A patch of noise has a strongest wave too, the stronger the fewer waves of the band fit into it. At 8 mm none is a line:
a tile of 20 mm holds too few such waves to tell. Of the library's materials without a lattice, only brushed metal and
the grooves of bamboo have lines by these.
"""
LEAST_OFFSET_SCALE = 0.05
"""Least scale of an offset; no line is so weak a share of its band."""
LEAST_ACROSS = 0.15
"""Power across the ribs over that along them below which there are none across."""
LARGEST_SPREAD = 1.0
"""Largest variance of a line's phase by the scatter of its pitch [rad²]: beyond, hardly a line is left."""
MOST_TAKEN = 0.9
"""Largest share of a carrier's noise that belongs to lines."""


@dataclass(frozen=True)
class PathLines:
    """Lines of a regular surface along the path, at n states.

    Attributes
    ----------
    column : ndarray of int, shape (n, L)
        Which of the LINE_COUNT lines of the linear contact these are: of a band's two, the first is that within 45° of
        the stroke.
    pitch_wavenumber : ndarray, shape (n, L)
        Wavenumber across the line's crests [cycles/m]; 0 where the material touched does not have the line.
    wavenumber : ndarray, shape (n, L)
        Wavenumber along the path [cycles/m].
    """

    column: NDArray[np.intp]
    pitch_wavenumber: Float
    wavenumber: Float

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> PathLines:
        return PathLines(self.column[rows], self.pitch_wavenumber[rows], self.wavenumber[rows])

    def compute_tone_wavenumbers(self) -> Float:
        """Return the wavenumbers (n, L · harmonics) of the tones along the path, the harmonics of a line together."""
        return np.asarray((self.wavenumber[:, :, None] * np.array(HARMONICS)).reshape(len(self.wavenumber), -1))


@dataclass(frozen=True)
class Lines:
    """Lines of the height spectra of M materials, L in all.

    Attributes
    ----------
    column : ndarray of int, shape (L,)
        Which of a token's LINE_COUNT lines these are: by band, first along the axis of its waves, then across it.
    wavenumber : ndarray, shape (M, L)
        Wavenumber [cycles/m]; 0 where a material does not have the line.
    angle : ndarray, shape (M, L)
        Direction of the line's wave in the tangent frame [rad].
    """

    column: NDArray[np.intp]
    wavenumber: Float
    angle: Float

    @property
    def count(self) -> int:
        """Number L of lines."""
        return self.wavenumber.shape[1]

    @property
    def tone_count(self) -> int:
        """Number of tones: of all lines with their harmonics."""
        return self.count * len(HARMONICS)

    def select(self, material: int) -> Lines:
        """Return the lines of one material, in the same columns."""
        row = slice(material, material + 1)
        return Lines(self.column, self.wavenumber[row], self.angle[row])

    def project(self, material: NDArray[np.int32], direction: Float) -> PathLines:
        """Project the lines onto the path. material: (n,) at each state. direction: (n, 2) unit vectors."""
        angle, wavenumber = np.arctan2(direction[:, 1], direction[:, 0])[:, None], self.wavenumber[material]
        off = self.angle[material] - angle
        return PathLines(self.find_columns(off), wavenumber, wavenumber * np.abs(np.cos(off)))

    def find_columns(self, off: Float) -> NDArray[np.intp]:
        """Return which lines of the linear contact (…, L) these are, by their waves' angles `off` the stroke [rad]."""
        bands = LINE_COUNT // 2
        # Decided by the line along the axis alone, so that a pair at 45° is never one and the same.
        is_across, of_axis = self.column >= bands, np.where(self.column >= bands, off - 0.5 * np.pi, off)
        is_turned = np.abs(np.cos(of_axis)) < np.sqrt(0.5)
        return np.asarray(self.column % bands + bands * (is_across ^ is_turned), dtype=np.intp)


def find_lines(tokens: NDArray[np.float32]) -> Lines:
    """Find the lines of material tokens (M, TOKEN_DIM): along the axis of a band's waves, and across it."""
    return _find_lines(np.asarray(tokens, dtype=np.float32).tobytes(), len(tokens))


@lru_cache(maxsize=64)
def _find_lines(tokens: bytes, materials: int) -> Lines:
    """Find the lines of tokens given as bytes: strokes over the same materials ask for them again and again."""
    feature = split_bands(np.frombuffer(tokens, dtype=np.float32).reshape(materials, -1))
    axis = 0.25 * np.arctan2(feature["sin4"], feature["cos4"])
    twofold = feature["cos2"] * np.cos(2.0 * axis) + feature["sin2"] * np.sin(2.0 * axis)
    along, fourfold = np.clip(0.5 * (1.0 + twofold), 0.0, 1.0), np.hypot(feature["cos4"], feature["sin4"])
    is_line = np.concatenate(list(compute_line_shares(feature["peak"], along, fourfold) > 0.0), axis=1)
    column = np.flatnonzero(is_line.any(axis=0))
    wavenumber = np.where(is_line, np.tile(compute_line_wavenumbers(feature), 2), 0.0)
    angle = np.concatenate([axis, axis + 0.5 * np.pi], axis=1)
    # Taking columns leaves arrays in Fortran's order, which the kernel does not read.
    lines = Lines(column, np.ascontiguousarray(wavenumber[:, column]), np.ascontiguousarray(angle[:, column]))
    for shared in (lines.column, lines.wavenumber, lines.angle):
        shared.setflags(write=False)
    return lines


def compute_line_shares(peak: Float, along: Float, fourfold: Float) -> Float:
    """Compute the shares (2, …, bands) of each band's power in its lines along the axis of its waves and across it.

    Parameters
    ----------
    peak
        (…, bands) share of a band's power in its strongest wave, of a token.
    along
        (…, bands) share of its waves along the axis, 0 … 1.
    fourfold
        (…, bands) size of the four-fold moment of its waves' directions, 0 … 1.

    Returns
    -------
    ndarray
        Shares, together 1 at most; 0 where there is no line: for a wave that noise would have too (`LINE_SHARES`), and
        across ribs. Noise without a direction lowers both moments alike, so lines p along the axis and q across it
        give a two-fold moment p − q and a four-fold one p + q.
    """
    stronger, twofold = np.maximum(along, 1.0 - along), 2.0 * along - 1.0
    shares = np.stack([peak * along / stronger, peak * (1.0 - along) / stronger])
    ribs = np.stack([fourfold + twofold, fourfold - twofold])
    shares = np.where((shares > LINE_SHARES) & (ribs > LEAST_ACROSS * ribs.max(axis=0)), shares, 0.0)
    return np.asarray(np.clip(shares / np.maximum(shares.sum(axis=0), 1.0), 0.0, 1.0))


def take_tones(
    gains: Float, level: Float, low: NDArray[np.intp], lines: PathLines, count: int, ceiling: float
) -> Float:
    """Take the power of a surface's lines out of what F_Θ adds to its arc carriers, as amplitudes of tones.

    Parameters
    ----------
    gains
        (n, LINE_GAIN_COUNT) learned log gains of the lines and their harmonics.
    level
        (n, 2, LINE_COUNT) power that the linear contact gives the lines in the two arc carriers about each
        [(m/s²)²]; what is taken is 0 afterwards.
    low
        (n, LINE_COUNT) index of the lower of the two carriers.
    lines
        Lines at the n states.
    count
        Number of arc carriers.
    ceiling
        Largest log amplitude.

    Returns
    -------
    ndarray
        (n, L · harmonics) RMS of the tones [m/s²], the harmonics of a line together.
    """
    has_line, rows = lines.pitch_wavenumber > 0.0, np.arange(len(level))[:, None]
    taken = np.where(has_line[:, None, :], np.take_along_axis(level, lines.column[:, None, :], axis=2), 0.0)
    level[np.broadcast_to(rows, has_line.shape)[has_line], :, lines.column[has_line]] = 0.0
    power = np.zeros((*has_line.shape, len(HARMONICS)))
    for order, (shift, start) in enumerate(zip(HARMONIC_SHIFTS, HARMONIC_START_LOG, strict=True)):
        louder = np.exp(2.0 * (gains[rows, order * LINE_COUNT + lines.column] + start))
        for tap in range(2):
            carrier = low[rows, lines.column] + (shift + tap)
            inside = (carrier >= 0) & (carrier < count)
            power[:, :, order] += inside * np.minimum(louder * taken[:, tap], np.exp(2.0 * ceiling))
    return np.sqrt(power).reshape(len(power), -1)


def gather_sidebands(arc: Float, tones: Float, lines: PathLines, pitch_scatter: Float, carriers: Carriers) -> None:
    """Give lines the power that the scatter of their pitch spreads about them, in place of the noise, in place.

    Parameters
    ----------
    arc
        (n, Ka) amplitudes of the arc carriers.
    tones
        (n, L · harmonics) RMS of the tones without what is spread: what stays of a wave in phase with itself.
    lines
        Lines at the n states.
    pitch_scatter
        (n,) RMS displacement of the lattice along each axis [m].
    carriers
        Carriers of the field.

    Notes
    -----
    A wave whose phase is normally distributed with variance σ² keeps exp(−σ²) of its power in step with an even one
    (the characteristic function of a normal distribution, squared); here σ = 2π κ times the displacement. A token
    counts the rest as noise of its band, and so does F_Θ; it is taken from the octave about the line on either side.
    Second and third harmonics are 25 dB weaker, and their sidebands stay noise.
    """
    spread = np.minimum(np.square(2.0 * np.pi * lines.pitch_wavenumber * pitch_scatter[:, None]), LARGEST_SPREAD)
    fundamental = tones[:, :: len(HARMONICS)]
    wanted = np.square(fundamental) * np.expm1(spread)
    octaves = np.log2(carriers.arc_centres()) - np.log2(np.maximum(lines.wavenumber, 1e-9))[:, :, None]
    near, power = np.maximum(1.0 - np.abs(octaves), 0.0), np.square(arc)
    available = np.einsum("nlk,nk->nl", near, power)
    share = np.divide(wanted, available, out=np.zeros_like(wanted), where=available > 0.0)
    taken = np.einsum("nlk,nl->nk", near, share)
    limit = np.minimum(1.0, MOST_TAKEN / np.maximum(taken, MOST_TAKEN))
    given = share * np.einsum("nlk,nk->nl", near, power * limit)
    tones[:, :: len(HARMONICS)] = np.sqrt(np.square(fundamental) + given)
    arc *= np.sqrt(1.0 - taken * limit)


def find_nearest_carriers(wavenumber: Float, carriers: Carriers) -> NDArray[np.intp]:
    """Return the index of the arc carrier nearest to each wavenumber [cycles/m], of any shape."""
    octaves = np.log2(np.maximum(wavenumber, 1e-9) / carriers.arc_centres()[0])
    return np.asarray(np.clip(np.rint(ARC_PER_OCTAVE * octaves), 0, carriers.arc_count - 1), dtype=np.intp)
