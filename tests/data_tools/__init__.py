"""A Blender scene as 3-D Gaussians whose truth is known: what tests/data_tools/splats_from_scene.py is made of."""
