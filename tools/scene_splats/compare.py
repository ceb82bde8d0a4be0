"""The same patches looked at twice, on the true mesh and on splats of it: depth, token, and what they are taken for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_blender.bridge.closeup import CloseUp, iter_closeups
from hnf_blender.bridge.look import UnlitImage
from hnf_blender.bridge.meshes import Surface
from hnf_blender.bridge.splat_closeup import iter_splat_closeups
from hnf_blender.bridge.splat_cloud import create_cloud, link_cloud
from hnf_blender.touch.seeing import ReliefPredictor
from hnf_core.material.library import load_library
from hnf_core.material.material import Appearance
from hnf_core.material.merge import merge_tokens
from hnf_core.material.prior import rank
from hnf_core.material.relief import INVARIANT_KINDS, WITHIN_CLASS_SPREAD, compute_invariants
from hnf_core.material.token import BAND_WAVELENGTHS_M, LEVELS, SHAPE_FEATURES, Token
from hnf_core.scene.patch import Patch
from hnf_core.scene.splats.cloud import Splats
from hnf_core.scene.splats.splatter import render_splats
from hnf_core.tactile.tactile_map import Route

Float = NDArray[np.float64]

CLOSEUP_PIXELS = 512
PREDICTION_SEED = 0
BAND_COUNT = len(BAND_WAVELENGTHS_M)


@dataclass(frozen=True)
class PatchReading:
    """What one close-up tells. token: by the predicted route, None where the picture cannot be read. colour: linear
    mean. resolved_m: shortest wave that the picture shows."""

    token: Token | None
    colour: tuple[float, float, float] | None
    resolved_m: float


@dataclass(frozen=True)
class PatchPair:
    """One patch. expected_m, median_m: median absolute errors of the splats' two depths, metres; inf where
    they show none. covered: share of what the mesh shows at which the splats show a surface. mesh, splats: what each
    tells; alike: what the mesh tells of the waves alone that the splats show too."""

    object_name: str
    material: str
    expected_m: float
    median_m: float
    covered: float
    mesh: PatchReading
    splats: PatchReading
    alike: PatchReading


def remove_relief(scene: Any) -> None:
    """Leave of every material its colour alone, as a reconstruction does, so that it is read from pictures."""
    for obj in scene.objects:
        for slot in getattr(obj, "material_slots", ()):
            tree = slot.material.node_tree if slot.material is not None else None
            for link in list(tree.links) if tree is not None else ():
                bump = link.to_socket.name in {"Normal", "Coat Normal"} and link.to_node.bl_idname.startswith(BSDF)
                if bump or (link.to_node.bl_idname == OUTPUT and link.to_socket.name == "Displacement"):
                    tree.links.remove(link)


BSDF, OUTPUT = "ShaderNodeBsdf", "ShaderNodeOutputMaterial"


def compare_patches(
    obj: Any,
    surface: Surface,
    patches: Sequence[Patch],
    splats: Splats,
    metres_per_unit: float,
    predictor: ReliefPredictor,
) -> Iterator[PatchPair]:
    """A pair a patch. splats: of obj, in its surface frame."""
    cloud = create_cloud("Splats", splats, "the comparison")
    link_cloud(obj, cloud)
    # The cloud counts in metres of the surface frame, whatever the object's own scale.
    place = np.eye(4)
    place[:3, :3] = np.linalg.inv(surface.stretch)
    cloud.matrix_basis = _to_matrix(place)
    true = iter_closeups(obj, patches, surface=surface, pixels=CLOSEUP_PIXELS, metres_per_unit=metres_per_unit)
    seen = iter_splat_closeups(obj, cloud, patches, surface=surface, pixels=CLOSEUP_PIXELS)
    for patch, mesh, splat in zip(patches, true, seen, strict=True):
        expected, median, covered = compute_depth_errors(mesh, splats)
        name = surface.materials[patch.slot] if patch.slot < len(surface.materials) else ""
        look = read_patch(splat, predictor)
        own, alike = read_patch(mesh, predictor), read_patch(mesh, predictor, look.resolved_m)
        yield PatchPair(obj.name, name, expected, median, covered, own, look, alike)


def compute_depth_errors(mesh: CloseUp, splats: Splats) -> tuple[float, float, float]:
    """Median absolute errors of expected and of median depth (metres) where the patch's own surface is seen, and the
    share of that which splats cover. splats: in the patch's frame."""
    view = render_splats(splats, mesh.view.camera)
    own = mesh.mask & np.isfinite(mesh.view.depth)
    covered = own & (view.opacity >= 0.5)
    if not covered.any():
        return float("inf"), float("inf"), 0.0
    errors = [
        np.abs(depth[covered].astype(np.float64) - mesh.view.depth[covered]) for depth in (view.depth, view.median)
    ]
    return float(np.median(errors[0])), float(np.median(errors[1])), float(covered.sum() / own.sum())


def read_patch(closeup: CloseUp, predictor: ReliefPredictor, coarsest_m: float = 0.0) -> PatchReading:
    """coarsest_m: the picture is taken to show no shorter wave."""
    look: UnlitImage | None = closeup.unlit
    if look is not None and look.resolved_wavelength_m < coarsest_m:
        look = replace(look, resolved_wavelength_m=coarsest_m)
    token = None
    if look is not None:
        views = predictor.make_views(look, closeup.mask, closeup.metres_per_pixel)
        token = predictor.predict(look, views, PREDICTION_SEED).token if views else None
    resolved = float("inf") if look is None else look.resolved_wavelength_m
    return PatchReading(token, closeup.appearance.base_color, resolved)


def choose_library_material(reading: PatchReading, names: Sequence[str] = ()) -> str:
    """What the library takes a patch for, by its colour and its relief, and by names where they are given."""
    route = Route.PRIOR if reading.token is None else Route.PREDICTED
    return rank(load_library(), Appearance(reading.colour), names, token=reading.token, route=route)[0].name


@dataclass(frozen=True)
class PaletteEntry:
    """Of the palette that the true mesh gives: one a material."""

    name: str
    token: Token


def make_palette(pairs: Sequence[PatchPair]) -> tuple[PaletteEntry, ...]:
    """What the true mesh's patches of each material say together; without those that no picture tells of."""
    tokens: dict[str, list[Token]] = {}
    for pair in pairs:
        if pair.mesh.token is not None:
            tokens.setdefault(get_entry_name(pair), []).append(pair.mesh.token)
    return tuple(PaletteEntry(name, merge_tokens(own)) for name, own in tokens.items())


def get_entry_name(pair: PatchPair) -> str:
    return f"{pair.object_name}: {pair.material}"


def find_nearest_entry(token: Token, palette: Sequence[PaletteEntry], known: NDArray[np.bool_]) -> str:
    """The entry whose token is nearest over the features known: in standard deviations between pieces of one class,
    over what no turn of the surface changes."""
    own = compute_invariants(token.values[None])[0]
    within = np.array(
        [WITHIN_CLASS_SPREAD[kind] for kind in INVARIANT_KINDS for _ in range(BAND_COUNT)]
        + [WITHIN_CLASS_SPREAD[name] for name in SHAPE_FEATURES]
    )
    counted = np.concatenate([np.tile(known[LEVELS], len(INVARIANT_KINDS)), known[-len(SHAPE_FEATURES) :]])

    def distance(entry: PaletteEntry) -> float:
        off = (own - compute_invariants(entry.token.values[None])[0]) / within
        return float(np.sum(off[counted] ** 2))

    return min(palette, key=distance).name


def compute_level_difference_db(pair: PatchPair) -> float | None:
    """RMS over the bands that both know, of height in dB; None where they share none."""
    if pair.mesh.token is None or pair.splats.token is None:
        return None
    both = (pair.mesh.token.known & pair.splats.token.known)[LEVELS]
    if not both.any():
        return None
    off = (pair.mesh.token.values - pair.splats.token.values)[LEVELS][both]
    return float(20.0 * np.sqrt(np.mean(off.astype(np.float64) ** 2)))


def _to_matrix(values: Float) -> Any:
    from mathutils import Matrix

    return Matrix(values.tolist())
