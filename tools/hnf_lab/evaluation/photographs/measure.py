"""Measure what the product makes of photographs of recorded textures, named after them and without a name.

Each photograph is the base color of a plane in Blender, stroked as `hnf touch` strokes it. The token and mechanics that
it gives are rendered and compared as `hnf eval recordings` compares those of the library: same conditions, directions,
spectra, distance and baselines. Identification is judged by kinds of stuff, see `is_right`.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.parse_stroke import parse_stroke
from hnf_core.datasets.hatt import HattFolder
from hnf_core.errors import FileError, SceneError
from hnf_core.field.field import Field
from hnf_core.field.weights import load_field
from hnf_core.material.library import LibraryMaterial
from hnf_core.progress import Progress, ProgressCallback, ignore_progress
from hnf_core.touch_request import StrokeRequest, TouchRequest

from ..recordings.measure import (
    CONDITIONS,
    RecordedTexture,
    compute_baselines,
    read_textures,
    render_density,
)
from ..recordings.spectra import Distance, average_bins_db, average_distances, compare_levels

if TYPE_CHECKING:
    from hnf_blender.touch.baked_stroke import BakedStroke

Float = NDArray[np.float64]

SIDE_M = 0.0683
"""Side of the surface that a photograph of HaTT shows [m]."""
STROKE = "scrape left to right, 1 N, 100 mm/s"
KIND_OF_CATEGORY = {"leather": "fabric"}
"""Kind of stuff of a library category, where it has another name: HaTT counts leather as fabric."""
KIND_OF_RECORDING = {"carbon": "plastic", "sandpaper": "paper"}
"""Kind of stuff of a recorded texture in the library's categories, where the library has no such category."""
KINDS_OF_CLAY = ("stone", "tile")
"""Kinds that fired clay counts as: recordings call it stone, the library tile."""
LOUD_ERROR_DB = 15.0
"""Distance beyond which an answer is worse than silence would be taken for [dB]."""
CALIBRATION_BINS = 5


@dataclass(frozen=True)
class PhotographResult:
    """Result for one photograph, named or not.

    Attributes
    ----------
    texture
        The recording.
    named
        True if picture and material were named after the texture.
    material, kind
        Likeliest library material and its kind of stuff.
    confidence
        Confidence that it prints for the material.
    reason
        Why, as the report says it.
    right
        True if the kind is that of the texture.
    distance
        Of what is felt from the recording, mean over its conditions [dB].
    baselines
        Distance of the recordings' own means, see `recordings.measure.BASELINES` [dB].
    """

    texture: RecordedTexture
    named: bool
    material: str
    kind: str
    confidence: float
    reason: str
    right: bool
    distance: Distance
    baselines: tuple[Distance, ...]


def get_kind(material: LibraryMaterial) -> str:
    """Return the kind of stuff of a library material."""
    return KIND_OF_CATEGORY.get(material.category, material.category)


def get_recorded_kind(texture: RecordedTexture) -> str:
    """Return the kind of stuff of a recorded texture by its name, "" if its name means none."""
    return KIND_OF_RECORDING.get(texture.category, texture.category)


def is_right(material: LibraryMaterial, texture: RecordedTexture) -> bool:
    """Return True if a material is of the texture's kind of stuff."""
    kind = get_recorded_kind(texture)
    return get_kind(material) == kind or (material.name == "terracotta" and kind in KINDS_OF_CLAY)


def measure_photographs(
    folder: Path, *, seconds: float, progress: ProgressCallback = ignore_progress
) -> list[PhotographResult]:
    """Touch the photograph of every recorded texture of a copy of HaTT, named and without a name.

    Parameters
    ----------
    folder
        The copy.
    seconds
        Length of each rendered stroke [s].
    progress
        Called before each texture.

    Returns
    -------
    list of PhotographResult
        Two a texture, in the order of the names: named, then not.

    Raises
    ------
    FileError
        If the folder holds no texture model with a photograph.
    """
    textures, data, field = read_textures(folder), HattFolder(folder), load_field()
    shown = [(texture, image) for texture in textures if (image := data.image(texture.name)) is not None]
    if not shown:
        raise FileError("none of its texture models has a photograph.", where=str(folder),
                        remedy="Give a folder with HaTT's models and pictures.")  # fmt: skip
    results = []
    with tempfile.TemporaryDirectory() as scratch:
        for done, (texture, image) in enumerate(shown):
            progress(Progress(texture.name, done, len(shown)))
            baselines = compute_baselines(texture, textures)
            for named, baked in touch_photograph(texture.name, image, Path(scratch)):
                results.append(_judge(texture, named, baked, field, baselines, seconds))
    return results


def touch_photograph(name: str, image: Path, folder: Path) -> list[tuple[bool, BakedStroke]]:
    """Return the bakes of one stroke on a plane that shows an image, named `name`, then without a name."""
    scene, files = folder / "scene.blend", {}
    for named, stem in ((True, name), (False, "image")):
        files[named] = folder / f"{stem}{image.suffix}"
        shutil.copyfile(image, files[named])
    save_planes(scene, [(name, files[True]), ("Material", files[False])])
    strokes = tuple(StrokeRequest(parse_stroke(STROKE), target) for target in ("Plane", "Plane.001"))
    bakes = _bake(TouchRequest(scene=scene, out=folder / "out", strokes=strokes))
    for file in files.values():
        file.unlink()
    return list(zip((True, False), bakes, strict=True))


def save_planes(path: Path, planes: Sequence[tuple[str, Path]], side_m: float = SIDE_M) -> None:
    """Save a scene of planes a metre apart, each with a material of a name and an image file as its base color."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    for index, (name, image) in enumerate(planes):
        bpy.ops.mesh.primitive_plane_add(size=side_m, location=(float(index), 0.0, 0.0))
        material: Any = bpy.data.materials.new(name)
        material.use_nodes = True
        texture = material.node_tree.nodes.new("ShaderNodeTexImage")
        texture.image = bpy.data.images.load(str(image))
        shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
        bpy.context.object.data.materials.append(material)
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def _bake(request: TouchRequest) -> list[BakedStroke]:
    """Bake the strokes of a request by the product's own steps; raise SceneError if one fails."""
    from hnf_blender import cli
    from hnf_blender.touch import run as touch_run
    from hnf_blender.touch.bake_patches import CACHE_FOLDER_NAME
    from hnf_blender.touch.session import gather_jobs
    from hnf_blender.touch.synthesise import bake_strokes

    cli._register_properties()
    session, _ = touch_run._make_session(touch_run.open_named_scene("touch", request.scene), request)
    gathered = gather_jobs(session)
    report = touch_run._new_report(session, gathered, [])
    bakes: list[BakedStroke] = []
    collect: Callable[..., None] = lambda job, baked, start_stage: bakes.append(baked)  # noqa: E731
    bake_strokes(session, gathered.jobs, request.folder / CACHE_FOLDER_NAME, report, collect)
    if report.failed or len(bakes) != len(request.strokes):
        raise SceneError("a photograph could not be touched.", where=str([each.why for each in report.failed]))
    return bakes


def _judge(
    texture: RecordedTexture,
    named: bool,
    baked: BakedStroke,
    field: Field,
    baselines: tuple[Distance, ...],
    seconds: float,
) -> PhotographResult:
    from hnf_blender.touch.synthesise import make_stroke_input

    stroke, patch = make_stroke_input(baked), baked.main_patch
    density = np.stack(
        [
            render_density(field, stroke.tokens[patch], stroke.mechanics[patch], CONDITIONS[index], seconds)
            for index in texture.conditions
        ]
    )
    distances = [
        compare_levels(levels, recorded)
        for levels, recorded in zip(average_bins_db(density), average_bins_db(texture.density), strict=True)
    ]
    main = baked.main_material
    return PhotographResult(
        texture,
        named,
        main.library.name,
        get_kind(main.library),
        main.confidence,
        main.reason,
        is_right(main.library, texture),
        average_distances(distances),
        baselines,
    )


def compute_calibration(confidence: Sequence[float], right: Sequence[bool]) -> tuple[float, Float]:
    """Compute the expected calibration error of confidences.

    Parameters
    ----------
    confidence
        (n,) 0 to 1.
    right
        (n,) whether each answer was right.

    Returns
    -------
    error : float
        Mean over the answers of |share right − mean confidence| of their bin.
    bins : ndarray
        (CALIBRATION_BINS, 3) mean confidence, share right and count of equally filled bins, least confident first.
    """
    order = np.argsort(np.asarray(confidence), kind="stable")
    parts = [part for part in np.array_split(order, CALIBRATION_BINS) if len(part)]
    told, hits = np.asarray(confidence, dtype=np.float64), np.asarray(right, dtype=np.float64)
    bins = np.array([[told[part].mean(), hits[part].mean(), len(part)] for part in parts])
    return float(np.sum(bins[:, 2] * np.abs(bins[:, 0] - bins[:, 1])) / len(order)), bins


def compute_accuracy(results: Sequence[PhotographResult]) -> tuple[float, float]:
    """Return the share of right kinds among the textures whose name means one, and its mean over those kinds."""
    known = [result for result in results if get_recorded_kind(result.texture)]
    by_kind: dict[str, list[bool]] = {}
    for result in known:
        by_kind.setdefault(get_recorded_kind(result.texture), []).append(result.right)
    if not known:
        return float("nan"), float("nan")
    return (
        float(np.mean([result.right for result in known])),
        float(np.mean([np.mean(hits) for hits in by_kind.values()])),
    )
