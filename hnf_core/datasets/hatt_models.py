"""Texture models of the Penn Haptic Texture Toolkit (HaTT), read from XML, and HaTT's rule of synthesis from them.

H. Culbertson, J. J. López Delgado & K. J. Kuchenbecker (2014), "One hundred data-driven haptic texture models and
open-source methods for rendering on 3D objects", IEEE Haptics Symposium. Line spectral frequencies (LSFs) are the form
of an all-pole filter that can be interpolated and stays stable: a filter is minimum phase exactly if its LSFs rise
strictly within (0, π), and a weighted mean of rising sequences rises (F. Itakura 1975, "Line spectrum representation of
linear predictive coefficients", JASA 57; F. Soong & B.-H. Juang 1984, ICASSP).

To synthesize, the Delaunay triangle around (speed, force) gives barycentric weights; line spectral frequencies,
excitation variance and gain are interpolated with them (never coefficients, since the filter might not be stable). Then
y[n] = Σ_j b_j e[n − j] · gain − Σ_i a_i y[n − i], e ~ N(0, variance). H. Culbertson, J. Unwin & K. J. Kuchenbecker
(2014), "Modeling and rendering realistic textures from unconstrained tool–surface interactions", IEEE Transactions on
Haptics 7(3), sec. 4.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..action.action import ACTION_RATE_HZ, Action
from ..errors import FileError, UsageError
from ..field.resampling import resample
from ..tables import MAX_MEASURABLE, is_measurable, parse_unit_factor
from .data_files import read_xml
from .recording import Recording

Float = NDArray[np.float64]


def polynomial_from_lsf(lsf: ArrayLike) -> Float:
    """Convert line spectral frequencies (…, p) [rad] to filter coefficients (…, p + 1) of A(z) in z⁻¹, the first 1.

    A = (P + Q) / 2; Q has its roots at the 1st, 3rd, … LSF, P at the 2nd, 4th, …. Even p: Q times (1 + z⁻¹) and P times
    (1 − z⁻¹); odd p: P times (1 − z⁻²).
    """
    cosines = np.cos(np.moveaxis(np.asarray(lsf, dtype=np.float64), -1, 0))  # (p, …): long axis last, for speed
    order = len(cosines)
    symmetric, antisymmetric = _multiply_quadratics(cosines[0::2]), _multiply_quadratics(cosines[1::2])
    if order % 2 == 0:
        symmetric = _multiply_polynomials(symmetric, (1.0, 1.0))
        antisymmetric = _multiply_polynomials(antisymmetric, (1.0, -1.0))
    else:
        antisymmetric = _multiply_polynomials(antisymmetric, (1.0, 0.0, -1.0))
    return np.moveaxis(0.5 * (symmetric + antisymmetric)[: order + 1], 0, -1)


def lsf_from_polynomial(coefficients: ArrayLike) -> Float:
    """Convert coefficients (p + 1,) of a minimum-phase A(z), the first 1, to line spectral frequencies (p,) [rad].

    Raises ValueError if the filter is not stable: its LSFs then do not rise within (0, π).
    """
    a = np.asarray(coefficients, dtype=np.float64)
    order = len(a) - 1
    if order < 1 or not np.isfinite(a).all() or a[0] != 1.0:
        raise ValueError("a filter has finite coefficients, the first of them 1.")
    padded = np.append(a, 0.0)
    if np.max(np.abs(np.roots(a)), initial=0.0) >= 1.0:
        raise ValueError("the filter is not stable.")
    angles = [np.angle(np.roots(padded + sign * padded[::-1])) for sign in (1.0, -1.0)]
    roots_in_range = [np.sort(angle[(angle > 1e-9) & (angle < np.pi - 1e-9)]) for angle in angles]
    lsf = np.sort(np.concatenate(roots_in_range))
    if len(lsf) != order or np.any(np.diff(lsf) <= 0.0):
        raise ValueError("the filter is too close to instability.")
    return lsf


def _multiply_quadratics(cosines: Float) -> Float:
    """Return the coefficients (2k + 1, …) of Π (1 − 2 cos ω z⁻¹ + z⁻²), given cos ω (k, …)."""
    product = np.ones((1, *cosines.shape[1:]))
    for cosine in cosines:
        extended = np.zeros((len(product) + 2, *product.shape[1:]))
        extended[: len(product)] = product
        extended[1:-1] -= 2.0 * cosine * product
        extended[2:] += product
        product = extended
    return product


def _multiply_polynomials(polynomial: Float, factor: tuple[float, ...]) -> Float:
    product = np.zeros((len(polynomial) + len(factor) - 1, *polynomial.shape[1:]))
    for shift, weight in enumerate(factor):
        if weight:
            product[shift : shift + len(polynomial)] += weight * polynomial
    return product


MIN_FILTER_RATE_HZ, MAX_FILTER_RATE_HZ = 500.0, 1e5
"""Accepted sample rates of filters [Hz]; the toolkit has 1 and 10 kHz."""
_TOOLKIT_REMEDY = "Get the file again from the toolkit."


@dataclass(frozen=True)
class TextureModel:
    """A HaTT model: filters at V points of the speed–force plane, and a triangulation. SI units.

    Attributes
    ----------
    material : str
        Name of the material.
    source : str
        File, for messages.
    sample_rate : float
        Sample rate of the filters [Hz].
    speeds, forces : ndarray, shape (V,)
        Speed [m/s] and force [N] of each filter.
    triangles : ndarray of int64, shape (T, 3)
        Corners, as indices into speeds and forces, from 0 (the file counts from 1).
    ar_lsf : ndarray, shape (V, p)
        Line spectral frequencies of the autoregressive part, in (0, π).
    ma_lsf : ndarray, shape (V, q)
        Line spectral frequencies of the moving average; q = 0 if there is none.
    variances : ndarray, shape (V,)
        Variance of the excitation [(m/s²)²].
    gains : ndarray, shape (V,)
        Gain of each filter; 1 in autoregressive models.
    friction : float or None
        Coulomb μ, if the file has it.
    max_speed, max_force : float
        Largest speed [m/s] and force [N] of the model.
    notes : tuple of str
        Assumptions of the reader.
    """

    material: str
    source: str
    sample_rate: float
    speeds: Float
    forces: Float
    triangles: NDArray[np.int64]
    ar_lsf: Float
    ma_lsf: Float
    variances: Float
    gains: Float
    friction: float | None
    max_speed: float
    max_force: float
    notes: tuple[str, ...] = ()


def read_texture_model(path: Path) -> TextureModel:
    """Read a HaTT texture model file (10 kHz AR or 1 kHz ARMA filters).

    Case of tags and blanks do not matter. Missing units, counts and maxima are assumed as the toolkit has them, and
    noted; missing LSFs are computed from the coefficients. Raises FileError, with the location in the file, for
    everything that makes no usable model.
    """
    where = str(path)
    root = next((element for element in read_xml(path).iter() if element.tag.lower() == "modelset"), None)
    if root is None:
        raise FileError("there is no modelSet in it.", where=where, remedy="Give a HaTT model (Models_….xml).")
    notes: list[str] = []
    speed_unit, force_unit, accel_unit = (
        _read_unit(root, tag, quantity, default, where, notes)
        for tag, quantity, default in (
            ("SpeedUnits", "speed", "mm/s"),
            ("ForceUnits", "force", "N"),
            ("AccelUnits", "acceleration", "m/s^2"),
        )
    )
    models = [child for child in root if child.tag.lower() == "model"]
    count = _check_count(root, "numMod", len(models), "models", where)
    speeds = speed_unit * _read_vertices(root, models, "speedList", "speedMod", count, where)
    forces = force_unit * _read_vertices(root, models, "forceList", "forceMod", count, where)
    ar_lsf, ma_lsf, variances, gains = _read_filters(models, where)
    return TextureModel(
        material=_read_text(root, "material") or path.stem.removeprefix("Models_"),
        source=where,
        sample_rate=_read_sample_rate(root, where, notes),
        speeds=speeds,
        forces=forces,
        triangles=_read_triangles(root, speeds, forces, where, notes),
        ar_lsf=ar_lsf,
        ma_lsf=ma_lsf,
        variances=variances * accel_unit**2,
        gains=gains,
        friction=_read_friction(root, where),
        max_speed=speed_unit * _read_positive(root, "maxSpeed", float(speeds.max()) / speed_unit, where, notes),
        max_force=force_unit * _read_positive(root, "maxForce", float(forces.max()) / force_unit, where, notes),
        notes=tuple(notes),
    )


def _find_child(parent: Element, tag: str) -> Element | None:
    return next((child for child in parent if child.tag.lower() == tag.lower()), None)


def _read_text(parent: Element, tag: str) -> str:
    child = _find_child(parent, tag)
    return " ".join((child.text or "").split()) if child is not None else ""


def _read_unit(root: Element, tag: str, quantity: str, default: str, where: str, notes: list[str]) -> float:
    text = _read_text(root, tag)
    if not text:
        notes.append(f"{tag} is missing: taken as {default}")
    return parse_unit_factor(quantity, text or default, f"{where}, {tag}")


def _read_numbers(element: Element | None, where: str) -> Float:
    """Return the numbers in an XML element's <value> children or its text; empty if there are none."""
    if element is None:
        return np.zeros(0)
    texts: Iterable[str | None] = [child.text for child in element] if len(element) else (element.text or "").split()
    words = [word.strip(",;") for text in texts for word in (text or "").split()]
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError as error:
        raise FileError(f"{error}.", where=where, remedy=_TOOLKIT_REMEDY) from error
    if not is_measurable(numbers).all():
        bad = int(np.argmin(is_measurable(numbers))) + 1
        raise FileError(f"value {bad} is not finite or beyond {MAX_MEASURABLE:g}.", where=where, remedy=_TOOLKIT_REMEDY)
    return numbers


def _read_number(parent: Element, tag: str, where: str) -> float | None:
    numbers = _read_numbers(_find_child(parent, tag), f"{where}, {tag}")
    if len(numbers) > 1:
        raise FileError(f"{len(numbers)} numbers instead of one.", where=f"{where}, {tag}", remedy=_TOOLKIT_REMEDY)
    return float(numbers[0]) if len(numbers) else None


def _read_positive(root: Element, tag: str, default: float, where: str, notes: list[str]) -> float:
    value = _read_number(root, tag, where)
    if value is None:
        notes.append(f"{tag} is missing: taken as {default:g}")
        value = default
    if value <= 0.0:
        raise FileError(f"{value:g} is not above 0.", where=f"{where}, {tag}", remedy=_TOOLKIT_REMEDY)
    return value


def _read_sample_rate(root: Element, where: str, notes: list[str]) -> float:
    rate = _read_positive(root, "SampleRate", 10_000.0, where, notes)
    if not MIN_FILTER_RATE_HZ <= rate <= MAX_FILTER_RATE_HZ:
        raise FileError(f"{rate:g} Hz is no rate of a texture.", where=f"{where}, SampleRate", remedy=_TOOLKIT_REMEDY)
    return rate


def _read_friction(root: Element, where: str) -> float | None:
    value = _read_number(root, "mu", where)
    if value is not None and value < 0.0:
        raise FileError(f"friction {value:g} is negative.", where=f"{where}, mu", remedy=_TOOLKIT_REMEDY)
    return value


def _check_count(root: Element, tag: str, found: int, things: str, where: str) -> int:
    announced_count = _read_number(root, tag, where)
    if found == 0 or (announced_count is not None and announced_count != found):
        suffix = "" if announced_count is None else f", {announced_count:g} announced"
        raise FileError(f"{found} {things}{suffix}.", where=f"{where}, {tag}", remedy=_TOOLKIT_REMEDY)
    return found


def _read_vertices(root: Element, models: list[Element], tag: str, model_tag: str, count: int, where: str) -> Float:
    values = _read_numbers(_find_child(root, tag), f"{where}, {tag}")
    if len(values) == 0:
        per_model = [
            _read_number(model, model_tag, f"{where}, model {index}") for index, model in enumerate(models, start=1)
        ]
        values = np.array([value for value in per_model if value is not None])
    if len(values) != count:
        raise FileError(f"{len(values)} values for {count} models.", where=f"{where}, {tag}", remedy=_TOOLKIT_REMEDY)
    if values.min() < 0.0 or values.max() == 0.0:
        raise FileError("values must be 0 or more, and not all 0.", where=f"{where}, {tag}", remedy=_TOOLKIT_REMEDY)
    return values


def _read_triangles(root: Element, speeds: Float, forces: Float, where: str, notes: list[str]) -> NDArray[np.int64]:
    elements = [child for child in root if child.tag.lower() == "tri"]
    _check_count(root, "numTri", len(elements), "triangles", where)
    rows = [_read_numbers(tri, f"{where}, tri {index}") for index, tri in enumerate(elements, start=1)]
    for index, row in enumerate(rows, start=1):
        if len(row) != 3 or np.any(row != np.round(row)) or row.min() < 1 or row.max() > len(speeds):
            raise FileError(
                f"{row.tolist()} are not three vertices between 1 and {len(speeds)}.",
                where=f"{where}, tri {index}",
                remedy=_TOOLKIT_REMEDY,
            )
    triangles = np.array(rows).astype(np.int64) - 1
    points = np.stack([speeds / speeds.max(), forces / forces.max()], axis=1)[triangles]
    (ax, ay), (bx, by) = (points[:, 1] - points[:, 0]).T, (points[:, 2] - points[:, 0]).T
    degenerate = np.abs(ax * by - ay * bx) < 1e-9
    if degenerate.all():
        raise FileError("no triangle has an area.", where=f"{where}, tri", remedy=_TOOLKIT_REMEDY)
    if degenerate.any():
        notes.append(f"{int(degenerate.sum())} triangles without area left out")
    return np.asarray(triangles[~degenerate])


def _read_filters(models: list[Element], where: str) -> tuple[Float, Float, Float, Float]:
    ar, ma, variances, gains = [], [], [], []
    for index, model in enumerate(models, start=1):
        location = f"{where}, model {index}"
        ar.append(_read_lsf(model, "AR", location))
        ma.append(_read_lsf(model, "MA", location))
        variance, gain = _read_number(model, "var", location), _read_number(model, "gain", location)
        if variance is None or variance < 0.0:
            raise FileError("no variance of 0 or more.", where=f"{location}, var", remedy=_TOOLKIT_REMEDY)
        variances.append(variance)
        gains.append(1.0 if gain is None else gain)
    for name, rows in (("AR", ar), ("MA", ma)):
        for index, row in enumerate(rows, start=1):
            if len(row) != len(ar[0] if name == "AR" else ma[0]):
                raise FileError(
                    f"order {len(row)}, but model 1 has {len(rows[0])}.",
                    where=f"{where}, model {index}, {name}lsf",
                    remedy=_TOOLKIT_REMEDY,
                )
    if len(ar[0]) == 0:
        raise FileError("no autoregressive coefficients.", where=f"{where}, model 1, ARlsf", remedy=_TOOLKIT_REMEDY)
    return np.array(ar), np.array(ma).reshape(len(models), -1), np.array(variances), np.array(gains)


def _read_lsf(model: Element, kind: str, where: str) -> Float:
    lsf = _read_numbers(_find_child(model, f"{kind}lsf"), f"{where}, {kind}lsf")
    coefficients = _read_numbers(_find_child(model, f"{kind}coeff"), f"{where}, {kind}coeff")
    if len(lsf) == 0 and len(coefficients) > 1:
        try:
            return lsf_from_polynomial(coefficients)
        except ValueError as error:
            raise FileError(f"{error}", where=f"{where}, {kind}coeff", remedy=_TOOLKIT_REMEDY) from error
    if len(lsf) and len(coefficients) and len(coefficients) != len(lsf) + 1:
        raise FileError(
            f"{len(lsf)} frequencies beside {len(coefficients)} coefficients.",
            where=f"{where}, {kind}lsf",
            remedy=_TOOLKIT_REMEDY,
        )
    if len(lsf) and (lsf[0] <= 0.0 or lsf[-1] >= np.pi or np.any(np.diff(lsf) <= 0.0)):
        raise FileError(
            "line spectral frequencies must rise between 0 and π: the filter is not stable.",
            where=f"{where}, {kind}lsf",
            remedy=_TOOLKIT_REMEDY,
        )
    return lsf


PROCESS_RATE_HZ = 10_000.0
"""Sample rate of recordings of a model [Hz]."""
CLAMP_MARGIN = 0.01
"""Margin of the toolkit's own clamp: to the maximum less 0.01 mm/s or 0.01 N."""
SILENCE_THRESHOLD, SILENCE_VALUE = 0.05, 1e-4
"""Threshold of the toolkit, 0.05 mm/s or 0.05 N, below which it uses 1e-4 of the unit: practically silence."""
WARM_UP_S = 0.4
"""Duration of the discarded start [s], in which the slowest pole of the hundred models (0.9986 at 10 kHz) decays to 0.4
%."""
_TOLERANCE = 1e-9
_CHUNK_POINTS = 8192


@dataclass(frozen=True)
class LocalFilters:
    """Filters of a texture model, interpolated at n pairs of speed and force.

    Attributes
    ----------
    triangle : ndarray of int64, shape (n,)
        Triangle around each point, a row of the model's triangles.
    weights : ndarray, shape (n, 3)
        Barycentric weights of the triangle's corners.
    ar_lsf : ndarray, shape (n, p)
        Line spectral frequencies of the autoregressive part.
    ma_lsf : ndarray, shape (n, q)
        Line spectral frequencies of the moving average.
    variance : ndarray, shape (n,)
        Variance of the excitation [(m/s²)²].
    gain : ndarray, shape (n,)
        Gain of the excitation.
    clamped_speed, clamped_force : ndarray of bool, shape (n,)
        True if the requested speed or force was outside the model's range.
    """

    triangle: NDArray[np.int64]
    weights: Float
    ar_lsf: Float
    ma_lsf: Float
    variance: Float
    gain: Float
    clamped_speed: NDArray[np.bool_]
    clamped_force: NDArray[np.bool_]


def interpolate_filters(model: TextureModel, speed_m_s: ArrayLike, force_n: ArrayLike) -> LocalFilters:
    """Interpolate a model at speeds (n,) [m/s] and forces (n,) [N]; outside its hull, at the nearest point of it."""
    requested_speed, requested_force = np.broadcast_arrays(
        np.atleast_1d(np.asarray(speed_m_s, dtype=np.float64)), np.atleast_1d(np.asarray(force_n, dtype=np.float64))
    )
    speed, above_speed = _clamp(requested_speed, model.max_speed, 1e-3)
    force, above_force = _clamp(requested_force, model.max_force, 1.0)
    triangle, weights = np.zeros(len(speed), np.int64), np.zeros((len(speed), 3))
    for start in range(0, len(speed), _CHUNK_POINTS):
        chunk = slice(start, start + _CHUNK_POINTS)
        triangle[chunk], weights[chunk] = _find_triangles(model, speed[chunk], force[chunk])
    # A hull need not fill its box: points with a negative weight are outside, and are moved to the triangle's edge.
    is_outside = weights.min(axis=1) < -_TOLERANCE
    weights = np.maximum(weights, 0.0)
    weights /= weights.sum(axis=1, keepdims=True)
    corners = model.triangles[triangle]

    def interpolate(values: Float) -> Float:
        return np.asarray(np.einsum("nk,nk...->n...", weights, values[corners]))

    return LocalFilters(
        triangle, weights, interpolate(model.ar_lsf), interpolate(model.ma_lsf), interpolate(model.variances),
        interpolate(model.gains), above_speed | is_outside, above_force | is_outside,
    )  # fmt: skip


def _clamp(values: Float, largest: float, unit: float) -> tuple[Float, NDArray[np.bool_]]:
    high = values > largest * (1.0 + _TOLERANCE)
    clamped = np.where(high, largest - CLAMP_MARGIN * unit, values)
    return np.where(clamped < SILENCE_THRESHOLD * unit, SILENCE_VALUE * unit, clamped), high


def _find_triangles(model: TextureModel, speed: Float, force: Float) -> tuple[NDArray[np.int64], Float]:
    """Return the model's triangle around each (speed, force), and the barycentric weights of its corners."""
    corner = np.stack([model.speeds / model.max_speed, model.forces / model.max_force], axis=1)[model.triangles]
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    x, y = (speed / model.max_speed)[:, None], (force / model.max_force)[:, None]
    second = ((x - a[:, 0]) * (c[:, 1] - a[:, 1]) - (y - a[:, 1]) * (c[:, 0] - a[:, 0])) / area
    third = ((b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])) / area
    weights = np.stack([1.0 - second - third, second, third], axis=-1)  # (n, T, 3)
    triangle = np.argmax(weights.min(axis=-1), axis=1)
    return triangle, np.asarray(weights[np.arange(len(speed)), triangle])


@dataclass(frozen=True)
class HattProcess:
    """A texture model as a source of recordings: isotropic, one axis, 10 kHz (resampled, and noted, if needed)."""

    model: TextureModel

    @property
    def name(self) -> str:
        """Name of the material."""
        return self.model.material

    def record(self, actions: Sequence[Action], seed: int) -> list[Recording]:
        """Synthesise one recording per action; action i depends on (seed, i) only.

        A model has no direction. The filter of every 5 ms is that of the action at its middle. Signals start as if the
        hand had already been moving; without contact there is no excitation. Raises UsageError if the actions are not
        equally long.
        """
        rate = self.model.sample_rate
        states = _build_states(self.model, actions)
        noise = np.stack(
            [_draw_noise(seed, index, states.samples + states.warm_up) for index in range(len(actions))], 1
        )
        signals = synthesise_autoregressive(states, noise)
        recordings = []
        for index, action in enumerate(actions):
            samples, notes = signals[:, index].copy(), list(states.notes[index])
            if rate != PROCESS_RATE_HZ:
                samples = resample(samples, rate, PROCESS_RATE_HZ)[0]
                notes.append(f"the model's {rate:g} Hz resampled to 10 kHz: nothing above {rate / 2:g} Hz")
            recordings.append(
                Recording(
                    action=action,
                    samples=samples,
                    sample_rate=PROCESS_RATE_HZ,
                    material=self.name,
                    source=f"{self.model.source}, seed {seed}, action {index}",
                    known=frozenset({"speed", "force"}),
                    notes=tuple(notes),
                )
            )
        return recordings


@dataclass(frozen=True)
class FilterStates:
    """Filter coefficients for B actions, constant within each of K blocks of 5 ms.

    Attributes
    ----------
    ar : ndarray, shape (K, p, B)
        Autoregressive coefficients without the leading 1.
    ma : ndarray, shape (K, q + 1, B)
        Moving-average coefficients times gain.
    deviation : ndarray, shape (K, B)
        Standard deviation of the excitation.
    block_samples : int
        Length of a block [samples].
    samples : int
        Number of samples to synthesise.
    warm_up : int
        Number of samples synthesised before them and discarded.
    notes : tuple of tuple of str
        Notes for each action, such as speeds beyond the model.
    """

    ar: Float
    ma: Float
    deviation: Float
    block_samples: int
    samples: int
    warm_up: int
    notes: tuple[tuple[str, ...], ...]


def _build_states(model: TextureModel, actions: Sequence[Action]) -> FilterStates:
    lengths = {round(action.duration_s * model.sample_rate) for action in actions}
    if len(lengths) != 1 or min(lengths) < 1:
        raise UsageError("the actions of one call must be equally long, and longer than nothing.")
    samples, block = lengths.pop(), round(model.sample_rate / ACTION_RATE_HZ)
    count = -(-samples // block)
    block_centres = (np.arange(count) + 0.5) * block / model.sample_rate
    speed, force, touching = (np.zeros((count, len(actions))) for _ in range(3))
    for index, action in enumerate(actions):
        speed[:, index] = np.interp(block_centres, action.time, action.speed)
        force[:, index] = np.interp(block_centres, action.time, action.force)
        nearest = np.minimum(np.round(block_centres * action.rate).astype(int), len(action.contact) - 1)
        touching[:, index] = action.contact[nearest]
    local = interpolate_filters(model, speed.ravel(), force.ravel())
    shape = speed.shape
    ar = polynomial_from_lsf(local.ar_lsf)[:, 1:].reshape(*shape, -1)
    ma = (local.gain[:, None] * polynomial_from_lsf(local.ma_lsf)).reshape(*shape, -1)
    clamped = local.clamped_speed.reshape(shape), local.clamped_force.reshape(shape)
    notes = tuple(
        tuple(
            f"{quantity} above {limit:.3g} {unit} taken as that, {100.0 * mask[:, index].mean():.1f} % of the time"
            for quantity, mask, limit, unit in (
                ("speed", clamped[0], model.max_speed, "m/s"), ("force", clamped[1], model.max_force, "N"),
            )
            if mask[:, index].any()
        )
        for index in range(len(actions))
    )  # fmt: skip
    return FilterStates(
        ar=np.ascontiguousarray(np.moveaxis(ar, -1, 1)),
        ma=np.ascontiguousarray(np.moveaxis(ma, -1, 1)),
        deviation=np.sqrt(local.variance.reshape(shape)) * touching,
        block_samples=block,
        samples=samples,
        warm_up=block * round(WARM_UP_S * ACTION_RATE_HZ),
        notes=notes,
    )


def _draw_noise(seed: int, index: int, count: int) -> Float:
    sequence = np.random.SeedSequence(seed, spawn_key=(index,))
    return np.random.Generator(np.random.Philox(sequence)).standard_normal(count)


def synthesise_autoregressive(states: FilterStates, noise: Float) -> Float:
    """Filter unit noise (warm_up + samples, B) to signals (samples, B) [m/s²], for all B actions in one time loop."""
    order, width = states.ar.shape[1], noise.shape[1]
    excitation = _filter_moving_average(states, noise)
    total = len(noise)
    signal = np.zeros((order + total, width))
    scratch, step = np.empty((order, width)), np.empty(width)
    for start in range(0, total, states.block_samples):
        # The latest sample is the last of the history, so the coefficients are reversed.
        reverse = np.ascontiguousarray(states.ar[get_block_index(states, start), ::-1])
        for n in range(start, min(start + states.block_samples, total)):
            np.multiply(reverse, signal[n : n + order], out=scratch)
            np.add.reduce(scratch, axis=0, out=step)
            np.subtract(excitation[n], step, out=signal[n + order])
    return signal[order + states.warm_up :]


def _filter_moving_average(states: FilterStates, noise: Float) -> Float:
    rows = np.maximum(np.arange(len(noise)) - states.warm_up, 0) // states.block_samples
    excitation = noise * states.deviation[rows]
    filtered = excitation * states.ma[rows, 0]
    for delay in range(1, states.ma.shape[1]):
        filtered[delay:] += excitation[:-delay] * states.ma[rows[delay:], delay]
    return np.asarray(filtered)


def get_block_index(states: FilterStates, sample: int) -> int:
    """Return the index of the 5 ms block whose filter a sample gets, counted with the warm-up samples."""
    return max(sample - states.warm_up, 0) // states.block_samples
