"""Everything that reads or writes Blender data: bpy objects on one side, numpy arrays and hnf_core types on the other.

Read `scene/meshes.py` first (objects to triangle meshes), then `stroke/read_stroke.py` (stroke objects to samples).
Close-ups of patches begin in `closeup.py`, splats in `splat_reconstruction.py`.
"""
