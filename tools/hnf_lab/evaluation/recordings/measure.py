"""Measure how far the library is from recorded textures, under the pen, at a grid of speeds and forces.

Every texture of a copy of HaTT is asked for by its recorded name, as `hnf synth --material NAME` would, at nine
conditions; four directions are rendered and their power averaged. The recorded spectrum is the exact one of HaTT's
autoregressive model. Beside the library stand answers that know no physics, each leaving the texture itself out: the
log-mean of all others, of its category, of its name, and another texture of its name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.action import ACTION_RATE_HZ, Action
from hnf_core.datasets.hatt import HattFolder
from hnf_core.datasets.hatt_models import TextureModel, interpolate_filters
from hnf_core.datasets.simulated import SimulatedLibrary
from hnf_core.errors import FileError, MaterialError
from hnf_core.field.field import Field
from hnf_core.field.stroke import uniform_stroke
from hnf_core.field.synthesis import synthesise
from hnf_core.field.weights import load_field
from hnf_core.material.contact_model import Mechanics
from hnf_core.material.library import Appearance, LibraryMaterial, get_material, load_library
from hnf_core.material.ranking import find_material, rank
from hnf_core.metrics.spectra import welch
from hnf_core.progress import Progress, ProgressCallback, ignore_progress

from ...baselines.piecewise_ar import compute_power_spectrum
from .spectra import (
    FINE_HZ,
    STEP_HZ,
    Distance,
    average_bins_db,
    average_distances,
    compare_levels,
    fit_exponents,
    sum_third_octaves_db,
)

Float = NDArray[np.float64]

SPEEDS_M_S = (0.05, 0.1, 0.15)
FORCES_N = (0.5, 1.0, 2.0)
CONDITIONS = tuple((speed, force) for speed in SPEEDS_M_S for force in FORCES_N)
"""Speeds [m/s] and forces [N] that are compared, where the recording has them."""
DIRECTIONS_RAD = tuple(np.radians((0.0, 45.0, 90.0, 135.0)))
WINDOW_S = 1.0 / STEP_HZ
SETTLE_S = 0.25
"""Beginning of a rendered stroke that is left out [s]."""
MAX_SIMULATED_S = 2.0
"""Longest stroke whose statistics are compared with the simulator's [s], which takes seconds for each."""
NO_WORD_MATCHES = "no word matches"
"""Reason for a material if no word of the name is known: `hnf synth` refuses such a name."""
BASELINES = ("mean of all", "mean of its category", "mean of its name", "another of its name")

CATEGORY_WORDS = {
    "paper": "paper card cardboard tissue envelope folder binder book napkin plate magazine",
    "plastic": "plastic abs vinyl acrylic plexiglass whiteboard polyethylene pvc bubble",
    "fabric": "cotton denim canvas silk velvet fleece shirt towel felt wool linen fabric cloth corduroy velcro satin "
    "nylon burlap suede shoe leather pleather vest",
    "carpet": "carpet grass rug turf",
    "foam": "foam styrofoam sponge",
    "metal": "metal aluminum aluminium steel shelving",
    "stone": "stone brick granite marble terra cotta sandstone slate concrete",
    "tile": "tile floortile ceramic",
    "wood": "wood cork bamboo mdf",
    "carbon": "carbon fiber",
    "sandpaper": "sandpaper",
    "rubber": "rubber",
}
"""Kinds of stuff, and the words of recorded names that mean them; the last word of a name that means one decides."""


@dataclass(frozen=True)
class RecordedTexture:
    """Recorded texture with its spectra.

    Attributes
    ----------
    name
        Name in the data set.
    category
        Kind of stuff by its name, see CATEGORY_WORDS; "" if its name means none.
    conditions
        Indices into CONDITIONS that were recorded.
    density
        (len(conditions), FINE_HZ) power densities [(m/s²)²/Hz].
    """

    name: str
    category: str
    conditions: tuple[int, ...]
    density: Float

    @property
    def stem(self) -> str:
        """Name without number and side: textures of one stem are variants of one thing."""
        return re.sub(r"\b(\d+|front|back)\b", "", self.name.lower()).strip()


@dataclass(frozen=True)
class TextureResult:
    """Comparison of one texture with the library's answer.

    Attributes
    ----------
    texture
        The recording.
    material
        Name of the library material that was taken.
    reason
        Why: a name of the library, matched words, or neither.
    distance, third_octaves
        Mean over its conditions, by 10 Hz bins and by third octaves [dB].
    baselines
        Distance of each of BASELINES, NaN if there is no other texture to take.
    signed_db
        (len(conditions), 18) library − recorded in third octaves [dB].
    recorded_exponents, library_exponents
        (2, 18) exponents of speed and force of the amplitude in third octaves.
    rms_exponents
        (2, 2) of the RMS of 20 to 1000 Hz: recorded and library, each of speed and force.
    """

    texture: RecordedTexture
    material: str
    reason: str
    distance: Distance
    third_octaves: Distance
    baselines: tuple[Distance, ...]
    signed_db: Float
    recorded_exponents: Float
    library_exponents: Float
    rms_exponents: Float


@dataclass(frozen=True)
class SignalStatistics:
    """Statistics of a material's signal at 0.1 m/s and 1 N, from the field and from the simulator.

    Each is (kurtosis − 3, crest factor, modulation): a right spectrum of featureless noise has the first at 0.
    modulation: standard deviation over mean of the RMS in windows of 20 ms.
    """

    material: str
    field: tuple[float, float, float]
    simulator: tuple[float, float, float]


def find_category(name: str) -> str:
    """Return the kind of stuff that a recorded name means, "" for none."""
    category = ""
    for word in re.findall(r"[a-z]+", name.lower()):
        for candidate, words in CATEGORY_WORDS.items():
            if word in words.split():
                category = candidate
                break
    return category


def read_texture(name: str, model: TextureModel) -> RecordedTexture:
    """Read the exact spectra of a model at the conditions within what was recorded."""
    conditions, densities = [], []
    for index, (speed, force) in enumerate(CONDITIONS):
        local = interpolate_filters(model, speed, force)
        if local.clamped_speed[0] or local.clamped_force[0] or not local.variance[0] > 0.0:
            continue
        conditions.append(index)
        densities.append(compute_power_spectrum(model, speed, force, FINE_HZ))
    density = np.stack(densities) if densities else np.zeros((0, len(FINE_HZ)))
    return RecordedTexture(name, find_category(name), tuple(conditions), density)


def read_textures(folder: Path) -> list[RecordedTexture]:
    """Read all texture models of a copy of HaTT that hold one of CONDITIONS. Raises FileError if there is none."""
    data = HattFolder(folder)
    processes = ((name, data.process(name)) for name in data.materials)
    textures = [read_texture(name, process.model) for name, process in processes if process is not None]
    recorded = [texture for texture in textures if texture.conditions]
    if not recorded:
        raise FileError("no texture model in it covers the conditions that are compared.", where=str(folder),
                        remedy="Give a folder with HaTT's models (Models_….xml).")  # fmt: skip
    return recorded


def choose_material(name: str) -> tuple[LibraryMaterial, str]:
    """Return the material that `hnf synth` takes for a name and the reason; a scene's likeliest where it takes none."""
    try:
        material, suggestion = find_material(name)
    except MaterialError:
        return get_material(rank(load_library(), Appearance(), [name])[0].name), NO_WORD_MATCHES
    return material, "a name of the library" if suggestion is None else suggestion.reason


def make_steady_action(speed: float, force: float, direction_rad: float, seconds: float) -> Action:
    """Make an action at constant speed [m/s] and force [N] in one direction."""
    count = round(seconds * ACTION_RATE_HZ) + 1
    direction = np.tile([np.cos(direction_rad), np.sin(direction_rad)], (count, 1))
    position = speed * np.arange(count) / ACTION_RATE_HZ
    return Action(
        ACTION_RATE_HZ, direction, np.full(count, speed), np.full(count, force), position, np.ones(count, dtype=bool)
    )


def render_density(
    field: Field,
    token: NDArray[np.float32],
    mechanics: Mechanics,
    condition: tuple[float, float],
    seconds: float,
) -> Float:
    """Render a token (TOKEN_DIM,) at (speed, force) in four directions; return the mean power density (FINE_HZ,)."""
    densities = []
    for seed, direction in enumerate(DIRECTIONS_RAD):
        action = make_steady_action(*condition, float(direction), seconds + SETTLE_S)
        stroke = uniform_stroke(action, token, mechanics)
        signal = synthesise(field, stroke, seed=seed).signal
        steady = signal.samples[round(SETTLE_S * signal.sample_rate) :].astype(np.float64)
        frequency, density = welch(steady, signal.sample_rate, round(WINDOW_S * signal.sample_rate))
        densities.append(np.interp(FINE_HZ, frequency, density))
    return np.asarray(np.mean(densities, axis=0))


def compute_baselines(texture: RecordedTexture, textures: Sequence[RecordedTexture]) -> tuple[Distance, ...]:
    """Return the distance of each of BASELINES, made of the other textures at the same conditions."""
    others = [other for other in textures if other.name != texture.name]
    alike = [other for other in others if texture.category and other.category == texture.category]
    namesakes = [other for other in others if other.stem == texture.stem]
    groups = (others, alike, namesakes, namesakes[:1])
    return tuple(average_distances(_compare_with_mean(texture, group)) for group in groups)


def _compare_with_mean(texture: RecordedTexture, group: Sequence[RecordedTexture]) -> list[Distance]:
    distances = []
    for condition, recorded in zip(texture.conditions, average_bins_db(texture.density), strict=True):
        levels = [
            average_bins_db(other.density[other.conditions.index(condition)])
            for other in group
            if condition in other.conditions
        ]
        if levels:
            distances.append(compare_levels(np.mean(levels, axis=0), recorded))
    return distances


def compare_texture(
    texture: RecordedTexture, textures: Sequence[RecordedTexture], material: str, reason: str, rendered: Float
) -> TextureResult:
    """Compare a texture with rendered densities (9, FINE_HZ) of a material at all CONDITIONS."""
    density = rendered[list(texture.conditions)]
    recorded_bins, library_bins = average_bins_db(texture.density), average_bins_db(density)
    recorded_bands, library_bands = sum_third_octaves_db(texture.density), sum_third_octaves_db(density)
    speed, force = np.array([CONDITIONS[index] for index in texture.conditions]).T
    total_db = [10.0 * np.log10(values.sum(axis=1, keepdims=True)) for values in (texture.density, density)]
    return TextureResult(
        texture,
        material,
        reason,
        average_distances([compare_levels(a, b) for a, b in zip(library_bins, recorded_bins, strict=True)]),
        average_distances([compare_levels(a, b) for a, b in zip(library_bands, recorded_bands, strict=True)]),
        compute_baselines(texture, textures),
        library_bands - recorded_bands,
        np.stack(fit_exponents(recorded_bands, speed, force)),
        np.stack(fit_exponents(library_bands, speed, force)),
        np.array([np.concatenate(fit_exponents(levels, speed, force)) for levels in total_db]),
    )


def describe_signal(samples: Float, rate: float) -> tuple[float, float, float]:
    """Return kurtosis − 3, crest factor and modulation of a signal (n,); see SignalStatistics."""
    centred = samples - samples.mean()
    power = float(np.mean(np.square(centred)))
    if power <= 0.0:
        return 0.0, 0.0, 0.0
    window = round(0.02 * rate)
    blocks = centred[: len(centred) // window * window].reshape(-1, window)
    envelope = np.sqrt(np.mean(np.square(blocks), axis=1))
    return (
        float(np.mean(centred**4) / power**2 - 3.0),
        float(np.abs(centred).max() / np.sqrt(power)),
        float(envelope.std() / envelope.mean()),
    )


def measure_statistics(field: Field, material: LibraryMaterial, seconds: float) -> SignalStatistics:
    """Measure the statistics of a material at 0.1 m/s and 1 N, from the field and from the simulator."""
    action = make_steady_action(0.1, 1.0, 0.0, seconds)
    signal = synthesise(field, uniform_stroke(action, material.token, material.mechanics), seed=0).signal
    (recording,) = SimulatedLibrary().process(material.name).record([action], 0)
    skipped = round(SETTLE_S * signal.sample_rate)
    return SignalStatistics(
        material.name,
        describe_signal(signal.samples[skipped:].astype(np.float64), signal.sample_rate),
        describe_signal(recording.samples[skipped:], recording.sample_rate),
    )


def measure_recordings(
    folder: Path, *, seconds: float, progress: ProgressCallback = ignore_progress
) -> tuple[list[TextureResult], list[SignalStatistics]]:
    """Compare every texture of a copy of HaTT with the library.

    Parameters
    ----------
    folder
        The copy.
    seconds
        Length of each rendered stroke [s].
    progress
        Called before each material.

    Returns
    -------
    results : list of TextureResult
        In the order of the names.
    statistics : list of SignalStatistics
        Of every library material that was taken.

    Raises
    ------
    FileError
        If the folder holds no texture model.
    """
    textures = read_textures(folder)
    field = load_field()
    chosen = {texture.name: choose_material(texture.name) for texture in textures}
    materials = {material.name: material for material, _ in chosen.values()}
    rendered, statistics = {}, []
    for done, (name, material) in enumerate(sorted(materials.items())):
        progress(Progress(name, done, len(materials)))
        rendered[name] = np.stack(
            [render_density(field, material.token, material.mechanics, condition, seconds) for condition in CONDITIONS]
        )
        statistics.append(measure_statistics(field, material, min(seconds, MAX_SIMULATED_S)))
    results = [
        compare_texture(texture, textures, material.name, reason, rendered[material.name])
        for texture in textures
        for material, reason in [chosen[texture.name]]
    ]
    return results, statistics
