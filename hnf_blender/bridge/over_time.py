"""What moves while a stroke lasts: world matrices and shapes, frame by frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.deforming import DeformingMesh
from hnf_core.errors import SceneError
from hnf_core.scene.mesh import TriangleMesh

from .meshes import compute_surface_frame, evaluated_mesh
from .temporary import TemporaryScene
from .undisturbed import get_parent_chain, preserve_animated_values

Float = NDArray[np.float64]

SIMULATION_MODIFIERS = {"CLOTH", "SOFT_BODY", "FLUID", "DYNAMIC_PAINT", "EXPLODE", "PARTICLE_INSTANCE"}
TIME_DEPENDENT_MODIFIERS = {"WAVE", "OCEAN", "NODES", "MESH_CACHE", "MESH_SEQUENCE_CACHE", "BUILD"}
MIN_MOTION_M = 1e-9


def is_moving(obj: Any) -> bool:
    """Whether an object's world matrix may depend on the frame: keys, drivers, NLA, constraints, or a parent's."""
    return any(_is_animated(member) or _is_constrained(member) for member in get_parent_chain(obj))


def _is_constrained(obj: Any) -> bool:
    return any(not constraint.mute for constraint in obj.constraints) or obj.parent_type not in {"OBJECT", "LATTICE"}


def _is_animated(block: Any) -> bool:
    """Keys, drivers or NLA on anything but the stroke's own properties."""
    animation = getattr(block, "animation_data", None)
    if animation is None:
        return False
    from .. import compat

    paths = [curve.data_path for curve in (*compat.fcurves_of(block), *animation.drivers)]
    return bool(len(animation.nla_tracks)) or any(not path.startswith("hnf_") for path in paths)


def may_deform(obj: Any) -> bool:
    """Whether an object's shape in its own frame may depend on the frame.

    Raises SceneError for simulations, which cannot be evaluated one frame apart from the others.
    """
    blocks = [obj, obj.data, getattr(obj.data, "shape_keys", None)]
    modifiers = [modifier for modifier in obj.modifiers if modifier.show_viewport]
    for modifier in modifiers:
        if modifier.type in SIMULATION_MODIFIERS:
            raise SceneError(
                f"it is simulated (modifier '{modifier.name}').",
                where=f"object '{obj.name}'",
                remedy="Apply the modifier, or export and reimport the motion as a mesh cache.",
            )
        for name in ("object", "target", "texture_coords_object", "auxiliary_target"):
            target = getattr(modifier, name, None)
            if target is not None:
                blocks += [*get_parent_chain(target), target.data]
    if any(modifier.type in TIME_DEPENDENT_MODIFIERS for modifier in modifiers):
        return True
    if obj.parent_type in {"ARMATURE", "LATTICE", "CURVE"} and obj.parent is not None:
        blocks += [obj.parent, obj.parent.data]
    return any(_is_deforming(block, obj) for block in blocks if block is not None)


def _is_deforming(block: Any, obj: Any) -> bool:
    if not _is_animated(block):
        return False
    if block != obj:
        return True
    from .. import compat

    paths = [curve.data_path for curve in (*compat.fcurves_of(block), *block.animation_data.drivers)]
    return bool(len(block.animation_data.nla_tracks)) or any(path.startswith(("modifiers", "pose")) for path in paths)


def sample_world_matrices(scene: Any, objects: tuple[Any, ...], frames: Float) -> Float:
    """World matrices (objects, n, 4, 4) at (fractional) frames (n,), from a temporary scene of these objects alone."""
    matrices = np.empty((len(objects), len(frames), 4, 4))
    with preserve_animated_values(scene, *objects), TemporaryScene() as temporary:
        for obj in dict.fromkeys(objects):
            temporary.link(obj)
        for i, frame in enumerate(frames):
            depsgraph = temporary.evaluate(float(frame))
            for k, obj in enumerate(objects):
                matrices[k, i] = np.array(obj.evaluated_get(depsgraph).matrix_world)
    return matrices


def sample_shapes(
    obj: Any, scene: Any, mesh: TriangleMesh, frames: Float, seconds: Float, metres_per_unit: float
) -> DeformingMesh | None:
    """The surface's vertices in its own frame (m) at frames (F,), whose times are seconds (F,); None where the
    shape stays. mesh: at rest. Raises SceneError where the topology changes."""
    shapes = []
    with preserve_animated_values(scene, obj), TemporaryScene() as temporary:
        temporary.link(obj)
        for frame in frames:
            depsgraph = temporary.evaluate(float(frame))
            evaluated = obj.evaluated_get(depsgraph)
            _, stretch = compute_surface_frame(
                np.array(evaluated.matrix_world), metres_per_unit, f"object '{obj.name}'"
            )
            with evaluated_mesh(evaluated, depsgraph) as shape:
                count = len(shape.vertices)
                if count != len(mesh.vertices):
                    raise SceneError(
                        f"its number of vertices changes over time ({len(mesh.vertices)} now, {count} at frame "
                        f"{frame:g}).",
                        where=f"object '{obj.name}'",
                        remedy="Apply the modifier that adds or removes faces, or touch it while it keeps its shape.",
                    )
                flat = np.empty(count * 3, dtype=np.float32)
                shape.vertices.foreach_get("co", flat)
            shapes.append((flat.reshape(-1, 3).astype(np.float64) @ stretch.T).astype(np.float32))
    vertices = np.stack(shapes)
    spread = np.abs(vertices - mesh.vertices.astype(np.float32)).max(initial=0.0)
    if spread <= MIN_MOTION_M + 1e-6 * float(np.abs(mesh.vertices).max(initial=0.0)):
        return None
    return DeformingMesh(mesh, seconds, vertices)
