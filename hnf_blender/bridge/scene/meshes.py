"""Objects → triangle meshes in the surface frame, and ray casts and nearest points on them.

The surface frame is the object's own frame with its scale applied, in meters. It follows from the polar decomposition
of the world matrix, so that moving or turning an object does not change its mesh.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hnf_core.errors import SceneError
from hnf_core.progress import add_work
from hnf_core.scene.mesh import TriangleMesh, compute_float32_frame, has_area
from hnf_core.scene.raycast import Hits, ViewCaster, as_ray_arrays, make_embree_caster, refine_hits

from ..shader.images import explain_missing_image, get_absolute_path

Float = NDArray[np.float64]
Int = NDArray[np.int32]

SOURCE_FACE = "hnf_source_face"
"""Face attribute of a temporary copy, whose modifiers carry the original face indices to the faces that they make."""
MAX_COORDINATE_STEP_M = 1e-4
"""Rounding of coordinates above which a surface is noted to be too far from 0 [m]."""
MIN_SIZE_M, MAX_SIZE_M = 1e-5, 1e6
"""Sizes of a surface outside this range mean that the unit must be wrong [m]."""


@dataclass(frozen=True)
class Surface:
    """Evaluated surface of an object in the surface frame: the object's own frame with its scale applied, in meters.

    Attributes
    ----------
    object_name : str
    mesh : TriangleMesh
        In the surface frame [m].
    rigid : (4, 4) array
        World [m] ← surface frame.
    stretch : (3, 3) array
        Surface frame [m] ← object space [Blender units]: scale, shear and unit.
    source_face : (F,) int32 array or None
        Polygon of the object's own mesh for every evaluated polygon; −1 if a modifier made it from another object. None
        if the object has no mesh of its own.
    materials : tuple of str
        Material name by slot, "" for an empty slot.
    notes : tuple of str
        Remarks for the user.
    """

    object_name: str
    mesh: TriangleMesh
    rigid: Float
    stretch: Float
    source_face: Int | None
    materials: tuple[str, ...]
    notes: tuple[str, ...] = ()


def compute_surface_frame(matrix_world: ArrayLike, metres_per_unit: float, where: str = "") -> tuple[Float, Float]:
    """Decompose a world matrix into (rigid, stretch): world [m] = rigid · stretch · object coordinates.

    The surface frame, in which shapes are stored, lies between the two.

    Parameters
    ----------
    matrix_world : (4, 4) array_like
        World matrix of the object.
    metres_per_unit : float
        Length of a Blender unit [m].
    where : str, optional
        Object named in errors.

    Returns
    -------
    rigid : (4, 4) array
        Rotation and translation [m].
    stretch : (3, 3) array
        Scale, shear, mirror and unit.

    Raises
    ------
    SceneError
        If the object is scaled to a line or a point.

    Notes
    -----
    The linear part is split by the polar decomposition M = R S, so that moving or turning an object changes only
    `rigid`. A mirrored object keeps its mirror in `stretch`.
    """
    matrix = np.asarray(matrix_world, dtype=np.float64)
    linear = matrix[:3, :3]
    # Mirroring the x axis first keeps R a rotation, and makes S independent of the object's rotation.
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
    """Read the evaluated surface of an object, in its surface frame.

    Modifiers, shape keys and the mesh of Geometry Nodes are included.

    Parameters
    ----------
    obj : bpy.types.Object
        Original or evaluated object in `depsgraph`.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].

    Returns
    -------
    Surface

    Raises
    ------
    SceneError
        If there is no surface, or its size or scale is not usable.
    """
    original = obj.original
    where = f"object '{original.name}'"
    flush_edits(original)
    evaluated = original.evaluated_get(depsgraph)
    rigid, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, where)
    with evaluated_mesh(evaluated, depsgraph) as mesh:
        materials = get_materials(evaluated, mesh)
        _require_numbers(original, mesh, where)
        triangles = _read_triangles(mesh, stretch, max(len(materials), 1))
        _require_size(triangles, where)
        if not _has_any_area(triangles):
            raise SceneError(
                "none of its faces has any area to touch.", where=where, remedy="Touch another object, or rebuild it."
            )
        source, notes = _find_source_faces(original, mesh, depsgraph)
    if original.data.users > 1:
        notes = (*notes, f"{where} shares its mesh with {original.data.users - 1} other user(s).")
    notes = (*notes, *describe_idle_modifiers(original, evaluated))
    step_m = get_coordinate_step(evaluated) * metres_per_unit
    if step_m > MAX_COORDINATE_STEP_M:
        far = f"{where}: its coordinates are so far from 0 that they are rounded to steps of {step_m * 1e3:.2g} mm."
        notes = (*notes, f"{far} Subtract the map's offset where it was made, and import it again.")
    names = tuple("" if material is None else material.name for material in materials)
    return Surface(original.name, triangles, rigid, stretch, source, names, notes)


REQUIRED_INPUTS = {
    "ARMATURE": "object", "CURVE": "object", "DATA_TRANSFER": "object", "LATTICE": "object",
    "MESH_DEFORM": "object", "MESH_CACHE": "filepath", "MESH_SEQUENCE_CACHE": "cache_file", "NODES": "node_group",
    "HOOK": "object", "SHRINKWRAP": "target", "SURFACE_DEFORM": "target", "WARP": "object_from",
}  # fmt: skip
"""Types of modifiers → property without which they do nothing."""
BOUND_FLAGS = {
    "CORRECTIVE_SMOOTH": "is_bind", "LAPLACIANDEFORM": "is_bind", "MESH_DEFORM": "is_bound",
    "SURFACE_DEFORM": "is_bound",
}  # fmt: skip
"""Types of modifiers that do nothing before they are bound → property that tells whether they are."""


def describe_idle_modifiers(original: Any, evaluated: Any) -> tuple[str, ...]:
    """Describe modifiers that fail: those without an input that they need, those not bound, and Geometry Nodes' errors.

    What they would shape is not felt.
    """
    notes = []
    for modifier in original.modifiers:
        if not modifier.show_viewport:
            continue
        problem = _find_modifier_problem(modifier, evaluated.modifiers.get(modifier.name))
        if problem:
            notes.append(
                f"object '{original.name}': its modifier '{modifier.name}' fails ({problem}), so that its shape is not "
                "felt. Repair or remove it."
            )
    return tuple(notes)


def _find_modifier_problem(modifier: Any, evaluated: Any) -> str:
    required = REQUIRED_INPUTS.get(modifier.type, "")
    if required and not getattr(modifier, required):
        return f"its {required.replace('_', ' ')} is missing"
    flag = BOUND_FLAGS.get(modifier.type, "")
    if flag and not getattr(modifier, flag) and getattr(modifier, "rest_source", "BIND") == "BIND":
        return "it is not bound"
    if modifier.type in {"MESH_CACHE", "MESH_SEQUENCE_CACHE"}:
        path = modifier.filepath if modifier.type == "MESH_CACHE" else modifier.cache_file.filepath
        is_there = get_absolute_path(path, modifier.id_data.library).is_file()
        return "" if is_there else f"its file {path} is not there"
    if modifier.type == "BOOLEAN":
        source = "object" if modifier.operand_type == "OBJECT" else "collection"
        return "" if getattr(modifier, source) else f"its {source} is missing"
    if modifier.type == "DISPLACE" and modifier.texture is not None and modifier.texture.type == "IMAGE":
        image = modifier.texture.image
        missing = "it has none" if image is None else explain_missing_image(image)
        return f"the image of its texture is missing: {missing}" if missing else ""
    # Blender 5.0 gives them on the original alone.
    warnings = [*getattr(modifier, "node_warnings", ()), *getattr(evaluated, "node_warnings", ())]
    errors = [warning.message for warning in warnings if warning.type == "ERROR"]
    return errors[0] if errors else ""


def _has_any_area(mesh: TriangleMesh) -> bool:
    """Return True if any triangle has an area; the first thousand nearly always tell."""
    corners = mesh.corner_positions()
    return bool(has_area(corners[:1000]).any() or has_area(corners[1000:]).any())


def _require_numbers(original: Any, mesh: Any, where: str) -> None:
    """Raise SceneError if a vertex of an object's evaluated mesh is not a number; names whose fault it is."""
    if np.isfinite(_read_array(mesh.vertices, "co", np.float32, 3)).all():
        return
    own = original.data if original.type == "MESH" else mesh
    bad = np.flatnonzero(~np.isfinite(_read_array(own.vertices, "co", np.float32, 3)).all(axis=1))
    if len(bad):
        raise SceneError(
            f"a vertex (number {bad[0]}) is not a number.", where=where,
            remedy=f"Delete it, or run D.meshes[{original.data.name!r}].validate() in the Python Console.",
        )  # fmt: skip
    names = ", ".join(f"'{modifier.name}'" for modifier in original.modifiers if modifier.show_viewport)
    raise SceneError(
        f"its modifiers ({names}) make a vertex that is not a number.", where=where, remedy="Repair or remove them."
    )


def get_coordinate_step(evaluated: Any) -> float:
    """Return the step [Blender units] to which float32 rounds the largest coordinate of an object's bounding box."""
    return float(np.spacing(np.float32(np.abs(np.array([tuple(each) for each in evaluated.bound_box])).max())))


def _require_size(mesh: TriangleMesh, where: str) -> None:
    """Raise SceneError if a mesh is so small or large that its unit must be wrong."""
    size = float(np.ptp(mesh.vertices, axis=0).max())
    if not MIN_SIZE_M <= size <= MAX_SIZE_M:
        raise SceneError(
            f"it is {size:.2g} m across: too large to touch by hand.", where=where,
            remedy="Check the unit scale (Scene properties > Units) and the object's own scale.",
        )  # fmt: skip


def flush_edits(obj: Any) -> None:
    """Write edits in progress to the object's mesh, as leaving Edit Mode does."""
    if obj.mode == "EDIT":
        obj.update_from_editmode()


def get_materials(evaluated: Any, mesh: Any) -> list[Any]:
    """Return the user's materials by material index of an evaluated object's mesh; None for an empty slot.

    Materials set by Geometry Nodes are included.
    """
    slots, mesh_materials = list(evaluated.material_slots), list(mesh.materials)
    materials = []
    for index in range(max(len(slots), len(mesh_materials))):
        from_object = index < len(slots) and (slots[index].link == "OBJECT" or index >= len(mesh_materials))
        materials.append(slots[index].material if from_object else mesh_materials[index])
    return [None if material is None else material.original for material in materials]


def get_slot_materials(obj: Any, depsgraph: Any) -> list[Any]:
    """Return the user's materials by material index of an object's evaluated surface; None for an empty slot.

    Raises SceneError if it has no surface.
    """
    evaluated = obj.original.evaluated_get(depsgraph)
    with evaluated_mesh(evaluated, depsgraph) as mesh:
        return get_materials(evaluated, mesh)


@contextmanager
def evaluated_mesh(evaluated: Any, depsgraph: Any, *, copied: bool = True) -> Iterator[Any]:
    """Yield the mesh of an evaluated object in object space; it is freed when the with block ends.

    Without `copied` that of a mesh object is read where it is, which is faster and lacks some layers. Raises SceneError
    if the object has no mesh or no faces.
    """
    mesh = None
    if not copied and evaluated.type == "MESH":
        mesh = evaluated.data
    else:
        add_work("meshes", item=evaluated.name)
        with suppress(RuntimeError):
            mesh = evaluated.to_mesh(preserve_all_data_layers=True, depsgraph=depsgraph)
    where = f"object '{evaluated.name}'"
    if mesh is None:
        raise SceneError(
            f"it is a {evaluated.type.lower()} object and has no surface.", where=where, remedy="Touch a mesh object."
        )
    try:
        if len(mesh.polygons) == 0:
            what, remedy = _explain_missing_faces(evaluated.original)
            raise SceneError(what, where=where, remedy=remedy)
        yield mesh
    finally:
        evaluated.to_mesh_clear()


def _explain_missing_faces(original: Any) -> tuple[str, str]:
    """Return what is wrong with an object whose evaluated mesh has no faces, and what to do."""
    if original.type == "MESH" and len(original.data.polygons):
        return "its modifiers leave no face to touch.", "Repair or remove them."
    return "its mesh has no faces to touch.", "Give it faces, or choose another object."


def hash_mesh(obj: Any, depsgraph: Any, metres_per_unit: float, layers: Iterable[str] = ()) -> str:
    """Hash an object's shape: positions, topology, normals, UVs, material indices and scale.

    Its position and rotation do not count.

    Parameters
    ----------
    obj : bpy.types.Object
        Object to read.
    depsgraph : bpy.types.Depsgraph
        Evaluated dependency graph of the scene.
    metres_per_unit : float
        Length of a Blender unit [m].
    layers : iterable of str, optional
        Names of attributes, UV maps and colors that count too; "" is the color that is rendered.

    Returns
    -------
    str
        128 bits, hexadecimal.

    Raises
    ------
    SceneError
        If the object has no surface.
    """
    original = obj.original
    evaluated = original.evaluated_get(depsgraph)
    stretch = _compute_steady_stretch(evaluated, metres_per_unit, f"object '{original.name}'")
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
    # The polar decomposition of a turned object differs in its last bits, so the scale is rounded to a millionth of
    # the nearest power of two, which a last bit does not change. Adding 0 makes −0 equal to 0.
    scale = stretch / metres_per_unit
    power = float(2.0 ** np.round(np.log2(np.linalg.norm(scale, 2))))
    digest.update((np.round(scale / power, 6) * power + 0.0).tobytes() + repr(float(metres_per_unit)).encode())
    return digest.hexdigest()


UNIFORM_TOLERANCE = 1e-5
"""Relative difference between two scales that float32 matrices leave uncertain."""


def _compute_steady_stretch(evaluated: Any, metres_per_unit: float, where: str) -> Float:
    """Return the stretch of `compute_surface_frame` without the last bits that moving and turning an object changes.

    It is computed from the scales of the object and its parents; rotations are left out where they change no shape. If
    something else scales the object, as a constraint does, it is that of the world matrix.
    """
    _, stretch = compute_surface_frame(evaluated.matrix_world, metres_per_unit, where)
    chain = [evaluated]
    while chain[-1].parent is not None:
        chain.append(chain[-1].parent)
    linear = np.eye(3)
    for member in reversed(chain):
        if member.parent is not None:
            linear = _drop_rotation(linear @ np.array(member.matrix_parent_inverse, dtype=np.float64)[:3, :3])
        scale = np.array(member.scale, dtype=np.float64) * np.array(member.delta_scale, dtype=np.float64)
        is_uniform = np.array_equal(linear, linear[0, 0] * np.eye(3))
        basis = np.diag(scale) if is_uniform else np.array(member.matrix_basis, dtype=np.float64)[:3, :3]
        linear = _drop_rotation(linear @ basis)
    world = np.eye(4)
    world[:3, :3] = linear
    if np.linalg.matrix_rank(linear) < 2:
        return stretch
    _, steady = compute_surface_frame(world, metres_per_unit, where)
    return steady if np.abs(steady - stretch).max() <= UNIFORM_TOLERANCE * np.abs(stretch).max() else stretch


def _drop_rotation(linear: Float) -> Float:
    """Return a matrix (3, 3) as a multiple of the identity if it scales all directions alike, else unchanged."""
    scales = np.linalg.svd(linear, compute_uv=False)
    if np.linalg.det(linear) <= 0.0 or scales[0] - scales[2] > UNIFORM_TOLERANCE * scales[0]:
        return linear
    return np.asarray(scales[0] * np.eye(3))


class BlenderGeometry:
    """Ray casts on a mesh by Blender's BVH tree, slower than Embree for many rays.

    The float32 tree selects the triangle; distances and barycentric coordinates are computed in float64.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        from mathutils.bvhtree import BVHTree

        self._corners = mesh.corner_positions()
        self._frame = compute_float32_frame(self._corners)
        vertices = self._frame.to_frame(mesh.vertices)
        self._ray_triangle = np.flatnonzero(has_area(self._corners)).astype(np.int32)
        triangles = mesh.triangles[self._ray_triangle]
        self._tree = BVHTree.FromPolygons(vertices.tolist(), triangles.tolist(), all_triangles=True)

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Cast rays; origins and directions are (n, 3) in the mesh's frame."""
        origins, directions = as_ray_arrays(origins, directions)
        return refine_hits(self._corners, self.find_triangles(origins, directions), origins, directions)

    def find_triangles(self, origins: Float, directions: Float) -> NDArray[np.int32]:
        """Return the first triangle (n,) that n rays hit, -1 if none; origins (n, 3), directions (n, 3) or (1, 3)."""
        triangle = np.full(len(origins), -1, dtype=np.int32)
        towards = np.broadcast_to(directions, origins.shape).tolist()
        for index, (origin, direction) in enumerate(zip(self._frame.to_frame(origins).tolist(), towards, strict=True)):
            hit = self._tree.ray_cast(origin, direction)[2]
            if hit is not None:
                triangle[index] = self._ray_triangle[hit]
        return triangle


def make_ray_caster(mesh: TriangleMesh) -> ViewCaster:
    """Make an Embree ray caster, or one of Blender's BVH if Embree is not installed (Linux on ARM).

    Both give equal results; Blender's is ten times slower.
    """
    add_work("caster_triangles", len(mesh.triangles))
    try:
        return make_embree_caster(mesh)
    except ImportError:
        return BlenderGeometry(mesh)


def _read_triangles(mesh: Any, stretch: Float, slots: int) -> TriangleMesh:
    """Read an evaluated mesh's triangles, with vertices multiplied by `stretch` (3, 3) into the surface frame [m].

    `slots` is the number of material slots.
    """
    mesh.calc_loop_triangles()
    vertices = _read_array(mesh.vertices, "co", np.float32, 3).astype(np.float64) @ stretch.T
    corners = _read_array(mesh.loop_triangles, "loops", np.int32, 3)
    triangles = _read_array(mesh.loop_triangles, "vertices", np.int32, 3)
    face = _read_array(mesh.loop_triangles, "polygon_index", np.int32)
    # The cofactor matrix transforms normals also if one scale is zero, where the inverse does not exist.
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
    """Compute the cofactor matrix det(M) M⁻ᵀ of M (3, 3), which transforms normals, also if M is singular."""
    first, second, third = matrix
    return np.stack([np.cross(second, third), np.cross(third, first), np.cross(first, second)])


def _read_uv(mesh: Any) -> NDArray[np.float32] | None:
    """Return the (loops, 2) coordinates of the UV map that is rendered, or None."""
    layer = next((layer for layer in mesh.uv_layers if layer.active_render), None)
    return None if layer is None else _read_array(layer.uv, "vector", np.float32, 2)


ATTRIBUTE_LAYOUTS = {
    "FLOAT": ("value", np.float32, 1), "INT": ("value", np.int32, 1), "INT8": ("value", np.int32, 1),
    "BOOLEAN": ("value", np.bool_, 1), "FLOAT_VECTOR": ("vector", np.float32, 3), "FLOAT2": ("vector", np.float32, 2),
    "FLOAT_COLOR": ("color", np.float32, 4), "BYTE_COLOR": ("color", np.float32, 4),
    "QUATERNION": ("value", np.float32, 4), "FLOAT4X4": ("value", np.float32, 16), "INT32_2D": ("value", np.int32, 2),
    "INT16_2D": ("value", np.int32, 2),
}  # fmt: skip
"""Types of attributes: property with the values, dtype, values per element."""


def _read_layer_bytes(mesh: Any, name: str) -> bytes:
    """Return the type and values of a named attribute as bytes; the name alone if there is none."""
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
    """Return the vertex index of every face corner (corners,).

    Reading the attribute is twenty times faster than mesh.loops, which would delay the interface.
    """
    attribute = mesh.attributes.get(".corner_vert")
    if attribute is None:
        return _read_array(mesh.loops, "vertex_index", np.int32)
    return _read_array(attribute.data, "value", np.int32)


def _read_face_slots(mesh: Any) -> Int:
    """Return the material index of every face (faces,); 0 if the mesh has no such attribute."""
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
    """Return, for every evaluated polygon, the polygon of the object's own mesh it comes from, and notes for the user.

    The first is None if the object has no mesh of its own.
    """
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
    """Return True if modifiers left the faces of a mesh as they are, so that `evaluated` has the same ones."""
    sizes = [(len(m.vertices), len(m.loops), len(m.polygons)) for m in (mesh, evaluated)]
    if sizes[0] != sizes[1]:
        return False
    starts = [_read_array(m.polygons, "loop_start", np.int32) for m in (mesh, evaluated)]
    return np.array_equal(starts[0], starts[1]) and np.array_equal(
        _read_corner_vertices(mesh), _read_corner_vertices(evaluated)
    )


def _trace_source_faces(original: Any, frame: float) -> Int:
    """Find each evaluated face's original face by evaluating a copy of the object whose faces carry their index.

    The index is an integer attribute, which modifiers copy without blending.
    """
    from .temp_scene import TemporaryScene

    with TemporaryScene() as temporary:
        copy = temporary.copy_object(original, with_data=True)
        copy.data.attributes.new(SOURCE_FACE, "INT", "FACE")
        # Faces from another object, such as a boolean's cutter, get 0; indices therefore start at 1.
        index = np.arange(1, len(copy.data.polygons) + 1, dtype=np.int32)
        copy.data.attributes[SOURCE_FACE].data.foreach_set("value", index)
        depsgraph = temporary.evaluate(frame)
        with evaluated_mesh(copy.evaluated_get(depsgraph), depsgraph) as mesh:
            attribute = mesh.attributes.get(SOURCE_FACE)
            if attribute is None or attribute.domain != "FACE":
                return np.zeros(0, dtype=np.int32)
            return _read_array(attribute.data, "value", np.int32) - 1
