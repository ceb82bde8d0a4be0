"""Physical constants of materials: the rows of the material library, and the classes that instances are drawn from.

tools/build_library.py turns the table into library.json. A class is one row ("denim"); an instance is one piece of it,
drawn by a seed with physical scatter: another weaver, another board. A handful of constants per class (relief,
stiffness, damping, friction noise) lie in `data/material_constants.json`: tools/fit_library.py fits them to recorded
textures, and each says what it was calibrated on. Levels are constants of surface and contact, never a gain on the
output. Words, friction, lattices and grains of a row are set by hand.

Frame: x runs along the grain (wood, brushed metal); ribs and grooves (corduroy, ribbed plastic) run along y, so that a
stroke along x crosses them. Stiffness, damping and friction describe the contact under the pen at 1 N, backing included
(a cloth lies on a board).
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import blake2b
from math import gcd
from pathlib import Path

import numpy as np

from ..errors import MaterialError
from ..material.contact_model import Mechanics
from ..material.library import Appearance
from .surface_recipe import (
    TILE_PIXELS,
    TILE_SIZE_M,
    Grains,
    Lattice,
    Noise,
    SurfaceRecipe,
    get_pitch,
    get_pitch_scatter,
    grating,
    knurl,
    noise_power,
    plain_weave,
    twill,
    wavenumbers,
)

MM = 1e-3
"""A millimetre [m]."""


CONSTANTS_PATH = Path(__file__).resolve().parents[1] / "data" / "material_constants.json"
"""Fitted constants of all classes, by name."""
ROLLOFF_M = 4e-3
"""Wavelength above which the relief of every class is flat [m]: recordings say little of longer waves."""


@dataclass(frozen=True)
class FittedConstants:
    """Constants of a class that are fitted to recorded textures, or set by analogy.

    Attributes
    ----------
    height_um : float
        RMS height of the relief's noise in the octave of wavelengths about 1 mm [µm].
    slope : float
        Exponent β of the relief's spectrum κ^−β along a path.
    stiffness_n_m, damping_ratio, friction_noise_n, friction_noise_slope : float
        As in `material.contact_model.Mechanics`.
    calibrated_on : str
        What the values were calibrated on.
    """

    height_um: float
    slope: float
    stiffness_n_m: float
    damping_ratio: float
    friction_noise_n: float
    friction_noise_slope: float
    calibrated_on: str


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
    friction : float
        Coulomb μ under the pen.
    constants : FittedConstants
        Its other constants.
    parts : SurfaceRecipe
        Lattices and grains, with heights relative to the noise in the octave about their own wavelength.
    appearance : Appearance
        Typical shading values.
    stretch : float
        Length of features along the grain over that across it.
    scatter : float
        Factor on the standard deviations of `Scatter` when instances are drawn.
    pile_m : float
        Depth of loose fibres [m], as in `Mechanics`; typical figures, since no table of them was found.
    """

    name: str
    category: str
    hatt: str
    words: str
    friction: float
    constants: FittedConstants
    parts: SurfaceRecipe
    appearance: Appearance
    stretch: float = 1.0
    scatter: float = 1.0
    pile_m: float = 0.0

    @property
    def mechanics(self) -> Mechanics:
        """Mechanics under the pen."""
        fitted, lattices = self.constants, self.parts.lattices
        return Mechanics(
            fitted.stiffness_n_m, fitted.damping_ratio, self.friction, fitted.friction_noise_n,
            fitted.friction_noise_slope, self.pile_m, get_pitch(lattices[0]) if lattices else 0.0,
            get_pitch_scatter(lattices[0]) if lattices else 0.0,
        )  # fmt: skip


@lru_cache(maxsize=1)
def load_constants() -> dict[str, FittedConstants]:
    """Load the fitted constants of all classes."""
    record = json.loads(CONSTANTS_PATH.read_text(encoding="utf-8"))
    return {name: FittedConstants(**values) for name, values in record.items()}


def make_entry(
    name: str, category: str, hatt: str, words: str, friction: float, parts: SurfaceRecipe,
    color: tuple[float, float, float], roughness: float, *, metallic: float = 0.0, sheen: float = 0.0,
    transmission: float = 0.0, stretch: float = 1.0, scatter: float = 1.0, pile_mm: float = 0.0,
) -> MaterialEntry:  # fmt: skip
    """Return a row of the table with its fitted constants and without unknown shading values."""
    look, pile_m = Appearance(color, roughness, metallic, sheen, transmission), pile_mm * MM
    constants = load_constants()[name]
    return MaterialEntry(name, category, hatt, words, friction, constants, parts, look, stretch, scatter, pile_m)


def make_grains(
    diameter_mm: float, cover: float, *, sign: int = 1, weight: float = 1.0, stretch: float = 1.0
) -> Grains:
    """Return a `Grains` part of a surface, with the diameter in mm and a relative height (`weight`)."""
    return Grains(weight, diameter_mm * MM, cover, sign, stretch=stretch)


def make_recipe(*parts: Lattice | Grains) -> SurfaceRecipe:
    """Collect lattices and grains into a `SurfaceRecipe`."""
    return SurfaceRecipe(
        (), tuple(p for p in parts if isinstance(p, Lattice)), tuple(p for p in parts if isinstance(p, Grains))
    )


def build_recipe(entry: MaterialEntry) -> SurfaceRecipe:
    """Return the surface recipe of an entry: its noise, and its lattices and grains with heights in metres."""
    fitted = entry.constants
    unit = Noise(1.0, fitted.slope, ROLLOFF_M, stretch=entry.stretch)
    octave = compute_octave_height(unit, 1e-3)
    rms_m = fitted.height_um * 1e-6 / octave

    def relative_to_noise(wavelength_m: float) -> float:
        return rms_m * compute_octave_height(unit, wavelength_m)

    lattices = tuple(
        replace(part, rms_m=part.rms_m * relative_to_noise(get_pitch(part))) for part in entry.parts.lattices
    )
    grains = tuple(
        replace(part, rms_m=part.rms_m * relative_to_noise(2.0 * part.diameter_m)) for part in entry.parts.grains
    )
    return SurfaceRecipe((replace(unit, rms_m=rms_m),), lattices, grains)


@lru_cache(maxsize=1024)
def compute_octave_height(noise: Noise, wavelength_m: float) -> float:
    """Return the RMS height [m] of a noise in the octave of wavelengths about one [m], over all directions.

    It is that of the octave of the tile's spectrum, so the longest waves of the tile are counted as they are rendered.
    """
    pixels = TILE_PIXELS
    power = noise_power(noise, pixels, TILE_SIZE_M)
    kx, ky = wavenumbers(pixels, TILE_SIZE_M)
    octave = np.abs(np.log2(np.maximum(np.hypot(kx, ky), 1e-9) * wavelength_m)) <= 0.5
    # The columns of a real transform between the first and the last stand for two waves each.
    weight = np.full(power.shape, 2.0)
    weight[:, 0] = weight[:, -1] = 1.0
    power[0, 0] = 0.0
    return noise.rms_m * float(np.sqrt((power * weight * octave).sum() / (power * weight).sum()))


MATERIAL_TABLE: tuple[MaterialEntry, ...] = (
    # --- wood
    make_entry("oak-wood", "wood", "Wood", "wood oak timber plank board parquet wooden", 0.28,
               make_recipe(make_grains(0.25, 0.12, sign=-1, weight=0.5, stretch=8.0)), (0.42, 0.26, 0.13), 0.6,
               stretch=4.0),
    make_entry("pine-wood", "wood", "Wood", "wood pine spruce fir lumber plank board crate wooden", 0.3,
               make_recipe(), (0.6, 0.42, 0.22), 0.65, stretch=4.0),
    make_entry("varnished-wood", "wood", "Wood",
               "wood varnished lacquered polished walnut mahogany cherry furniture piano wooden", 0.22,
               make_recipe(make_grains(0.3, 0.05, sign=-1, weight=0.3, stretch=5.0)), (0.16, 0.07, 0.03), 0.3,
               stretch=2.0),
    make_entry("painted-wood", "wood", "Wood", "wood painted paint enamel door fence wooden", 0.3,
               make_recipe(), (0.7, 0.7, 0.68), 0.5, stretch=1.5),
    make_entry("rough-sawn-wood", "wood", "Wood", "wood sawn rough raw bark log beam pallet fence trunk wooden", 0.36,
               make_recipe(make_grains(0.4, 0.3, weight=0.4, stretch=6.0)), (0.33, 0.22, 0.13), 0.9, stretch=3.0),
    make_entry("fibreboard", "wood", "Wood", "wood fibreboard fiberboard mdf hardboard chipboard plywood masonite", 0.3,
               make_recipe(), (0.45, 0.32, 0.2), 0.8),
    make_entry("bamboo", "wood", "Wood", "bamboo cane reed wicker", 0.28,
               make_recipe(make_grains(0.3, 0.1, weight=0.4, stretch=8.0)), (0.66, 0.5, 0.28), 0.5, stretch=4.0),
    make_entry("cork", "wood", "Wood", "cork corkboard", 0.45,
               make_recipe(make_grains(0.8, 0.3, sign=-1, weight=0.5)), (0.5, 0.32, 0.18), 0.85),
    # --- metal
    make_entry("smooth-metal", "metal", "Metal",
               "metal steel iron chrome stainless polished smooth aluminium aluminum silver screw bolt buckle", 0.2,
               make_recipe(), (0.56, 0.57, 0.58), 0.25, metallic=1.0),
    make_entry("brushed-metal", "metal", "Metal", "metal steel brushed aluminium aluminum stainless satin appliance",
               0.22,
               make_recipe(), (0.6, 0.6, 0.6), 0.4, metallic=1.0, stretch=8.0),
    make_entry("painted-metal", "metal", "Metal", "metal painted coated enamel shelving locker cabinet radiator car",
               0.25,
               make_recipe(), (0.5, 0.5, 0.52), 0.4, metallic=0.2),
    make_entry("embossed-metal", "metal", "Metal",
               "metal textured embossed stamped checker plate diamond grating tread", 0.3,
               make_recipe(make_grains(1.0, 0.5, weight=0.6)), (0.55, 0.56, 0.57), 0.4, metallic=1.0),
    make_entry("metal-foil", "metal", "Metal", "foil tinfoil aluminium aluminum metal wrap", 0.22,
               make_recipe(), (0.8, 0.8, 0.8), 0.2, metallic=1.0),
    make_entry("metal-mesh", "metal", "Metal", "metal mesh wire screen sieve grille gauze", 0.28,
               make_recipe(plain_weave(1.0, 0.5 * MM, irregularity=0.03)), (0.5, 0.5, 0.5), 0.4, metallic=1.0),
    make_entry("cast-metal", "metal", "Metal", "metal iron cast rough blasted sandblasted anvil hammered", 0.3,
               make_recipe(make_grains(0.35, 0.4, weight=0.4)), (0.3, 0.3, 0.31), 0.65, metallic=1.0),
    make_entry("rusty-metal", "metal", "Metal", "metal iron rust rusty corroded oxidized weathered scrap", 0.4,
               make_recipe(make_grains(0.5, 0.35, sign=-1, weight=0.4)), (0.27, 0.11, 0.05), 0.85, metallic=0.4),
    make_entry("brass", "metal", "Metal", "metal brass bronze copper gold golden coin bell trumpet", 0.24,
               make_recipe(), (0.8, 0.55, 0.22), 0.3, metallic=1.0),
    make_entry("knurled-metal", "metal", "Metal", "metal knurl knurled grip handle dumbbell diamond checkered", 0.28,
               make_recipe(knurl(3.0, 0.8 * MM)), (0.5, 0.5, 0.5), 0.4, metallic=1.0),
    # --- stone
    make_entry("granite", "stone", "Stone", "stone granite rock gneiss boulder countertop", 0.4,
               make_recipe(make_grains(0.6, 0.3, sign=-1, weight=0.5)), (0.35, 0.33, 0.32), 0.6),
    make_entry("marble", "stone", "Stone", "stone marble travertine limestone statue sculpture onyx", 0.3,
               make_recipe(), (0.8, 0.78, 0.75), 0.25),
    make_entry("slate", "stone", "Stone", "stone slate shale schist roof flagstone", 0.42,
               make_recipe(), (0.1, 0.11, 0.12), 0.7, stretch=1.8),
    make_entry("sandstone", "stone", "Stone", "stone sandstone sand masonry ruin desert", 0.55,
               make_recipe(make_grains(0.3, 0.6, weight=0.6)), (0.55, 0.4, 0.26), 0.95),
    make_entry("concrete", "stone", "Stone", "stone concrete cement plaster stucco pavement asphalt road sidewalk", 0.5,
               make_recipe(make_grains(0.7, 0.15, sign=-1, weight=0.6)), (0.4, 0.39, 0.37), 0.9),
    make_entry("brick", "stone", "Stone", "brick bricks stone masonry wall chimney", 0.55,
               make_recipe(make_grains(0.5, 0.3, sign=-1, weight=0.5)), (0.42, 0.17, 0.1), 0.95),
    make_entry("stone-tile", "stone", "Stone", "stone tile tiles quarry slab paving travertine flagstone", 0.4,
               make_recipe(make_grains(0.5, 0.15, sign=-1, weight=0.4)), (0.5, 0.46, 0.4), 0.7),
    # --- fabric
    make_entry("cotton-canvas", "fabric", "Fabric",
               "fabric cloth canvas textile tent sail bag linen burlap sack", 0.4,
               make_recipe(plain_weave(0.5, 0.4 * MM, irregularity=0.1)), (0.6, 0.55, 0.45), 0.95, sheen=0.3,
               pile_mm=0.1),
    make_entry("cotton", "fabric", "Fabric", "fabric cloth cotton shirt sheet bedsheet linen pillowcase bandage", 0.35,
               make_recipe(plain_weave(0.4, 0.25 * MM, irregularity=0.1)), (0.75, 0.74, 0.7), 0.95, sheen=0.3,
               pile_mm=0.1),
    make_entry("denim", "fabric", "Fabric", "fabric cloth denim jeans twill cotton trousers jacket workwear", 0.38,
               make_recipe(twill(0.5, 0.33 * MM, irregularity=0.1)), (0.06, 0.1, 0.22), 0.95, sheen=0.2, pile_mm=0.1),
    make_entry("corduroy", "fabric", "Fabric", "fabric cloth corduroy cord ribbed wale trousers", 0.42,
               make_recipe(grating(1.2, 1.4 * MM, harmonic=0.35, irregularity=0.05)), (0.3, 0.18, 0.09), 0.95,
               sheen=0.6, pile_mm=1),
    make_entry("velvet", "fabric", "Fabric", "fabric cloth velvet velour plush curtain", 0.45,
               make_recipe(), (0.25, 0.05, 0.08), 0.9, sheen=1.0, stretch=1.5, pile_mm=1.5),
    make_entry("silk", "fabric", "Fabric", "fabric cloth silk satin ribbon scarf tie lining", 0.24,
               make_recipe(plain_weave(0.3, 0.25 * MM, irregularity=0.06)), (0.6, 0.5, 0.45), 0.35, sheen=0.5,
               pile_mm=0.03),
    make_entry("polyester-knit", "fabric", "Fabric",
               "fabric cloth polyester athletic sport jersey shirt lycra spandex swimwear vest mesh tricot", 0.3,
               make_recipe(plain_weave(0.5, 0.6 * MM, irregularity=0.08)), (0.15, 0.2, 0.5), 0.7, sheen=0.3,
               pile_mm=0.1),
    make_entry("fleece", "fabric", "Fabric", "fabric cloth fleece blanket plush", 0.45,
               make_recipe(), (0.3, 0.32, 0.4), 1.0, sheen=0.6, pile_mm=2.5),
    make_entry("terry-towel", "fabric", "Fabric", "fabric cloth towel terry terrycloth bathrobe washcloth", 0.5,
               make_recipe(make_grains(1.2, 0.6, weight=0.4)), (0.75, 0.75, 0.72), 1.0, sheen=0.5, pile_mm=1.5),
    make_entry("velcro", "fabric", "Fabric", "velcro hook loop loops hooks fastener strap", 0.6,
               make_recipe(make_grains(0.8, 0.5, weight=0.4)), (0.05, 0.05, 0.05), 0.95, sheen=0.3, pile_mm=1),
    make_entry("wool-knit", "fabric", "Fabric", "fabric cloth wool knit knitted sweater sock yarn jersey scarf", 0.5,
               make_recipe(plain_weave(0.8, 1.25 * MM, weft_m=0.9 * MM, irregularity=0.12)), (0.45, 0.38, 0.3), 1.0,
               sheen=0.5, pile_mm=0.3),
    make_entry("wool-cloth", "fabric", "Fabric", "fabric cloth wool gabardine tweed worsted suit coat blend woven", 0.4,
               make_recipe(twill(0.5, 0.4 * MM, irregularity=0.1)), (0.2, 0.2, 0.22), 0.95, sheen=0.4, pile_mm=0.1),
    make_entry("flannel", "fabric", "Fabric", "fabric cloth flannel flannelette brushed pyjamas careerwear", 0.45,
               make_recipe(plain_weave(0.4, 0.4 * MM, irregularity=0.1)), (0.4, 0.2, 0.2), 1.0, sheen=0.5, pile_mm=0.4),
    make_entry("upholstery-fabric", "fabric", "Fabric", "fabric cloth upholstery sofa couch drapery curtain chenille",
               0.42,
               make_recipe(plain_weave(0.6, 0.8 * MM, irregularity=0.1)), (0.35, 0.3, 0.25), 0.95, sheen=0.4,
               pile_mm=0.1),
    make_entry("felt", "fabric", "Fabric", "fabric felt hat billiard baize", 0.45,
               make_recipe(), (0.1, 0.25, 0.12), 1.0, sheen=0.6, pile_mm=0.4),
    make_entry("nylon-webbing", "fabric", "Fabric",
               "fabric nylon polyester webbing strap belt harness rope backpack synthetic", 0.32,
               make_recipe(plain_weave(0.8, 0.5 * MM, weft_m=0.75 * MM, irregularity=0.05)), (0.05, 0.05, 0.05), 0.7,
               sheen=0.2, pile_mm=0.05),
    make_entry("nylon-fabric", "fabric", "Fabric", "fabric nylon bag ripstop parachute umbrella raincoat tarp taffeta",
               0.28,
               make_recipe(plain_weave(0.4, 0.25 * MM, irregularity=0.04)), (0.1, 0.25, 0.2), 0.5, sheen=0.1,
               pile_mm=0.03),
    # --- paper
    make_entry("copy-paper", "paper", "Paper", "paper sheet page book label poster document resume envelope folder",
               0.28,
               make_recipe(), (0.85, 0.85, 0.83), 0.8),
    make_entry("card", "paper", "Paper", "card greeting postcard playing photo glossy cover magazine carton board",
               0.26,
               make_recipe(), (0.8, 0.8, 0.82), 0.5),
    make_entry("cardboard", "paper", "Paper", "cardboard carton box corrugated paperboard package parcel", 0.32,
               make_recipe(grating(0.8, 4.0 * MM, harmonic=0.2, irregularity=0.03)), (0.45, 0.3, 0.17), 0.85),
    make_entry("kraft-paper", "paper", "Paper", "paper bag kraft wrapping brown sack plate", 0.32,
               make_recipe(), (0.5, 0.35, 0.22), 0.9),
    make_entry("tissue-paper", "paper", "Paper", "tissue paper towel napkin kitchen toilet filter crepe", 0.4,
               make_recipe(make_grains(0.7, 0.4, weight=0.4)), (0.9, 0.9, 0.9), 0.95, pile_mm=0.05),
    make_entry("glitter-paper", "paper", "Paper", "glitter paper sparkle sequin craft", 0.4,
               make_recipe(make_grains(0.4, 0.6, weight=0.5)), (0.6, 0.4, 0.6), 0.5, metallic=0.3),
    make_entry("wax-paper", "paper", "Paper", "wax paper parchment baking greaseproof waxed", 0.2,
               make_recipe(), (0.8, 0.76, 0.65), 0.4),
    make_entry("sandpaper", "paper", "Paper", "sandpaper abrasive emery grit grinding", 0.65,
               make_recipe(make_grains(0.35, 0.8, weight=0.7)), (0.25, 0.12, 0.06), 1.0),
    # --- plastic
    make_entry("smooth-plastic", "plastic", "Plastic",
               "plastic smooth pvc polymer lego bottle binder polypropylene portfolio file",
               0.25,
               make_recipe(), (0.6, 0.6, 0.6), 0.35),
    make_entry("textured-plastic", "plastic", "Plastic",
               "plastic abs textured matte grained dashboard housing keyboard controller", 0.3,
               make_recipe(make_grains(0.5, 0.5, weight=0.6)), (0.05, 0.05, 0.05), 0.6),
    make_entry("ribbed-plastic", "plastic", "Plastic", "plastic ribbed grating grooved ridged grooves comb", 0.28,
               make_recipe(grating(3.0, 0.5 * MM, harmonic=0.3)), (0.1, 0.1, 0.1), 0.4),
    make_entry("plastic-mesh", "plastic", "Plastic", "plastic mesh net netting screen grid", 0.3,
               make_recipe(plain_weave(0.8, 1.0 * MM, irregularity=0.03)), (0.1, 0.2, 0.1), 0.5),
    make_entry("acrylic", "plastic", "Plastic", "plastic acrylic plexiglass perspex polycarbonate frosted pmma sheet",
               0.25,
               make_recipe(), (0.85, 0.87, 0.88), 0.4, transmission=0.7),
    make_entry("vinyl", "plastic", "Plastic", "vinyl plastic pvc record linoleum tablecloth oilcloth", 0.3,
               make_recipe(), (0.1, 0.1, 0.1), 0.4),
    make_entry("laminate", "plastic", "Plastic", "laminate whiteboard formica melamine countertop plastic desk", 0.22,
               make_recipe(), (0.9, 0.9, 0.9), 0.2),
    make_entry("bubble-wrap", "plastic", "Plastic",
               "bubble wrap envelope padded polyethylene film plastic mailer trash garbage", 0.3,
               make_recipe(), (0.85, 0.85, 0.85), 0.3, transmission=0.4),
    make_entry("carbon-fibre", "plastic", "Carbon fibre",
               "carbon fibre fiber composite cfrp kevlar fibreglass fiberglass", 0.21,
               make_recipe(twill(0.5, 0.5 * MM, repeat=4, irregularity=0.03)), (0.02, 0.02, 0.02), 0.3, scatter=0.3),
    # --- foam
    make_entry("soft-foam", "foam", "Foam", "foam sponge cushion padding pillow mattress soft polyurethane", 0.8,
               make_recipe(make_grains(0.8, 0.5, sign=-1, weight=0.5)), (0.75, 0.7, 0.5), 1.0, pile_mm=0.5),
    make_entry("eva-foam", "foam", "Foam", "foam eva epdm yoga insole neoprene polyethylene", 0.7,
               make_recipe(), (0.15, 0.15, 0.3), 0.9, pile_mm=0.2),
    make_entry("styrofoam", "foam", "Foam", "styrofoam polystyrene foam eps packaging", 0.5,
               make_recipe(make_grains(1.5, 0.6, weight=0.4)), (0.9, 0.9, 0.9), 0.8),
    # --- carpet
    make_entry("loop-carpet", "carpet", "Carpet", "carpet loop rug doormat berber sisal", 0.8,
               make_recipe(plain_weave(0.5, 2.2 * MM, irregularity=0.1)), (0.3, 0.27, 0.23), 1.0, sheen=0.3, pile_mm=4),
    make_entry("cut-pile-carpet", "carpet", "Carpet", "carpet pile rug shag fur plush", 0.8,
               make_recipe(make_grains(1.2, 0.5, weight=0.5)), (0.35, 0.1, 0.08), 1.0, sheen=0.6, pile_mm=6),
    make_entry("artificial-grass", "carpet", "Carpet", "artificial grass turf lawn astroturf moss", 0.6,
               make_recipe(make_grains(1.5, 0.4, weight=0.5, stretch=3.0)), (0.08, 0.25, 0.05), 0.8, pile_mm=5),
    # --- tile
    make_entry("glazed-tile", "tile", "Tile",
               "tile ceramic glazed porcelain bathroom kitchen cup mug plate vase pottery", 0.25,
               make_recipe(), (0.8, 0.8, 0.78), 0.12),
    make_entry("floor-tile", "tile", "Tile", "tile tiles floortile floor vinyl linoleum", 0.3,
               make_recipe(), (0.6, 0.55, 0.48), 0.4),
    make_entry("terracotta", "tile", "Tile", "tile terracotta terra cotta clay unglazed pot earthenware roof ceramic",
               0.4,
               make_recipe(make_grains(0.5, 0.15, sign=-1, weight=0.4)), (0.5, 0.19, 0.1), 0.85),
    # --- leather
    make_entry("leather", "leather", "", "leather hide strap saddle belt boot shoe jacket glove wallet bag skin", 0.45,
               make_recipe(make_grains(0.9, 0.9, weight=0.5)), (0.16, 0.07, 0.03), 0.55),
    make_entry("suede", "leather", "", "leather suede nubuck chamois moccasin back", 0.55,
               make_recipe(), (0.35, 0.22, 0.13), 1.0, sheen=0.5, pile_mm=0.25),
    make_entry("synthetic-leather", "leather", "", "pleather leatherette synthetic faux leather", 0.45,
               make_recipe(make_grains(0.7, 0.8, weight=0.5)), (0.1, 0.08, 0.08), 0.5),
    # --- rubber
    make_entry("rubber", "rubber", "", "rubber hose tube gasket seal silicone latex grip band eraser textured", 0.9,
               make_recipe(), (0.03, 0.03, 0.03), 0.8),
    make_entry("tyre-rubber", "rubber", "", "rubber tyre tire tread sole wheel ribbed", 0.95,
               make_recipe(grating(2.0, 2.0 * MM, harmonic=0.4)), (0.02, 0.02, 0.02), 0.95),
    # --- glass
    make_entry("clear-glass", "glass", "",
               "glass lens lenses window bottle crystal mirror visor goggles transparent", 0.16,
               make_recipe(), (0.95, 0.95, 0.95), 0.05, transmission=1.0),
    make_entry("frosted-glass", "glass", "", "glass frosted etched sandblasted translucent milky", 0.28,
               make_recipe(), (0.9, 0.92, 0.92), 0.6, transmission=0.9),
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


def sample_instance(class_name: str, seed: int) -> tuple[SurfaceRecipe, Mechanics]:
    """Sample an instance (one piece) of a material class: its surface recipe and mechanics.

    Parameters
    ----------
    class_name : str
        Name of the class.
    seed : int
        Seed; the same name and seed give the same instance. Its heights are ``height_map(recipe, seed)``.

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
    entry, scatter = _get_entry(class_name), DEFAULT_SCATTER
    rng = np.random.default_rng([derive_seed(class_name), seed])

    def factor(deviation: float) -> float:
        return float(np.exp(entry.scatter * deviation * np.clip(rng.standard_normal(), -2.0, 2.0)))

    level, fitted = factor(scatter.level), entry.constants
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
    constants = replace(
        fitted,
        height_um=fitted.height_um * level,
        slope=fitted.slope + float(np.log(factor(scatter.slope))),
        stiffness_n_m=fitted.stiffness_n_m * factor(scatter.stiffness),
        damping_ratio=fitted.damping_ratio * factor(scatter.damping),
        friction_noise_n=fitted.friction_noise_n * factor(scatter.level),
    )
    instance = replace(
        entry,
        constants=constants,
        parts=SurfaceRecipe((), lattices, grains),
        stretch=1.0 + (entry.stretch - 1.0) * factor(scatter.length),
        friction=entry.friction * factor(scatter.friction),
    )
    return build_recipe(instance), instance.mechanics


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
