"""Physical constants of materials: the rows of the material library, and the classes that instances are drawn from.

tools/build_library.py turns the table into library.json. A class is one row ("denim"); an instance is one piece of it,
drawn by a seed with physical scatter: another weaver, another board. Levels are constants of the surface (RMS height),
never a gain on the output.

Frame: x runs along the grain (wood, brushed metal); ribs and grooves (corduroy, ribbed plastic) run along y, so that a
stroke along x crosses them. Stiffness, damping and friction describe the contact under the pen at 1 N, backing included
(a cloth lies on a board). Roughness is the RMS height of the complete surface; the rms_m of the recipe's parts (noise,
lattices, grains) are only relative weights. Both are chosen so that simulated accelerations lie in the range of
recorded textures of the category (H. Culbertson et al. 2014, "One hundred data-driven haptic texture models", IEEE
Haptics Symposium): the values make the model feel right, they are no profilometer readings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import blake2b
from math import gcd

import numpy as np

from ..errors import MaterialError
from ..material.contact_model import Mechanics
from ..material.library import Appearance
from .surface_recipe import Grains, Lattice, Noise, SurfaceRecipe, grating, knurl, plain_weave, twill

MM = 1e-3
"""A millimetre [m]."""


@dataclass(frozen=True)
class MaterialEntry:
    """A row of the table of materials.

    Attributes
    ----------
    name, category : str
        Unique name ("oak-wood") and category ("wood"), as in `material.library.LibraryMaterial`.
    hatt : str
        Category of recorded textures in the data set HaTT that it is compared with, "" if there is none.
    words : str
        Words that name it, separated by blanks.
    mechanics : Mechanics
        Stiffness, damping and friction under the pen.
    roughness_um : float
        RMS height of the complete surface [µm].
    parts : SurfaceRecipe
        Noise, lattices and grains that the surface is the sum of, with relative heights.
    appearance : Appearance
        Typical shading values.
    scatter : float
        Factor on the standard deviations of `Scatter` when instances are drawn.
    """

    name: str
    category: str
    hatt: str
    words: str
    mechanics: Mechanics
    roughness_um: float
    parts: SurfaceRecipe
    appearance: Appearance
    scatter: float = 1.0


def make_noise(
    slope: float, rolloff_mm: float, *, weight: float = 1.0, stretch: float = 1.0, cutoff_mm: float = 0.06
) -> Noise:
    """Return a `Noise` part of a surface, with lengths in mm and a relative height (`weight`)."""
    return Noise(weight, slope, rolloff_mm * MM, cutoff_mm * MM, stretch)


def make_grains(
    diameter_mm: float, cover: float, *, sign: int = 1, weight: float = 1.0, stretch: float = 1.0
) -> Grains:
    """Return a `Grains` part of a surface, with the diameter in mm and a relative height (`weight`)."""
    return Grains(weight, diameter_mm * MM, cover, sign, stretch=stretch)


def make_recipe(*parts: Noise | Lattice | Grains) -> SurfaceRecipe:
    """Collect noise, lattices and grains into a `SurfaceRecipe`."""
    return SurfaceRecipe(
        tuple(p for p in parts if isinstance(p, Noise)),
        tuple(p for p in parts if isinstance(p, Lattice)),
        tuple(p for p in parts if isinstance(p, Grains)),
    )


def make_appearance(
    color: tuple[float, float, float],
    roughness: float,
    *,
    metallic: float = 0.0,
    sheen: float = 0.0,
    transmission: float = 0.0,
) -> Appearance:
    """Return an `Appearance` (shading values) without unknown values."""
    return Appearance(color, roughness, metallic, sheen, transmission)


def build_recipe(entry: MaterialEntry) -> SurfaceRecipe:
    """Return the surface recipe of an entry, with the parts' weights converted to RMS heights in metres."""
    parts: tuple[Noise | Lattice | Grains, ...] = (*entry.parts.noise, *entry.parts.lattices, *entry.parts.grains)
    return entry.parts.scale_heights(entry.roughness_um * 1e-6 / float(np.sqrt(sum(part.rms_m**2 for part in parts))))


MATERIAL_TABLE: tuple[MaterialEntry, ...] = (
    # --- wood
    MaterialEntry("oak-wood", "wood", "Wood", "wood oak timber plank board parquet wooden",
          Mechanics(1.1e5, 0.22, 0.28), 0.72,
          make_recipe(make_noise(2.05, 3.0, stretch=6.0), make_grains(0.25, 0.12, sign=-1, weight=0.7, stretch=8.0)),
          make_appearance((0.42, 0.26, 0.13), 0.6)),
    MaterialEntry("pine-wood", "wood", "Wood", "wood pine spruce fir lumber plank board crate wooden",
          Mechanics(0.75e5, 0.26, 0.3), 0.95,
          make_recipe(make_noise(2.0, 4.0, stretch=8.0), make_noise(1.6, 1.0, weight=0.4)),
          make_appearance((0.6, 0.42, 0.22), 0.65)),
    MaterialEntry("varnished-wood", "wood", "Wood",
          "wood varnished lacquered polished walnut mahogany cherry furniture piano wooden",
          Mechanics(1.3e5, 0.18, 0.22), 0.76,
          make_recipe(make_noise(2.1, 4.0, stretch=3.0, cutoff_mm=0.15), make_grains(0.3, 0.05, sign=-1, weight=0.3,
          stretch=5.0)),
          make_appearance((0.16, 0.07, 0.03), 0.3)),
    MaterialEntry("rough-sawn-wood", "wood", "Wood", "wood sawn rough raw bark log beam pallet fence trunk wooden",
          Mechanics(0.75e5, 0.28, 0.36), 1.15,
          make_recipe(make_noise(1.9, 3.0, stretch=4.0), make_grains(0.4, 0.3, weight=0.4, stretch=6.0)),
          make_appearance((0.33, 0.22, 0.13), 0.9)),
    MaterialEntry("cork", "wood", "Wood", "cork corkboard",
          Mechanics(0.5e5, 0.34, 0.45), 1.05,
          make_recipe(make_noise(1.9, 1.5), make_grains(0.8, 0.3, sign=-1, weight=0.8)),
          make_appearance((0.5, 0.32, 0.18), 0.85)),
    # --- metal
    MaterialEntry("smooth-metal", "metal", "Metal",
          "metal steel iron chrome stainless polished smooth aluminium aluminum silver screw bolt buckle",
          Mechanics(6.0e5, 0.14, 0.2), 0.11,
          make_recipe(make_noise(1.7, 3.0)),
          make_appearance((0.56, 0.57, 0.58), 0.25, metallic=1.0)),
    MaterialEntry("brushed-metal", "metal", "Metal", "metal steel brushed aluminium aluminum stainless satin appliance",
          Mechanics(5.0e5, 0.15, 0.22), 0.35,
          make_recipe(make_noise(1.6, 1.0, stretch=12.0), make_noise(1.8, 3.0, weight=0.35)),
          make_appearance((0.6, 0.6, 0.6), 0.4, metallic=1.0)),
    MaterialEntry("cast-metal", "metal", "Metal", "metal iron cast rough blasted sandblasted anvil hammered",
          Mechanics(5.0e5, 0.18, 0.3), 0.5,
          make_recipe(make_noise(1.6, 1.5), make_grains(0.35, 0.4, weight=0.3)),
          make_appearance((0.3, 0.3, 0.31), 0.65, metallic=1.0)),
    MaterialEntry("rusty-metal", "metal", "Metal", "metal iron rust rusty corroded oxidized weathered scrap",
          Mechanics(3.5e5, 0.22, 0.4), 0.95,
          make_recipe(make_noise(1.65, 2.0), make_grains(0.5, 0.35, sign=-1, weight=0.35), make_grains(0.3, 0.2,
          weight=0.3)),
          make_appearance((0.27, 0.11, 0.05), 0.85, metallic=0.4)),
    MaterialEntry("brass", "metal", "Metal", "metal brass bronze copper gold golden coin bell trumpet",
          Mechanics(4.5e5, 0.14, 0.24), 0.2,
          make_recipe(make_noise(1.8, 4.0)),
          make_appearance((0.8, 0.55, 0.22), 0.3, metallic=1.0)),
    MaterialEntry("knurled-metal", "metal", "Metal", "metal knurl knurled grip handle dumbbell diamond checkered",
          Mechanics(4.0e5, 0.25, 0.28), 2.3,
          make_recipe(knurl(1.0, 0.8 * MM), make_noise(1.4, 0.8, weight=0.45)),
          make_appearance((0.5, 0.5, 0.5), 0.4, metallic=1.0)),
    # --- stone
    MaterialEntry("granite", "stone", "Stone", "stone granite rock gneiss boulder countertop",
          Mechanics(9.0e5, 0.19, 0.4), 0.9,
          make_recipe(make_noise(1.75, 1.5), make_grains(0.6, 0.3, sign=-1, weight=0.5)),
          make_appearance((0.35, 0.33, 0.32), 0.6)),
    MaterialEntry("marble", "stone", "Stone", "stone marble travertine limestone statue sculpture onyx",
          Mechanics(8.0e5, 0.17, 0.3), 0.34,
          make_recipe(make_noise(1.7, 2.0)),
          make_appearance((0.8, 0.78, 0.75), 0.25)),
    MaterialEntry("slate", "stone", "Stone", "stone slate shale schist roof flagstone",
          Mechanics(8.0e5, 0.22, 0.42), 1.0,
          make_recipe(make_noise(1.75, 3.0, stretch=1.8)),
          make_appearance((0.1, 0.11, 0.12), 0.7)),
    MaterialEntry("sandstone", "stone", "Stone", "stone sandstone sand brick masonry ruin desert",
          Mechanics(7.0e5, 0.22, 0.55), 1.3,
          make_recipe(make_noise(1.6, 1.0), make_grains(0.3, 0.6, weight=0.6)),
          make_appearance((0.55, 0.4, 0.26), 0.95)),
    MaterialEntry("concrete", "stone", "Stone", "stone concrete cement plaster stucco pavement asphalt road sidewalk",
          Mechanics(7.5e5, 0.22, 0.5), 1.4,
          make_recipe(make_noise(1.8, 2.0), make_grains(0.7, 0.15, sign=-1, weight=0.7)),
          make_appearance((0.4, 0.39, 0.37), 0.9)),
    # --- fabric
    MaterialEntry("cotton-canvas", "fabric", "Fabric",
    "fabric cloth canvas cotton textile tent sail bag linen burlap sack",
          Mechanics(6.0e4, 0.3, 0.4), 0.45,
          make_recipe(plain_weave(1.0, 0.4 * MM, irregularity=0.1), make_noise(1.7, 1.0, weight=0.7)),
          make_appearance((0.6, 0.55, 0.45), 0.95, sheen=0.3)),
    MaterialEntry("denim", "fabric", "Fabric", "fabric cloth denim jeans twill cotton trousers jacket workwear",
          Mechanics(6.0e4, 0.3, 0.38), 0.55,
          make_recipe(twill(1.0, 0.33 * MM, irregularity=0.1), make_noise(1.7, 1.0, weight=0.7)),
          make_appearance((0.06, 0.1, 0.22), 0.95, sheen=0.2)),
    MaterialEntry("corduroy", "fabric", "Fabric", "fabric cloth corduroy cord ribbed wale trousers",
          Mechanics(1.8e4, 0.4, 0.42), 4.9,
          make_recipe(grating(1.0, 1.4 * MM, harmonic=0.35, irregularity=0.05), make_noise(1.6, 0.8, weight=0.6,
          stretch=1.5)),
          make_appearance((0.3, 0.18, 0.09), 0.95, sheen=0.6)),
    MaterialEntry("velvet", "fabric", "Fabric", "fabric cloth velvet velour plush upholstery curtain sofa",
          Mechanics(3.0e4, 0.4, 0.45), 0.95,
          make_recipe(make_noise(2.4, 1.5), make_noise(2.4, 4.0, weight=0.5, stretch=2.0)),
          make_appearance((0.25, 0.05, 0.08), 0.9, sheen=1.0)),
    MaterialEntry("silk", "fabric", "Fabric", "fabric cloth silk satin ribbon scarf tie lining",
          Mechanics(7.0e4, 0.25, 0.24), 0.38,
          make_recipe(plain_weave(1.0, 0.25 * MM, irregularity=0.06), make_noise(2.5, 4.0, weight=1.6, stretch=2.0)),
          make_appearance((0.6, 0.5, 0.45), 0.35, sheen=0.5)),
    MaterialEntry("wool-knit", "fabric", "Fabric", "fabric cloth wool knit knitted sweater sock yarn jersey scarf",
          Mechanics(1.8e4, 0.4, 0.5), 1.6,
          make_recipe(plain_weave(1.0, 1.25 * MM, weft_m=0.9 * MM, irregularity=0.12), make_noise(2.0, 2.0,
          weight=0.9)),
          make_appearance((0.45, 0.38, 0.3), 1.0, sheen=0.5)),
    MaterialEntry("felt", "fabric", "Fabric", "fabric felt fleece hat billiard baize flannel",
          Mechanics(3.5e4, 0.38, 0.45), 0.75,
          make_recipe(make_noise(2.2, 2.0)),
          make_appearance((0.1, 0.25, 0.12), 1.0, sheen=0.6)),
    MaterialEntry("nylon-webbing", "fabric", "Fabric",
          "fabric nylon polyester webbing strap belt harness rope backpack synthetic parachute",
          Mechanics(7.0e4, 0.28, 0.32), 0.65,
          make_recipe(plain_weave(1.0, 0.5 * MM, weft_m=0.75 * MM, irregularity=0.05), make_noise(1.7, 1.0,
          weight=0.7)),
          make_appearance((0.05, 0.05, 0.05), 0.7, sheen=0.2)),
    # --- paper
    MaterialEntry("copy-paper", "paper", "Paper", "paper sheet page book label poster document",
          Mechanics(0.7e5, 0.25, 0.28), 0.55,
          make_recipe(make_noise(1.9, 1.5)),
          make_appearance((0.85, 0.85, 0.83), 0.8)),
    MaterialEntry("cardboard", "paper", "Paper", "cardboard carton box corrugated paperboard package parcel",
          Mechanics(5.5e4, 0.3, 0.32), 0.9,
          make_recipe(grating(0.8, 4.0 * MM, harmonic=0.2, irregularity=0.03), make_noise(1.9, 1.5)),
          make_appearance((0.45, 0.3, 0.17), 0.85)),
    MaterialEntry("sandpaper", "paper", "Paper", "sandpaper abrasive emery grit grinding",
          Mechanics(1.6e5, 0.2, 0.65), 1.8,
          make_recipe(make_grains(0.35, 0.8), make_noise(1.6, 0.8, weight=0.7)),
          make_appearance((0.25, 0.12, 0.06), 1.0)),
    # --- plastic
    MaterialEntry("smooth-plastic", "plastic", "Plastic", "plastic abs smooth acrylic pvc polymer vinyl lego bottle",
          Mechanics(0.6e5, 0.2, 0.25), 1.7,
          make_recipe(make_noise(2.4, 4.0)),
          make_appearance((0.6, 0.6, 0.6), 0.35)),
    MaterialEntry("textured-plastic", "plastic", "Plastic",
          "plastic textured matte grained dashboard housing keyboard controller",
          Mechanics(0.6e5, 0.22, 0.3), 0.75,
          make_recipe(make_noise(2.3, 1.0), make_grains(0.5, 0.5, weight=0.8)),
          make_appearance((0.05, 0.05, 0.05), 0.6)),
    MaterialEntry("ribbed-plastic", "plastic", "Plastic", "plastic ribbed grating grooved ridged grooves comb vinyl",
          Mechanics(8.0e4, 0.35, 0.28), 1.15,
          make_recipe(grating(1.0, 0.5 * MM, harmonic=0.3), make_noise(1.7, 1.0, weight=0.5)),
          make_appearance((0.1, 0.1, 0.1), 0.4)),
    MaterialEntry("carbon-fibre", "plastic", "Carbon fibre",
    "carbon fibre fiber composite cfrp kevlar fibreglass fiberglass",
          Mechanics(1.75e5, 0.2, 0.21), 1.35,
          make_recipe(twill(1.0, 0.5 * MM, repeat=4, irregularity=0.03), make_noise(2.2, 2.5, weight=0.7)),
          make_appearance((0.02, 0.02, 0.02), 0.3), scatter=0.3),
    # --- foam
    MaterialEntry("soft-foam", "foam", "Foam", "foam sponge cushion padding pillow mattress soft",
          Mechanics(1.4e4, 0.35, 0.8), 2.6,
          make_recipe(make_noise(1.8, 2.0), make_grains(0.8, 0.5, sign=-1, weight=0.8)),
          make_appearance((0.75, 0.7, 0.5), 1.0)),
    MaterialEntry("eva-foam", "foam", "Foam", "foam eva yoga insole neoprene styrofoam polystyrene",
          Mechanics(2.0e4, 0.35, 0.7), 1.95,
          make_recipe(make_noise(1.8, 1.5)),
          make_appearance((0.15, 0.15, 0.3), 0.9)),
    # --- carpet
    MaterialEntry("loop-carpet", "carpet", "Carpet", "carpet loop rug doormat berber sisal",
          Mechanics(3.2e3, 0.3, 1.0), 27.0,
          make_recipe(plain_weave(0.8, 2.2 * MM, irregularity=0.1), make_noise(2.2, 4.0), make_grains(0.8, 0.5,
          weight=0.5)),
          make_appearance((0.3, 0.27, 0.23), 1.0, sheen=0.3)),
    MaterialEntry("cut-pile-carpet", "carpet", "Carpet", "carpet pile rug shag turf grass moss fur plush",
          Mechanics(3.0e3, 0.35, 1.05), 23.0,
          make_recipe(make_noise(2.4, 4.0), make_grains(1.2, 0.5, weight=0.6)),
          make_appearance((0.35, 0.1, 0.08), 1.0, sheen=0.6)),
    # --- tile
    MaterialEntry("glazed-tile", "tile", "Tile",
    "tile ceramic glazed porcelain bathroom kitchen cup mug plate vase pottery",
          Mechanics(4.2e4, 0.22, 0.25), 4.6,
          make_recipe(make_noise(2.5, 5.0, cutoff_mm=0.2)),
          make_appearance((0.8, 0.8, 0.78), 0.12)),
    MaterialEntry("terracotta", "tile", "Tile", "tile terracotta clay unglazed pot earthenware roof ceramic brick",
          Mechanics(3.5e4, 0.24, 0.4), 3.1,
          make_recipe(make_noise(2.4, 3.0), make_grains(0.5, 0.15, sign=-1, weight=0.5)),
          make_appearance((0.5, 0.19, 0.1), 0.85)),
    # --- leather
    MaterialEntry("leather", "leather", "", "leather hide strap saddle belt boot shoe jacket glove wallet bag skin",
          Mechanics(4.0e4, 0.32, 0.45), 1.3,
          make_recipe(make_grains(0.9, 0.9, weight=1.0), make_noise(1.8, 1.5, weight=0.8)),
          make_appearance((0.16, 0.07, 0.03), 0.55)),
    MaterialEntry("suede", "leather", "", "leather suede nubuck chamois moccasin",
          Mechanics(2.2e4, 0.42, 0.55), 0.84,
          make_recipe(make_noise(1.7, 1.2)),
          make_appearance((0.35, 0.22, 0.13), 1.0, sheen=0.5)),
    # --- rubber
    MaterialEntry("rubber", "rubber", "", "rubber hose tube gasket seal silicone latex grip band eraser",
          Mechanics(2.5e4, 0.4, 0.9), 0.87,
          make_recipe(make_noise(1.8, 2.0)),
          make_appearance((0.03, 0.03, 0.03), 0.8)),
    MaterialEntry("tyre-rubber", "rubber", "", "rubber tyre tire tread sole wheel ribbed",
          Mechanics(3.0e4, 0.4, 0.95), 2.0,
          make_recipe(grating(0.7, 2.0 * MM, harmonic=0.4), make_noise(1.7, 1.2)),
          make_appearance((0.02, 0.02, 0.02), 0.95)),
    # --- glass
    MaterialEntry("clear-glass", "glass", "",
    "glass lens lenses window bottle crystal mirror visor goggles transparent",
          Mechanics(8.0e5, 0.14, 0.16), 0.056,
          make_recipe(make_noise(1.8, 5.0)),
          make_appearance((0.95, 0.95, 0.95), 0.05, transmission=1.0)),
    MaterialEntry("frosted-glass", "glass", "", "glass frosted etched sandblasted translucent milky",
          Mechanics(7.0e5, 0.16, 0.28), 0.12,
          make_recipe(make_noise(1.7, 0.8)),
          make_appearance((0.9, 0.92, 0.92), 0.6, transmission=0.9)),
)  # fmt: skip
"""All materials, by category."""


CLASS_ENTRIES = {entry.name: entry for entry in MATERIAL_TABLE}
"""Rows of the table by name."""


@dataclass(frozen=True)
class Scatter:
    """Random scatter of instances (pieces) of a material class, the same for all classes.

    Values are standard deviations of the quantity's natural logarithm (of `slope`: of its value), truncated at two of
    them.

    Attributes
    ----------
    level : float
        RMS height; makers control Ra to about a third (ISO 1302 classes are a factor of two apart).
    balance : float
        Height of one part (noise, lattice, grains) against the others.
    slope : float
        Exponent of the noise spectrum.
    length : float
        Roll-off, cut-off and grain size.
    pitch : float
        Threads and grooves per length.
    cover : float
        Coverage of grains.
    stiffness, damping, friction : float
        Mechanical properties, as data sheets and tribometers scatter within one material.
    """

    level: float = 0.2
    balance: float = 0.15
    slope: float = 0.06
    length: float = 0.12
    pitch: float = 0.08
    cover: float = 0.2
    stiffness: float = 0.15
    damping: float = 0.1
    friction: float = 0.1


DEFAULT_SCATTER = Scatter()


def list_classes() -> tuple[str, ...]:
    """Return the names of all material classes."""
    return tuple(CLASS_ENTRIES)


def get_category(class_name: str) -> str:
    """Return the category of a material class, for example "wood"."""
    return _get_entry(class_name).category


def get_recorded_category(class_name: str) -> str:
    """Return the category of recorded textures (data set HaTT) that a class is compared with, "" if there is none."""
    return _get_entry(class_name).hatt


def sample_instance(class_name: str, seed: int, scatter: Scatter = DEFAULT_SCATTER) -> tuple[SurfaceRecipe, Mechanics]:
    """Sample an instance (one piece) of a material class: its surface recipe and mechanics.

    Parameters
    ----------
    class_name : str
        Name of the class.
    seed : int
        Seed; the same name and seed give the same instance. Its heights are ``height_map(recipe, seed)``.
    scatter : Scatter
        Scatter within the class.

    Returns
    -------
    recipe : SurfaceRecipe
        Surface of the instance.
    mechanics : Mechanics
        Its mechanics.

    Raises
    ------
    MaterialError
        For an unknown class.
    """
    entry = _get_entry(class_name)
    rng = np.random.default_rng([derive_seed(class_name), seed])

    def factor(deviation: float) -> float:
        return float(np.exp(entry.scatter * deviation * np.clip(rng.standard_normal(), -2.0, 2.0)))

    level = factor(scatter.level)
    noise = tuple(
        replace(
            part,
            rms_m=part.rms_m * factor(scatter.balance),
            slope=part.slope + np.log(factor(scatter.slope)),
            rolloff_m=part.rolloff_m * factor(scatter.length),
            cutoff_m=part.cutoff_m * factor(scatter.length),
            stretch=1.0 + (part.stretch - 1.0) * factor(scatter.length),
        )
        for part in entry.parts.noise
    )
    lattices = tuple(
        replace(
            _scale_pitch(part, factor(scatter.pitch), factor(scatter.pitch)),
            rms_m=part.rms_m * factor(scatter.balance),
            irregularity=part.irregularity * factor(scatter.length),
        )
        for part in entry.parts.lattices
    )
    grains = tuple(
        replace(
            part,
            rms_m=part.rms_m * factor(scatter.balance),
            diameter_m=part.diameter_m * factor(scatter.length),
            cover=part.cover * factor(scatter.cover),
            stretch=1.0 + (part.stretch - 1.0) * factor(scatter.length),
        )
        for part in entry.parts.grains
    )
    instance = replace(entry, parts=SurfaceRecipe(noise, lattices, grains), roughness_um=entry.roughness_um * level)
    mean = entry.mechanics
    assert mean.stiffness_n_m is not None
    assert mean.damping_ratio is not None
    assert mean.friction is not None
    mechanics = Mechanics(
        mean.stiffness_n_m * factor(scatter.stiffness),
        mean.damping_ratio * factor(scatter.damping),
        mean.friction * factor(scatter.friction),
    )
    return build_recipe(instance), mechanics


def derive_seed(name: str) -> int:
    """Derive a random seed from a name, the same on every machine."""
    return int.from_bytes(blake2b(name.encode(), digest_size=4).digest(), "little")


def _get_entry(class_name: str) -> MaterialEntry:
    if class_name not in CLASS_ENTRIES:
        raise MaterialError(
            f"no class of surfaces is called {class_name!r}.", remedy="simulation.classes.classes() lists them."
        )
    return CLASS_ENTRIES[class_name]


def _scale_pitch(lattice: Lattice, x: float, y: float) -> Lattice:
    """Return a lattice with its pitch divided by `x` and `y` along the axes, to whole numbers of periods on a tile."""
    repeats = [gcd(*(wave[0] for wave in lattice.waves)), gcd(*(wave[1] for wave in lattice.waves))]
    if repeats[0] == repeats[1]:
        y = x  # keeps a square lattice square
    ratios = [
        max(1, round(count * divisor)) / count if count else 1.0 for count, divisor in zip(repeats, (x, y), strict=True)
    ]
    waves = tuple((round(px * ratios[0]), round(py * ratios[1]), a, phase) for px, py, a, phase in lattice.waves)
    return replace(lattice, waves=waves)
