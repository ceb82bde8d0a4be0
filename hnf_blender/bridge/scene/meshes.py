"""Objects → triangle meshes in the surface frame: their own frame with its scale applied, in metres."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.errors import SceneError
from hnf_core.scene.mesh import TriangleMesh, compute_float32_frame, has_area
from hnf_core.scene.raycast import ClosestPoints, Hits, RayCaster, find_closest_points, make_embree_caster, refine_hits

Float = NDArray[np.float64]
Int = NDArray[np.int32]

SOURCE_FACE = "hnf_source_face"
MIN_SIZE_M, MAX_SIZE_M = 1e-5, 1e6
"""Nothing smaller than a hundredth of a millimetre, or larger than a country, is stroked by hand."""


@dataclass(frozen=True)
class Surface:
    """An object as rays and strokes meet it.

    object_name: the object. mesh: in the surface frame, metres. rigid: (4, 4) world metres ← surface frame.
    stretch: (3, 3) surface frame (metres) ← object space (Blender units): scale, shear and unit.
    source_face: (F,) int32 evaluated polygon → polygon of the object's own mesh, -1 = none (made by a modifier from
    another object); None where the object has no mesh of its own. materials: names by slot, "" = empty slot.
    notes: what a person should know.
    """

    object_name: str
    mesh: TriangleMesh
    rigid: Float
    stretch: Float
    source_face: Int | None
    materials: tuple[str, ...]
    notes: tuple[str, ...] = ()


def compute_surface_frame(matrix_world: ArrayLike, metres_per_unit: float, where: str = "") -> tuple[Float, Float]:
    """(rigid, stretch): world metres = rigid · stretch · object coordinates.

    rigid: (4, 4) rotation and translation in metres. stretch: (3, 3), what is left of the object's matrix (polar
    decomposition M = R S), so that moving or turning the object changes rigid only. A mirrored object keeps its
    mirror in stretch. Raises SceneError where the object is scaled to a line or a point.
    """
    matrix = np.asarray(matrix_world, dtype=np.float64)
    linear = matrix[:3, :3]
    # Mirroring the x axis first keeps R a rotation, and S the same however the object is turned.
    mirror = np.diag([-1.0 if np.linalg.det(linear) < 0.0 else 1.0, 1.0, 1.0])
    left, scales, right = np.linalg.svd(linear @ mirror)
    if not np.isfinite(matrix).all() or scales[1] <= 1e-9 * max(scales[0], 1e-300):
        raise SceneError(
            "it is scaled to nothing in two directions.", where=where, remedy="Give it a scale above zero."
        )
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right)) or 1.0])
    rigid = np.eye(4)
    rigid[:3, :3] = left @ proper @ right
    rigid[:3, 3] = matrix[:3, 3] * metres_per_unit
    stretch = right.T @ proper @ np.diag(scales) @ right @ mirror * metres_per_unit
    return rigid, stretch


def read_surface(obj: Any, depsgraph: Any, metres_per_unit: float) -> Surface:
    """The evaluated surface of obj (modifiers, shape keys, Geometry Nodes' mesh) in its surface frame.

    obj: original or evaluated object in depsgraph. Raises SceneError where there is nothing to touch.
    """
    original = obj.original
    where = f"object '{original.name}'"
    flush_edits(original)
    evaluated = original.evaluated_get(depsgraph)
    rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, where)
    with evaluated_mesh(evaluated, depsgraph) as mesh:
        materials = get_materials(evaluated, mesh)
        triangles = _read_triangles(mesh, stretch, max(len(materials), 1), where)
        _require_size(triangles, where)
        source, notes = _find_source_faces(original, mesh, depsgraph)
    if original.data.users > 1:
        notes = (*notes, f"{where} shares its mesh with {original.data.users - 1} other user(s).")
    names = tuple("" if material is None else material.name for material in materials)
    return Surface(original.name, triangles, rigid, stretch, source, names, notes)


def _require_size(mesh: TriangleMesh, where: str) -> None:
    """Raises SceneError where the unit must be another."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if not MIN_SIZE_M <= size <= MAX_SIZE_M:
        raise SceneError(
            f"it is {size:.2g} m across: too large to touch by hand.", where=where,
            remedy="Check the unit scale (Scene properties > Units) and the object's own scale.",
        )  # fmt: skip


def flush_edits(obj: Any) -> None:
    """What is being edited becomes the object's mesh, as it does on leaving Edit Mode."""
    if obj.mode == "EDIT":
        obj.update_from_editmode()


def get_materials(evaluated: Any, mesh: Any) -> list[Any]:
    """The user's materials (None = empty slot) by material index of an evaluated object's mesh; those that Geometry
    Nodes sets included."""
    slots, own = list(evaluated.material_slots), list(mesh.materials)
    chosen = []
    for index in range(max(len(slots), len(own))):
        from_object = index < len(slots) and (slots[index].link == "OBJECT" or index >= len(own))
        chosen.append(slots[index].material if from_object else own[index])
    return [None if material is None else material.original for material in chosen]


def get_slot_materials(obj: Any, depsgraph: Any) -> list[Any]:
    """The user's materials (None = empty slot) by material index of an object's evaluated surface.

    Raises SceneError where it has none.
    """
    evaluated = obj.original.evaluated_get(depsgraph)
    with evaluated_mesh(evaluated, depsgraph) as mesh:
        return get_materials(evaluated, mesh)


@contextmanager
def evaluated_mesh(evaluated: Any, depsgraph: Any) -> Iterator[Any]:
    """The mesh of an evaluated object in object space; taken back at the end.

    Raises SceneError where the object has none.
    """
    try:
        mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    except RuntimeError:
        mesh = None
    where = f"object '{evaluated.name}'"
    if mesh is None:
        raise SceneError(
            f"it is a {evaluated.type.lower()} object and has no surface.", where=where, remedy="Touch a mesh object."
        )
    try:
        if len(mesh.polygons) == 0:
            raise SceneError(
                "its mesh has no faces to touch.", where=where, remedy="Give it faces, or choose another object."
            )
        yield mesh
    finally:
        evaluated.to_mesh_clear()


def hash_mesh(obj: Any, depsgraph: Any, metres_per_unit: float, layers: Iterable[str] = ()) -> str:
    """Hash of what a touch can feel of obj's shape: positions, topology, UVs, material indices and scale.

    layers: names of attributes, UV maps and colours that count too, "" = the colours that are drawn.
    Where the object stands and how it is turned does not count. 128 bits, hex.
    """
    original = obj.original
    evaluated = original.evaluated_get(depsgraph)
    _, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, f"object '{original.name}'")
    digest = hashlib.blake2b(digest_size=16)
    with evaluated_mesh(evaluated, depsgraph) as mesh:
        digest.update(np.array([len(mesh.vertices), len(mesh.loops), len(mesh.polygons)], dtype=np.int64).tobytes())
        digest.update(_read_array(mesh.vertices, "co", np.float32, 3).data)
        digest.update(_read_corner_vertices(mesh).data)
        digest.update(_read_array(mesh.polygons, "loop_start", np.int32).data)
        digest.update(_read_face_slots(mesh).data)
        digest.update(_read_array(mesh.corner_normals, "vector", np.float32, 3).data)
        uv = _read_uv(mesh)
        digest.update(b"" if uv is None else uv.data)
        for name in sorted(set(layers)):
            digest.update(_read_layer_bytes(mesh, name))
    # The polar decomposition of a turned object differs in the last bits; a millionth of its scale does not, nor −0
    # from 0. The power of two next to the scale is no number that a last bit changes.
    scale = stretch / metres_per_unit
    power = float(2.0 ** np.round(np.log2(np.linalg.norm(scale, 2))))
    digest.update((np.round(scale / power, 6) * power + 0.0).tobytes() + repr(float(metres_per_unit)).encode())
    return digest.hexdigest()


class BlenderGeometry:
    """Rays and nearest points by Blender's own BVH tree. The tree (float32) chooses the triangle; distances and
    barycentrics are float64. Slower than Embree for many rays; the only one with nearest points."""

    def __init__(self, mesh: TriangleMesh) -> None:
        from mathutils.bvhtree import BVHTree

        self._corners = mesh.corner_positions()
        self._frame = compute_float32_frame(self._corners)
        vertices = self._frame.to_frame(mesh.vertices)
        self._tree = BVHTree.FromPolygons(vertices.tolist(), mesh.triangles.tolist(), all_triangles=True)
        self._ray_tree: Any = None
        self._ray_triangle = np.flatnonzero(has_area(self._corners)).astype(np.int32)
        if len(self._ray_triangle) < len(mesh.triangles):
            self._ray_tree = BVHTree.FromPolygons(
                vertices.tolist(), mesh.triangles[self._ray_triangle].tolist(), all_triangles=True
            )

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        origins = np.asarray(origins, dtype=np.float64).reshape(-1, 3)
        directions = np.asarray(directions, dtype=np.float64).reshape(-1, 3)
        triangle = np.full(len(origins), -1, dtype=np.int32)
        tree = self._ray_tree or self._tree
        for index, (origin, direction) in enumerate(
            zip(self._frame.to_frame(origins).tolist(), directions.tolist(), strict=True)
        ):
            found = tree.ray_cast(origin, direction)[2]
            if found is not None:
                triangle[index] = self._ray_triangle[found]
        return refine_hits(self._corners, triangle, origins, directions)

    def closest_points(self, points: ArrayLike) -> ClosestPoints:
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        nearest = [self._tree.find_nearest(point)[2] for point in self._frame.to_frame(points).tolist()]
        return find_closest_points(self._corners, np.array(nearest, dtype=np.int32).reshape(-1), points)


def make_ray_caster(mesh: TriangleMesh, fallback: BlenderGeometry | None = None) -> RayCaster:
    """Embree where it is installed (not on Linux arm), Blender's BVH otherwise: equal results, ten times slower."""
    try:
        return make_embree_caster(mesh)
    except ImportError:
        return fallback or BlenderGeometry(mesh)


def _read_triangles(mesh: Any, stretch: Float, slots: int, where: str) -> TriangleMesh:
    mesh.calc_loop_triangles()
    vertices = _read_array(mesh.vertices, "co", np.float32, 3).astype(np.float64) @ stretch.T
    if not np.isfinite(vertices).all():
        raise SceneError("a vertex is not a number.", where=where, remedy="Run Mesh > Clean Up, or delete that vertex.")
    corners = _read_array(mesh.loop_triangles, "loops", np.int32, 3)
    triangles = _read_array(mesh.loop_triangles, "vertices", np.int32, 3)
    face = _read_array(mesh.loop_triangles, "polygon_index", np.int32)
    # Normals go by the cofactor matrix, which a flattened (zero) scale does not break.
    normals = (
        _read_array(mesh.corner_normals, "vector", np.float32, 3).astype(np.float64) @ compute_cofactors(stretch).T
    )
    if np.linalg.det(stretch) < 0.0:  # a mirror turns triangles inside out, not normals
        corners, triangles, normals = corners[:, [0, 2, 1]], triangles[:, [0, 2, 1]], -normals
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    uv = _read_uv(mesh)
    slot = _read_face_slots(mesh)[face]
    return TriangleMesh(
        vertices=vertices,
        triangles=np.ascontiguousarray(triangles),
        face=face,
        slot=np.clip(slot, 0, slots - 1).astype(np.int32),
        normals=normals[corners],
        uv=None if uv is None else uv.astype(np.float64)[corners],
    )


def compute_cofactors(matrix: Float) -> Float:
    """det(M) M⁻ᵀ, also where M is singular: how normals follow M."""
    first, second, third = matrix
    return np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)])


def _read_uv(mesh: Any) -> NDArray[np.float32] | None:
    """(loops, 2) of the UV map that renders, or None."""
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    return None if layer is None else _read_array(layer.uv, "vector", np.float32, 2)


ATTRIBUTE_LAYOUTS = {
    "FLOAT": ("value", np.float32, 1), "INT": ("value", np.int32, 1), "INT8": ("value", np.int32, 1),
    "BOOLEAN": ("value", np.bool_, 1), "FLOAT_VECTOR": ("vector", np.float32, 3), "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_COLOR": ("color", np.float32, 4), "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4), "FLOAT4X4": ("value", np.float32, 16), "INT32_2D": ("value", np.int32, 2),
    "INT16_2D": ("value", np.int32, 2),
}  # fmt: skip
"""Kinds of attributes: where their values are, of which type, how many an element."""


def _read_layer_bytes(mesh: Any, name: str) -> bytes:
    """Kind and values of a named attribute; the name alone where there is none."""
    colours = mesh.color_attributes
    if not name and len(colours):
        name = colours[colours.render_color_index].name
    attribute = mesh.attributes.get(name)
    if attribute is None or attribute.data_type not in ATTRIBUTE_LAYOUTS:
        return name.encode()
    values, dtype, width = ATTRIBUTE_LAYOUTS[attribute.data_type]
    data = _read_array(attribute.data, values, dtype, width)
    return f"{name} {attribute.domain} {attribute.data_type}".encode() + data.tobytes()


def _read_corner_vertices(mesh: Any) -> Int:
    """(corners,) by attribute: twenty times faster than mesh.loops, which the window's own thread feels."""
    attribute = mesh.attributes.get(".corner_vert")
    if attribute is None:
        return _read_array(mesh.loops, "vertex_index", np.int32)
    return _read_array(attribute.data, "value", np.int32)


def _read_face_slots(mesh: Any) -> Int:
    """(faces,) material index, likewise; without the attribute all faces have the first slot."""
    attribute = mesh.attributes.get("material_index")
    if attribute is None:
        return np.zeros(len(mesh.polygons), dtype=np.int32)
    if attribute.domain != "FACE" or attribute.data_type != "INT":
        return _read_array(mesh.polygons, "material_index", np.int32)
    return _read_array(attribute.data, "value", np.int32)


def _read_array(collection: Any, name: str, dtype: Any, width: int = 1) -> NDArray[Any]:
    values = np.empty(len(collection) * width, dtype=dtype)
    collection.foreach_get(name, values)
    return values.reshape(-1, width) if width > 1 else values


def _find_source_faces(original: Any, evaluated: Any, depsgraph: Any) -> tuple[Int | None, tuple[str, ...]]:
    """Evaluated polygon → polygon of original.data, and what to tell."""
    if original.type != "MESH":
        return None, (f"object '{original.name}' has no mesh of its own: tokens cannot be stored on it.",)
    count = len(evaluated.polygons)
    if _has_same_topology(original.data, evaluated):
        return np.arange(count, dtype=np.int32), ()
    faces = _trace_source_faces(original, depsgraph.scene.frame_current_final)
    if len(faces) != count:
        return np.full(count, -1, dtype=np.int32), (
            f"object '{original.name}': its modifiers hide which of its own faces became which.",
        )
    return faces, ()


def _has_same_topology(mesh: Any, evaluated: Any) -> bool:
    sizes = [(len(m.vertices), len(m.loops), len(m.polygons)) for m in (mesh, evaluated)]
    if sizes[0] != sizes[1]:
        return False
    starts = [_read_array(m.polygons, "loop_start", np.int32) for m in (mesh, evaluated)]
    return np.array_equal(starts[0], starts[1]) and np.array_equal(
        _read_corner_vertices(mesh), _read_corner_vertices(evaluated)
    )


def _trace_source_faces(original: Any, frame: float) -> Int:
    """Evaluate a copy whose faces carry their own index; integers pass through modifiers unblended."""
    from .temp_scene import TemporaryScene

    with TemporaryScene() as temporary:
        copy = temporary.copy_object(original, with_data=True)
        copy.data.attributes.new(SOURCE_FACE, "INT", "FACE")
        # Faces that come from elsewhere (a boolean's cutter) get 0, so count from 1.
        index = np.arange(1, len(copy.data.polygons) + 1, dtype=np.int32)
        copy.data.attributes[SOURCE_FACE].data.foreach_set("value", index)
        depsgraph = temporary.evaluate(frame)
        with evaluated_mesh(copy.evaluated_get(depsgraph), depsgraph) as mesh:
            attribute = mesh.attributes.get(SOURCE_FACE)
            if attribute is None or attribute.domain != "FACE":
                return np.zeros(0, dtype=np.int32)
            return _read_array(attribute.data, "value", np.int32) - 1
