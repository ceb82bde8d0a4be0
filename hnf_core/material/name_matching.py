"""Evidence for materials in names: words of materials, objects, collections and image files, in several languages.

Names are split into words, compounds into halves, and each library material gets the words that match it with weights.
The word for the stuff outweighs the word for the thing. `ranking.py` turns the weights into probabilities.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

from .library import LibraryMaterial

_WORD = re.compile(r"[^\W\d_]+")
_CAMEL = re.compile(r"(?<=[a-zß-öø-ÿ])(?=[A-ZÀ-ÖØ-Þ])|(?<=[A-ZÀ-ÖØ-Þ])(?=[A-ZÀ-ÖØ-Þ][a-zß-öø-ÿ])")

STOP_WORDS = frozenset(
    {
        *("mat", "mats", "mtl", "material", "materials", "shader", "tex", "texture"),
        *("low", "high", "lod", "geo", "geometry", "mesh", "obj", "object", "part", "parts"),
        *("pbr", "principled", "bsdf", "cc", "workflow", "default", "standard"),
    }
)
"""Words that mean "material", "object" or a way of working in any name: the mat in "HoseMat" is no door mat."""
WORKFLOW_PHRASES = (
    *(("metallic", "roughness"), ("metalness", "roughness"), ("metal", "roughness"), ("metallic", "rough")),
    *(("specular", "glossiness"), ("uv", "checker"), ("uv", "grid"), ("uv", "map")),
)
"""Pairs of words that name a way of working or a test picture, not a material."""

CATEGORY_WORDS = MappingProxyType(
    {
        "wood": "wood wooden timber lumber plywood veneer hardwood softwood parquet plank log bark oak pine walnut "
        "maple birch beech cherry mahogany teak ash cedar bamboo ebony mdf spruce fir cork laminate oakwood rosewood "
        "sycamore poplar larch chestnut hickory redwood driftwood chipboard osb "
        "holz eiche eichen buche buchen kiefer kiefern fichte fichten nussbaum ahorn birke esche kirschbaum parkett "
        "diele dielen sperrholz rinde borke kork spanplatte laminat "
        "bois chene hetre noyer erable liege ecorce contreplaque madera roble nogal haya corcho legno quercia rovere "
        "noce faggio sughero hout houten eiken beuken grenen kurk madeira carvalho",
        "metal": "metal metallic steel iron aluminium aluminum brass copper bronze gold silver chrome titanium zinc "
        "tin nickel rust rusty stainless pewter platinum tungsten alloy galvanized galvanised wrought chainmail "
        "metall stahl edelstahl eisen gusseisen kupfer messing blech chrom silber zinn zink blei rost rostig "
        "acier fer fonte laiton cuivre inox etain plomb argent rouille tole acero hierro cobre laton plata plomo "
        "oxidado metallo ferro acciaio ottone rame alluminio argento piombo staal ijzer koper zilver lood aco",
        "stone": "stone rock granite marble slate sandstone limestone concrete cement brick asphalt gravel pebble "
        "plaster stucco gneiss travertine onyx shale cobblestone cobble paving paver flagstone basalt terrazzo "
        "quartz quartzite obsidian boulder masonry mortar adobe tarmac rocky stony brickwork stonework plastered "
        "stein steine beton ziegel backstein klinker putz kies kiesel marmor schiefer sandstein kalkstein fels "
        "pflaster mauerwerk pierre granit marbre brique gres ardoise calcaire platre gravier "
        "piedra ladrillo hormigon pizarra arenisca yeso grava marmol granito pietra marmo mattone mattoni "
        "calcestruzzo ardesia arenaria gesso cemento steen baksteen marmer graniet leisteen pedra tijolo",
        "fabric": "fabric cloth textile velvet cotton wool linen denim silk satin canvas tweed corduroy felt "
        "polyester nylon jeans upholstery knit woven towel fleece jersey velour plush burlap twill flannel yarn "
        "damask jacquard brocade chenille hessian jute muslin cashmere mohair terry terrycloth teddy sherpa pique "
        "tartan spandex lycra crochet tapestry "
        "stoff samt baumwolle leinen wolle seide filz gewebe tuch polster tissu velours coton laine soie feutre toile "
        "tela lana algodon seda fieltro lona terciopelo mezclilla tessuto cotone lino seta feltro velluto stof "
        "katoen linnen zijde vilt fluweel tecido",
        "paper": "paper cardboard carton parchment papier papel carta book page newspaper wallpaper paperboard "
        "pappe wellpappe pappkarton tapete kartonnage cartone karton",
        "plastic": "plastic plastics acrylic abs pvc polycarbonate bakelite vinyl polypropylene polyethylene plastik "
        "kunststoff plastique plastico plastica pla petg polymer composite cfrp kevlar fibreglass fiberglass resin "
        "pmma perspex plexi melamine formica celluloid thermoplastic epoxy kunststof",
        "foam": "foam sponge styrofoam polystyrene polyurethane schaum schaumstoff mousse espuma schiuma styropor "
        "schwamm polistirolo schuim piepschuim",
        "carpet": "carpet rug doormat teppich moquette alfombra tappeto carpeting tapis moqueta tapijt vloerkleed "
        "fussmatte astroturf",
        "tile": "tile ceramic porcelain terracotta clay earthenware pottery faience fliese fliesen kachel kacheln "
        "keramik carrelage azulejo ceramica piastrella stoneware mosaic majolica porzellan steinzeug steingut "
        "dachziegel carreau ceramique porcelaine baldosa porcelana loza piastrelle porcellana cotto tegel tegels "
        "keramiek porselein",
        "leather": "leather suede nubuck leatherette hide cowhide chamois leder cuir cuero pelle nappa wildleder "
        "kunstleder daim gamuza cuoio camoscio couro piel",
        "rubber": "rubber latex silicone neoprene gummi caoutchouc goma gomma ebonite kautschuk silikon caucho "
        "elastomer vulcanized borracha",
        "glass": "glass glas crystal verre vidrio vetro vitre cristal vidro glazing windowpane",
    }
)
"""Names of materials by category, in several languages."""

OBJECT_WORDS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "lens": ("glass",),
        "window": ("glass",),
        "bottle": ("glass", "plastic"),
        "windscreen": ("glass",),
        "windshield": ("glass",),
        "hose": ("rubber",),
        "tire": ("rubber",),
        "tyre": ("rubber",),
        "gasket": ("rubber",),
        "sole": ("rubber",),
        "screw": ("metal",),
        "bolt": ("metal",),
        "rivet": ("metal",),
        "buckle": ("metal",),
        "chain": ("metal",),
        "zipper": ("metal",),
        "curtain": ("fabric",),
        "cushion": ("fabric", "foam"),
        "shirt": ("fabric",),
        "sofa": ("fabric", "leather"),
        "chair": ("wood", "fabric", "metal", "plastic"),
        "table": ("wood", "metal", "glass", "stone"),
        "floor": ("wood", "stone", "tile", "carpet"),
        "wall": ("stone", "paper", "wood"),
        "roof": ("tile", "stone", "metal"),
        "strap": ("leather", "fabric"),
        "belt": ("leather", "fabric"),
        "saddle": ("leather",),
        "pavement": ("stone",),
        "mug": ("tile",),
        "vase": ("tile", "glass"),
        "keyboard": ("plastic",),
        "mattress": ("foam", "fabric"),
    }
)
"""Objects and the categories of material that they are mostly made of: weaker evidence."""

TREES = frozenset(
    {
        *("oak", "pine", "walnut", "maple", "birch", "beech", "cherry", "ash", "cedar", "bamboo", "spruce", "fir"),
        *("sycamore", "poplar", "larch", "chestnut", "hickory", "eiche", "eichen", "buche", "buchen", "kiefer"),
        *("ahorn", "birke", "esche", "chene", "hetre", "noyer", "erable", "roble", "nogal", "quercia", "noce"),
    }
)
"""Words for wood that are trees too."""
PLANT_PARTS = frozenset(
    {
        *("leaf", "leave", "leaves", "foliage", "needle", "needles", "blossom", "blossoms", "flower", "flowers"),
        *("acorn", "acorns", "nut", "nuts", "twig", "twigs", "sapling", "blatt", "blatter", "laub", "feuille", "hoja"),
    }
)
"""Parts of a plant that are not of wood: with them, a tree is no word for wood."""
FINISHES = frozenset(
    {
        *("lacquered", "polished", "raw", "satin", "coated", "enamel", "stamped", "checker", "diamond", "blasted"),
        *("sandblasted", "weathered", "corroded", "oxidized", "glossy", "matte", "grained", "grooved", "ridged"),
        *("etched", "translucent", "milky", "faux", "unglazed", "paint", "knit", "wire", "screen", "grit", "twill"),
    }
)
"""Words of library materials for how a stuff is made or finished; with parts of materials' names and the words of
`CATEGORY_WORDS`, all that are not words for things."""

COMPOUND_PARTS = frozenset(
    {
        *("floor", "wall", "roof", "door", "table", "chair", "board", "panel", "plate", "plank", "beam", "fence"),
        *("deck", "bench", "handle", "grip", "knob", "frame", "rail", "pipe", "tube", "wire", "sheet", "trim", "shelf"),
        *("cabinet", "counter", "work", "ware", "side", "tread", "block", "slab"),
        *("boden", "wand", "mauer", "dach", "tisch", "stuhl", "brett", "platte", "bezug", "matte", "scheibe", "rohr"),
        *("reifen", "kiste", "regal", "schrank", "balken", "zaun", "treppe", "decke", "griff", "knopf", "fassade"),
        *("optik", "struktur", "textur", "muster", "farbe", "stange", "draht", "kette", "korb", "tasche", "jacke"),
        *("schuh", "verkleidung", "oberfläche", "leiste", "rahmen", "kachel", "ziegel"),
    }
)
"""Words that occur beside a material in a compound: woodfloor, Glasscheibe."""

CHANNEL_WORDS = frozenset(
    {
        *(
            "diff",
            "diffuse",
            "dif",
            "albedo",
            "alb",
            "base",
            "basecolor",
            "basecolour",
            "color",
            "colour",
            "col",
            "coll",
        ),
        *("nor", "nrm", "norm", "normal", "normals", "normalgl", "normaldx", "gl", "dx", "opengl", "directx"),
        *("rough", "roughness", "rgh", "gloss", "glossiness", "smoothness", "spec", "specular", "spc", "refl"),
        *("metallic", "metalness", "metallicness", "metalroughness", "metallicroughness", "roughmetal", "metalrough"),
        *("ao", "ambient", "occlusion", "disp", "displacement", "height", "bump", "bmp", "cavity", "curvature"),
        *("orm", "arm", "rma", "mra", "mask", "opacity", "alpha", "transmission", "emissive", "emission"),
        *("sheen", "anisotropy", "clearcoat", "thickness", "map", "jpg", "jpeg", "png", "k"),
    }
)
"""Words at the end of a texture's name that describe its channel or file, not the material."""
METAL_CHANNEL_PREFIXES = frozenset({"rough", "roughness", "occlusion", "ao"})
"""Words before "metal" that show that it is a channel: OcclusionRoughMetal."""
IMAGE_SUFFIX = re.compile(r"\.(jpe?g|png|tga|exr|tiff?|webp|bmp|dds|ktx2?|hdr|psd|basis)$", re.IGNORECASE)
"""File suffixes of images."""


def split_words(name: str) -> list[str]:
    """Split a name into lower-case words: "GlassPlasticMat.001" → glass, plastic, mat.

    CamelCase, separators and digits split; accents are removed, so that "métal" is "metal".
    """
    plain = unicodedata.normalize("NFC", name)
    parts = [word for run in _WORD.findall(plain) for word in _CAMEL.split(run)]
    return [_normalise_word(word) for word in parts if word]


def is_image_name(name: str) -> bool:
    """Return True if a name ends in the suffix of an image file."""
    return IMAGE_SUFFIX.search(name.strip()) is not None


def split_image_name(name: str) -> list[str]:
    """Split a texture's name into words, without its file type and channel.

    "T_Oak_Planks_BaseColor.png" → t, oak, planks; "SavonaTile_Metalness" → savona, tile.
    """
    words = split_words(IMAGE_SUFFIX.sub("", name.strip()))
    while words and (
        len(words[-1]) == 1
        or words[-1] in CHANNEL_WORDS
        or (words[-1] == "metal" and len(words) > 1 and words[-2] in METAL_CHANNEL_PREFIXES)
    ):
        words.pop()
    return words


def list_singulars(word: str) -> tuple[str, ...]:
    """Return the word and its possible singulars, likeliest first."""
    forms = [word]
    if len(word) > 3 and word.endswith("s") and not word.endswith("ss"):
        forms.append(word[:-1])
        if word.endswith("es"):
            forms.append(word[:-2])
        if word.endswith("ies"):
            forms.append(word[:-3] + "y")
    return tuple(forms)


def _normalise_word(word: str) -> str:
    decomposed = unicodedata.normalize("NFD", word.lower())
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))


NAME_WEIGHTS = (1.0, 0.6, 0.35)
"""Weights of words in the first name (the material's), the second (the object's), and any other."""
IMAGE_NAME_WEIGHT = 0.7
"""Weight of words in the name of an image that the shader uses: it was chosen for this surface, the object's was
not."""
OBJECT_WORD_WEIGHT = 0.55
"""Weight of words for objects and finishes: a lens is mostly glass, satin is often metal."""
NAME_PART_WEIGHT = 0.4
"""Weight of the single words of a library material's name: "coarse" is weak evidence for coarse-carpet."""
RELATED_WEIGHT = 0.4
"""Weight of a general word for materials of a category in which another material has the word as its own: velvet is
fabric, but not denim."""
OBJECT_FACTOR = 0.15
"""Factor on the weight of words for objects where a name has a word for another stuff: a suede shoe is of suede, and
shoes are of leather otherwise."""
MIN_HALF_LENGTH = 4
"""Least number of letters of each half of a compound; shorter words occur inside unrelated ones."""
COMPOUND_LINKS = ("", "n", "s", "en", "es")
"""Linking letters between the halves of German compounds: Eiche-n-tisch."""

Vocabulary = Mapping[str, Mapping[str, float]]
"""For each word or phrase (with spaces, or run together), its weight for each material by name."""
Hits = dict[str, dict[str, tuple[float, str]]]
"""For each material's name the matched words, with their weight and the name that contains them."""


def match_names(library: Sequence[LibraryMaterial], names: Sequence[str], image_names: Sequence[str] = ()) -> Hits:
    """Match the words of names with library materials.

    Parameters
    ----------
    library : sequence of LibraryMaterial
        The materials.
    names : sequence of str
        Name of the material first, then of the object, then any others.
    image_names : sequence of str
        Names of textures and of their files; words for their channel ("_Metalness") are ignored.

    Returns
    -------
    Hits
        For each material's name, its matched words with weight and source; a repeated word counts once, with its larger
        weight.

    Notes
    -----
    A word that fits materials of several categories weighs less; one that fits all categories weighs nothing. Beside
    words for another stuff, those for objects hardly count, and neither do trees beside parts of plants.
    """
    vocabulary = build_vocabulary(library)
    qualities = FINISHES | {part for material in library for part in material.name.split("-")}
    category = {material.name: material.category for material in library}
    count = len(set(category.values()))
    weighted_names = [
        (name, split_words(name), NAME_WEIGHTS[min(rank, len(NAME_WEIGHTS) - 1)]) for rank, name in enumerate(names)
    ]
    weighted_names += [(name, split_image_name(name), IMAGE_NAME_WEIGHT) for name in image_names]
    hits: Hits = {material.name: {} for material in library}
    matches = [
        (name, name_weight, word)
        for name, parts, name_weight in weighted_names
        for word in _find_matches(parts, vocabulary)
        if not (word in TREES and PLANT_PARTS.intersection(parts))
    ]
    stuffs = [vocabulary[word] for _, _, word in matches if word in MATERIAL_WORDS]
    for name, name_weight, word in matches:
        spread = len({category[material] for material in vocabulary[word]})
        specificity = 1.0 if count < 2 else 1.0 - math.log(spread) / math.log(count)
        names_object = bool(stuffs) and word not in MATERIAL_WORDS and not qualities.intersection(word.split())
        for material, weight in vocabulary[word].items():
            total = name_weight * specificity * weight
            if names_object and not any(stuff.get(material, 0.0) >= 1.0 for stuff in stuffs):
                total *= OBJECT_FACTOR
            if total > hits[material].get(word, (0.0, ""))[0]:
                hits[material][word] = (total, name)
    return hits


def build_vocabulary(library: Sequence[LibraryMaterial]) -> Vocabulary:
    """Return every word that is evidence for a material of the library, with its weight for each material."""
    return _cached_vocabulary(
        tuple(_MaterialWords(material.name, material.category, tuple(material.words)) for material in library)
    )


class _MaterialWords(NamedTuple):
    """The fields of a library material that its vocabulary depends on, hashable for the cache."""

    name: str
    category: str
    words: tuple[str, ...]


@lru_cache(maxsize=4)
def _cached_vocabulary(library: tuple[_MaterialWords, ...]) -> Vocabulary:
    """Build the vocabulary once per library: it takes 13 ms, and every material slot of every stroke needs it."""
    specific_words = {form for material in library for word in material.words for form in _get_word_forms(word)}
    category_words = {
        category: {form for word in words.split() for form in _get_word_forms(word)}
        for category, words in CATEGORY_WORDS.items()
    }
    vocabulary: dict[str, dict[str, float]] = {}
    for material in library:
        weighted: dict[str, float] = {}

        def add(words: Iterable[str], weight: float, into: dict[str, float] = weighted) -> None:
            for form in (form for word in words for form in _get_word_forms(word)):
                into[form] = max(into.get(form, 0.0), weight)

        related_words = CATEGORY_WORDS.get(material.category, "").split()
        own_category_words = category_words.get(material.category, set())
        add((word for word in related_words if word not in specific_words), 1.0)
        add(related_words, RELATED_WEIGHT)
        add(
            (object_word for object_word, categories in OBJECT_WORDS.items() if material.category in categories),
            OBJECT_WORD_WEIGHT,
        )
        add(material.name.split("-"), NAME_PART_WEIGHT)
        add(material.words, OBJECT_WORD_WEIGHT)
        add((word for word in material.words if _get_word_forms(word) & own_category_words), 1.0)
        add((material.category, material.name), 1.0)
        for form, weight in weighted.items():
            vocabulary.setdefault(form, {})[material.name] = weight
    return vocabulary


@lru_cache(maxsize=4096)
def _get_word_forms(word: str) -> frozenset[str]:
    """Return the spellings of a word or phrase, spaced and run together ("oak wood", "oakwood"), less stop words."""
    parts = split_words(word)
    return frozenset({" ".join(parts), "".join(parts)} - STOP_WORDS - {""})


def _find_matches(parts: Sequence[str], vocabulary: Vocabulary) -> list[str]:
    """Return the words, halves of compounds, and phrases of up to three words in a name that the vocabulary contains.

    `parts` are the words of the name in order.
    """
    working = {word for pair in pairwise(parts) if pair in WORKFLOW_PHRASES for word in pair}
    words = [word for word in parts if word not in STOP_WORDS and word not in working]
    matches: list[str] = []
    for length in (1, 2, 3):
        for start in range(len(words) - length + 1):
            head = " ".join(words[start : start + length - 1])
            for singular in list_singulars(words[start + length - 1]):
                phrase = f"{head} {singular}".strip()
                if phrase in vocabulary:
                    matches.append(phrase)
                    break
            else:
                matches += split_compound(words[start], vocabulary) if length == 1 else []
    return matches


def split_compound(word: str, vocabulary: Vocabulary) -> list[str]:
    """Return the halves of a compound that the vocabulary contains: "gummireifen" → gummi.

    Both halves must be known words, one of them a material, so that nothing is found inside unrelated words; else the
    result is empty.
    """
    for cut in range(MIN_HALF_LENGTH, len(word) - MIN_HALF_LENGTH + 1):
        last = next((form for form in list_singulars(word[cut:]) if _is_compound_half(form, vocabulary)), None)
        if last is None:
            continue
        for link in COMPOUND_LINKS:
            first = word[: cut - len(link)]
            if (
                not word[:cut].endswith(link)
                or len(first) < MIN_HALF_LENGTH
                or not _is_compound_half(first, vocabulary)
            ):
                continue
            if first in MATERIAL_WORDS or last in MATERIAL_WORDS:
                return [half for half in (first, last) if half in vocabulary]
    return []


MATERIAL_WORDS = frozenset(
    form for words in CATEGORY_WORDS.values() for word in words.split() for form in _get_word_forms(word)
)
"""All words of `CATEGORY_WORDS`."""
_COMPOUND_FORMS = frozenset(form for word in COMPOUND_PARTS for form in _get_word_forms(word))


def _is_compound_half(word: str, vocabulary: Vocabulary) -> bool:
    return word in _COMPOUND_FORMS or word in MATERIAL_WORDS or (word in OBJECT_WORDS and word in vocabulary)
