"""Splats ↔ Blender: a mesh with one vertex per Gaussian, and the file's values as named attributes.

This object is called the cloud. A mesh is used because the point clouds of Blender 4.2 to 5.0 cannot be given a number
of points. The surface refers to its cloud by an ID property, which survives renaming, saving and appending.
`CloudFrame` converts between the cloud's frame and the surface frame of strokes, patches and cameras.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.errors import SceneError
from hnf_core.scene.camera import Camera
from hnf_core.scene.splats.gaussians import Splats

from ..props.object_cache import CachedFilter
from .scene.meshes import flush_edits
from .scene.stored_data import CONFIDENCE_ATTRIBUTE, TOKEN_ATTRIBUTE, PointTokens

Float = NDArray[np.float64]

CLOUD_PROPERTY = "hnf_splats"
"""ID property of a surface: the object with its splats."""
SCHEMA_PROPERTY = "hnf_splats_schema"
SOURCE_PROPERTY = "hnf_splats_source"
NOTES_PROPERTY = "hnf_splats_notes"
"""ID property of a surface: remarks of its reconstruction, one per line."""
SCHEMA = 1
SCALE_ATTRIBUTE, ROTATION_ATTRIBUTE, OPACITY_ATTRIBUTE, HARMONIC_ATTRIBUTE = "scale", "rotation", "opacity", "sh_{}"
COEFFICIENT_COUNTS = (1, 4, 9, 16)
"""Possible numbers of spherical harmonics, of degree 0 to 3."""


def create_cloud(name: str, splats: Splats, source: str) -> Any:
    """Create the cloud, a mesh object with a vertex per splat, in no scene yet.

    It is hidden in renders and cannot be selected, since the surface is what is touched. `source` is the file's name,
    for the report.
    """
    import bpy

    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(splats))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(splats.means).ravel())
    _write_attribute(mesh, SCALE_ATTRIBUTE, "FLOAT_VECTOR", "vector", splats.scales)
    _write_attribute(mesh, ROTATION_ATTRIBUTE, "QUATERNION", "value", splats.rotations)
    _write_attribute(mesh, OPACITY_ATTRIBUTE, "FLOAT", "value", splats.opacities)
    for index in range(splats.harmonics.shape[1]):
        _write_attribute(mesh, HARMONIC_ATTRIBUTE.format(index), "FLOAT_VECTOR", "vector", splats.harmonics[:, index])
    mesh[SCHEMA_PROPERTY], mesh[SOURCE_PROPERTY] = SCHEMA, source
    cloud = bpy.data.objects.new(name, mesh)
    cloud.hide_render = cloud.hide_select = True
    return cloud


def read_cloud(cloud: Any) -> Splats:
    """Read the splats stored in a cloud object, bit for bit, with changes made since in Blender.

    Raises SceneError if an attribute is missing, of another type, or invalid.
    """
    flush_edits(cloud)
    mesh, where = cloud.data, f"object '{cloud.name}'"
    count = len(mesh.vertices)
    means = np.empty(3 * count, dtype=np.float32)
    mesh.vertices.foreach_get("co", means)
    harmonics = [
        _read_attribute(mesh, HARMONIC_ATTRIBUTE.format(index), "FLOAT_VECTOR", "vector", 3, where)
        for index in _list_harmonics(mesh)
    ]
    if len(harmonics) not in COEFFICIENT_COUNTS:
        raise _unreadable_cloud_error(
            where, f"it has {len(harmonics)} attributes of color ({HARMONIC_ATTRIBUTE.format(0)}, …), not 1, 4, 9, 16"
        )
    splats = Splats(
        means=means.reshape(-1, 3),
        scales=_read_attribute(mesh, SCALE_ATTRIBUTE, "FLOAT_VECTOR", "vector", 3, where),
        rotations=_read_attribute(mesh, ROTATION_ATTRIBUTE, "QUATERNION", "value", 4, where),
        opacities=_read_attribute(mesh, OPACITY_ATTRIBUTE, "FLOAT", "value", 1, where).ravel(),
        harmonics=np.stack(harmonics, axis=1),
    )
    parts = (splats.means, splats.scales, splats.rotations, splats.opacities, splats.harmonics)
    if not all(np.isfinite(part).all() for part in parts):
        raise _unreadable_cloud_error(where, "one of its values is not a number")
    if count == 0 or splats.scales.min() <= 0.0 or not np.linalg.norm(splats.rotations, axis=1).min() > 0.0:
        raise _unreadable_cloud_error(
            where, "it has no splats" if count == 0 else "a splat of it has no size or no direction"
        )
    return splats


def is_cloud(obj: Any) -> bool:
    """Return True if an object is a cloud of splats."""
    return obj is not None and obj.type == "MESH" and obj.data.get(SCHEMA_PROPERTY) is not None


def link_cloud(surface: Any, cloud: Any, notes: Sequence[str] = ()) -> None:
    """Make `surface` the mesh that is touched in place of a cloud of splats, which becomes its child.

    `notes` are remarks for the user, stored with it.
    """
    surface[CLOUD_PROPERTY] = cloud
    surface[NOTES_PROPERTY] = "\n".join(notes)
    cloud.parent = surface


def get_cloud(obj: Any) -> Any:
    """Return the object with a surface's splats, or None."""
    cloud = obj.original.get(CLOUD_PROPERTY) if obj is not None else None
    return cloud if is_cloud(cloud) else None


TOUCHABLE_SURFACES = CachedFilter(lambda obj: get_cloud(obj) is not None)
"""Surfaces that have splats."""


def get_cloud_surface(cloud: Any) -> Any:
    """Return the surface of a cloud if it is the cloud's parent, else None."""
    return cloud.parent if cloud.parent is not None and get_cloud(cloud.parent) == cloud else None


def get_cloud_source(cloud: Any) -> str:
    """Return the name of the file that a cloud was read from."""
    return str(cloud.data.get(SOURCE_PROPERTY, cloud.name))


def get_reconstruction_notes(surface: Any) -> tuple[str, ...]:
    """Return the remarks of a surface's reconstruction; none if the surface has no splats."""
    if get_cloud(surface) is None:
        return ()
    return tuple(line for line in str(surface.original.get(NOTES_PROPERTY, "")).split("\n") if line)


def hash_cloud(surface: Any, cloud: Any) -> str:
    """Hash all that a close-up shows of a surface's splats: values, placement on the surface, name of the splat file.

    Names of objects and the surface's placement in the world do not count. 128 bits, hexadecimal.
    """
    flush_edits(cloud)
    mesh = cloud.data
    digest = hashlib.blake2b(digest_size=16)
    positions = np.empty(3 * len(mesh.vertices), dtype=np.float32)
    mesh.vertices.foreach_get("co", positions)
    digest.update(f"{SCHEMA} {len(mesh.vertices)} {get_cloud_source(cloud)}".encode() + positions.tobytes())
    kinds = {SCALE_ATTRIBUTE: ("vector", 3), ROTATION_ATTRIBUTE: ("value", 4), OPACITY_ATTRIBUTE: ("value", 1)}
    kinds.update({HARMONIC_ATTRIBUTE.format(index): ("vector", 3) for index in _list_harmonics(mesh)})
    for name, (values, width) in kinds.items():
        attribute = mesh.attributes.get(name)
        digest.update(name.encode())
        if attribute is not None and len(attribute.data) and hasattr(attribute.data[0], values):
            data = np.empty(len(attribute.data) * width, dtype=np.float32)
            attribute.data.foreach_get(values, data)
            digest.update(data.tobytes())
    digest.update((np.round(get_cloud_placement(surface, cloud), 6) + 0.0).tobytes())
    return digest.hexdigest()


def get_cloud_placement(surface: Any, cloud: Any) -> Float:
    """Return the matrix (4, 4) from the cloud's frame to the surface's object space.

    If the cloud is the child of its surface, this is its offset from the parent: nothing is evaluated, so it works for
    a hidden cloud, and moving both changes no bit. Otherwise it follows from both world matrices.
    """
    if get_cloud_surface(cloud) is not None:
        return np.array(cloud.matrix_parent_inverse @ cloud.matrix_basis, dtype=np.float64)
    from_world = np.linalg.inv(np.array(surface.matrix_world, dtype=np.float64))
    return np.asarray(from_world @ np.array(cloud.matrix_world, dtype=np.float64))


def write_point_tokens(cloud: Any, tokens: PointTokens) -> None:
    """Store baked tokens per splat; the palette that they index is on the surface's mesh.

    Raises SceneError if the cloud is linked or in Edit Mode, or if the number of splats differs.
    """
    mesh = cloud.data
    require_writable(cloud)
    if not len(tokens.index) == len(tokens.confidence) == len(mesh.vertices):
        raise SceneError(
            f"it has {len(mesh.vertices)} splats, the bake has {len(tokens.index)}.", where=f"object '{cloud.name}'"
        )
    _write_attribute(mesh, TOKEN_ATTRIBUTE, "INT", "value", np.ascontiguousarray(tokens.index, dtype=np.int32))
    _write_attribute(
        mesh, CONFIDENCE_ATTRIBUTE, "FLOAT", "value", np.ascontiguousarray(tokens.confidence, dtype=np.float32)
    )


def remove_point_tokens(cloud: Any) -> int:
    """Remove the baked tokens from a cloud; return the bytes freed.

    Raises SceneError if the cloud is linked or in Edit Mode.
    """
    require_writable(cloud)
    mesh, freed = cloud.data, 0
    for name in (TOKEN_ATTRIBUTE, CONFIDENCE_ATTRIBUTE):
        attribute = mesh.attributes.get(name)
        if attribute is not None:
            mesh.attributes.remove(attribute)
            freed += 4 * len(mesh.vertices)
    return freed


def require_writable(cloud: Any) -> None:
    """Raise SceneError for a cloud that is linked or in Edit Mode."""
    mesh, where = cloud.data, f"object '{cloud.name}'"
    if mesh.library is not None:
        raise SceneError(
            f"its splats are linked from {mesh.library.filepath} and keep no tokens.",
            where=where,
            remedy="Make it local (Object > Relations > Make Local).",
        )
    if mesh.is_editmode:
        raise SceneError("its splats are in Edit Mode.", where=where, remedy="Leave Edit Mode and bake again.")


def _list_harmonics(mesh: Any) -> list[int]:
    """Return the indices of the spherical-harmonics attributes of the mesh, from 0 up to the first gap."""
    pattern = re.compile(HARMONIC_ATTRIBUTE.format(r"(\d+)"))
    present = {int(match[1]) for name in mesh.attributes.keys() if (match := pattern.fullmatch(name))}  # noqa: SIM118
    return list(range(next(number for number in range(len(present) + 1) if number not in present)))


def _write_attribute(mesh: Any, name: str, kind: str, values: str, data: NDArray[Any]) -> None:
    attribute = mesh.attributes.get(name)
    if attribute is not None and (attribute.data_type != kind or attribute.domain != "POINT"):
        mesh.attributes.remove(attribute)
        attribute = None
    if attribute is None:
        mesh.attributes.new(name, kind, "POINT")
    mesh.attributes[name].data.foreach_set(values, np.ascontiguousarray(data).ravel())


def _read_attribute(mesh: Any, name: str, kind: str, values: str, width: int, where: str) -> NDArray[np.float32]:
    attribute = mesh.attributes.get(name)
    if attribute is None or attribute.data_type != kind or attribute.domain != "POINT":
        raise _unreadable_cloud_error(where, f"its attribute '{name}' is gone or of another kind")
    data = np.empty(width * len(mesh.vertices), dtype=np.float32)
    attribute.data.foreach_get(values, data)
    return data.reshape(-1, width)


def _unreadable_cloud_error(where: str, why: str) -> SceneError:
    return SceneError(
        f"its splats cannot be read: {why}.", where=where, remedy="Undo that change, or import the file again."
    )


SCALE_TOLERANCE = 1e-4
"""Relative difference between the scales of three axes that counts as rounding of Blender's float32."""


@dataclass(frozen=True)
class CloudFrame:
    """Transformation between a cloud and the surface frame.

    Attributes
    ----------
    metres_per_unit : float
        Length of the cloud's unit [m].
    rotation : (3, 3) array
        Rotation, surface frame ← cloud.
    translation : (3,) array
        The cloud's origin in the surface frame [m].
    """

    metres_per_unit: float
    rotation: Float
    translation: Float

    def to_surface(self, points: NDArray[np.floating[Any]]) -> Float:
        """Transform the cloud's points (n, 3) into the surface frame [m]."""
        return np.asarray(points, dtype=np.float64) @ (self.metres_per_unit * self.rotation).T + self.translation

    def to_cloud_camera(self, camera: Camera) -> Camera:
        """Transform a camera from the surface frame [m] into the cloud's frame and unit."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotation.T @ camera.pose[:3, :3]
        pose[:3, 3] = self.rotation.T @ (camera.pose[:3, 3] - self.translation) / self.metres_per_unit
        intrinsics = camera.intrinsics * np.array([[self.metres_per_unit], [self.metres_per_unit], [1.0]])
        intrinsics[:2, 2] = camera.intrinsics[:2, 2]
        return replace(
            camera,
            intrinsics=intrinsics if camera.kind == "orthographic" else camera.intrinsics,
            pose=pose,
            clip_start=camera.clip_start / self.metres_per_unit,
            clip_end=camera.clip_end / self.metres_per_unit,
        )


def compute_cloud_frame(obj: Any, cloud: Any, stretch: Float) -> CloudFrame:
    """Compute the transformation from a surface's splats to its surface frame.

    `stretch` (3, 3) is that of its Surface: surface frame [m] ← object space. Raises SceneError if the splats are
    scaled unevenly or mirrored.
    """
    placement = get_cloud_placement(obj, cloud)
    linear = stretch @ placement[:3, :3]
    metres = get_uniform_scale(linear, f"object '{obj.name}'")
    # The last bits of a turned object's stretch are rounding errors, which could swap the order of two splats.
    rotation = np.round(linear / metres, 6) + 0.0
    return CloudFrame(float(f"{metres:.7g}"), rotation, stretch @ placement[:3, 3])


def get_uniform_scale(matrix: Float, where: str) -> float:
    """Return the scale k of a matrix (3, 3) that is k times a rotation.

    Raises SceneError for any other matrix, since Gaussians of a stretched or mirrored cloud differ from those trained.
    """
    left, sizes, right = np.linalg.svd(matrix)
    if not np.isfinite(matrix).all() or sizes[2] <= 0.0 or sizes[0] > (1.0 + SCALE_TOLERANCE) * sizes[2]:
        raise SceneError(
            f"its splats are scaled by {sizes[0]:.3g}, {sizes[1]:.3g} and {sizes[2]:.3g} along three axes.",
            where=where,
            remedy="Give the object one scale along all axes (N panel > Item > Scale).",
        )
    if np.linalg.det(left @ right) < 0.0:
        raise SceneError("its splats are mirrored.", where=where, remedy="Make the object's scale positive.")
    return float(np.mean(sizes))
