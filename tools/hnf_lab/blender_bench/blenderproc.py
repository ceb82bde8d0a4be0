"""RGB-D views rendered as BlenderProc 2 does: Cycles with its settings, in one animation over the cameras.

The settings follow its RendererUtility and DefaultConfig: persistent data, adaptive sampling at 0.01, few bounces,
colour through a Denoise node with albedo and normal, depth through a file output node. Its files are read in turn, as
it does. The format is OPEN_EXR, which it offers besides its default PNG, so that errors are not those of 8 bits.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hnf_blender.bridge.cycles import set_camera
from hnf_blender.bridge.scene.temp_scene import suppress_output
from hnf_core.scene.camera import Camera
from hnf_core.scene.rgbd_view import read_exr

Float32 = NDArray[np.float32]

NOISE_THRESHOLD = 0.01
BOUNCES = {
    "max_bounces": 3,
    "diffuse_bounces": 3,
    "glossy_bounces": 0,
    "transmission_bounces": 0,
    "volume_bounces": 0,
    "transparent_max_bounces": 8,
    "caustics_reflective": True,
    "caustics_refractive": True,
}


def limit_bounces(scene: Any) -> None:
    """Set BlenderProc's default light transport, used for every method so that all render the same image."""
    for name, value in BOUNCES.items():
        setattr(scene.cycles, name, value)


def render_as_blenderproc(
    scene: Any, cameras: Sequence[Camera], samples: int, denoise: bool = True
) -> list[tuple[Float32, Float32]]:
    """Return (H, W, 3) linear colour and (H, W) planar depth (1e10 = none) of each camera.

    It changes the scene itself, as BlenderProc does, so the scene must be disposable.

    Parameters
    ----------
    scene
        Scene in metres.
    cameras
        Cameras in world metres, all of one size.
    samples
        Samples per pixel.
    denoise
        Use the Denoise node.
    """
    import bpy

    _set_up_cycles(scene, samples)
    _key_cameras(scene, cameras)
    with tempfile.TemporaryDirectory(prefix="hnf-") as folder:
        _set_up_compositor(scene, folder, denoise)
        scene.render.filepath = str(Path(folder) / "rgb_")
        with suppress_output():
            bpy.ops.render.render(animation=True, write_still=True, scene=scene.name)
        return [
            (_read_single_pass(Path(folder) / f"rgb_{frame:04d}.exr")[..., :3], _read_depth(Path(folder), frame))
            for frame in range(len(cameras))
        ]


def _set_up_cycles(scene: Any, samples: int) -> None:
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_percentage = 100
    cycles.debug_bvh_type, cycles.debug_use_spatial_splits = "STATIC_BVH", True
    render.use_persistent_data = True
    cycles.use_denoising, cycles.samples = False, samples
    cycles.use_adaptive_sampling, cycles.adaptive_threshold = True, NOISE_THRESHOLD
    limit_bounces(scene)


def _key_cameras(scene: Any, cameras: Sequence[Camera]) -> None:
    """Insert one keyframe per camera, from frame 0."""
    import bpy

    camera_object = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera_object)
    scene.camera = camera_object
    camera_object.rotation_mode = "QUATERNION"
    for frame, camera in enumerate(cameras):
        set_camera(scene, camera_object, camera, np.eye(4), 1.0)
        camera_object.location, camera_object.rotation_quaternion, _ = camera_object.matrix_world.decompose()
        camera_object.keyframe_insert("location", frame=frame)
        camera_object.keyframe_insert("rotation_quaternion", frame=frame)
    scene.frame_start, scene.frame_end = 0, len(cameras) - 1


def _set_up_compositor(scene: Any, folder: str, denoise: bool) -> None:
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_diffuse_color = True
    tree, composite = new_compositor(scene)
    scene.render.use_compositing = True
    layers = tree.nodes.new("CompositorNodeRLayers")
    layers.scene = scene
    image = layers.outputs["Image"]
    if denoise:
        node = tree.nodes.new("CompositorNodeDenoise")
        tree.links.new(image, node.inputs["Image"])
        albedo = layers.outputs.get("Diffuse Color") or layers.outputs["DiffCol"]
        tree.links.new(albedo, node.inputs["Albedo"])
        tree.links.new(layers.outputs["Normal"], node.inputs["Normal"])
        image = node.outputs["Image"]
    tree.links.new(image, composite)
    write_exr_from(tree, layers.outputs["Depth"], folder, "depth_")
    use_exr(scene.render.image_settings)


def _read_depth(folder: Path, frame: int) -> Float32:
    depth = _read_single_pass(next(folder.glob(f"depth_*{frame:04d}.exr")))
    return depth if depth.ndim == 2 else depth[..., 0]  # Blender up to 4.5 writes depth as colour


def _read_single_pass(path: Path) -> Float32:
    """Read the only pass of a file."""
    return next(iter(read_exr(path).values()))


def new_compositor(scene: Any) -> tuple[Any, Any]:
    """Create an empty compositor tree for a scene; return the tree and the input socket for its image."""
    if hasattr(scene, "compositing_node_group"):  # 5.0: a node group like any other
        import bpy

        tree = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        return tree, tree.nodes.new("NodeGroupOutput").inputs[0]
    scene.use_nodes = True
    tree = scene.node_tree
    tree.nodes.clear()
    return tree, tree.nodes.new("CompositorNodeComposite").inputs["Image"]


def write_exr_from(tree: Any, socket: Any, folder: str, stem: str) -> None:
    """Add a compositor node that writes a socket as float32 EXR to the file folder/STEM*FRAME.exr."""
    node = tree.nodes.new("CompositorNodeOutputFile")
    use_exr(node.format)
    if hasattr(node, "file_output_items"):  # 5.0
        node.directory, node.file_name = folder, stem
        node.file_output_items.new("FLOAT", "value")
    else:
        node.base_path = folder
        node.file_slots[0].path = stem
    tree.links.new(socket, node.inputs[0])


def use_exr(settings: Any) -> None:
    """Set image settings to a plain float32 EXR."""
    if hasattr(settings, "media_type"):
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGB"
