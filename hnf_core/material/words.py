"""What names say of materials: splitting them into words, and the words that name a category."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from types import MappingProxyType

_WORD = re.compile(r"[^\W\d_]+")
_CAMEL = re.compile(r"(?<=[a-zß-öø-ÿ])(?=[A-ZÀ-ÖØ-Þ])|(?<=[A-ZÀ-ÖØ-Þ])(?=[A-ZÀ-ÖØ-Þ][a-zß-öø-ÿ])")

STOP_WORDS = frozenset(
    {
        *("mat", "mats", "mtl", "material", "materials", "shader", "tex", "texture"),
        *("low", "high", "lod", "geo", "geometry", "mesh", "obj", "object", "part", "parts"),
    }
)
"""Words that say "material" or "object" themselves: a mat in "HoseMat" is not a door mat."""

CATEGORY_WORDS = MappingProxyType(
    {
        "wood": "wood wooden timber lumber plywood veneer hardwood softwood parquet plank log bark holz bois madera "
        "legno oak pine walnut maple birch beech cherry mahogany teak ash cedar bamboo ebony mdf spruce fir cork",
        "metal": "metal metallic steel iron aluminium aluminum brass copper bronze gold silver chrome titanium zinc "
        "tin nickel rust rusty stainless metall stahl eisen acier fer laiton cuivre acero hierro metallo",
        "stone": "stone rock granite marble slate sandstone limestone concrete cement brick asphalt gravel pebble "
        "stein beton pierre granit marbre piedra pietra plaster stucco gneiss travertine onyx shale",
        "fabric": "fabric cloth textile velvet cotton wool linen denim silk satin canvas tweed corduroy felt "
        "polyester nylon jeans upholstery knit woven towel stoff samt tissu velours tela tessuto fleece jersey velour "
        "plush burlap twill flannel yarn",
        "paper": "paper cardboard carton parchment papier papel carta book page newspaper wallpaper",
        "plastic": "plastic plastics acrylic abs pvc polycarbonate bakelite vinyl polypropylene polyethylene plastik "
        "kunststoff plastique plastico plastica pla petg polymer composite cfrp kevlar fibreglass fiberglass",
        "foam": "foam sponge styrofoam polystyrene polyurethane schaum schaumstoff mousse espuma schiuma",
        "carpet": "carpet rug doormat teppich moquette alfombra tappeto",
        "tile": "tile ceramic porcelain terracotta clay earthenware pottery faience fliese kachel keramik carrelage "
        "azulejo ceramica piastrella",
        "leather": "leather suede nubuck leatherette hide cowhide chamois leder cuir cuero pelle",
        "rubber": "rubber latex silicone neoprene gummi caoutchouc goma gomma ebonite",
        "glass": "glass glas crystal verre vidrio vetro plexiglass",
    }
)
"""Materials of each category by name, in several languages."""

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
"""Things, and what they are mostly made of: a weaker hint."""


def split_words(name: str) -> list[str]:
    """Lower-case words of a name: "GlassPlasticMat.001" → glass, plastic, mat. CamelCase, separators and digits
    split; accents go, so that "métal" is "metal"."""
    plain = unicodedata.normalize("NFC", name)
    parts = [word for run in _WORD.findall(plain) for word in _CAMEL.split(run)]
    return [_plain(word) for word in parts if word]


def singulars(word: str) -> tuple[str, ...]:
    """The word and what it may be the plural of, likeliest first."""
    forms = [word]
    if len(word) > 3 and word.endswith("s") and not word.endswith("ss"):
        forms.append(word[:-1])
        if word.endswith("es"):
            forms.append(word[:-2])
        if word.endswith("ies"):
            forms.append(word[:-3] + "y")
    return tuple(forms)


def _plain(word: str) -> str:
    decomposed = unicodedata.normalize("NFD", word.lower())
    return "".join(letter for letter in decomposed if not unicodedata.combining(letter))
