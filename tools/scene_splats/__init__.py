"""A Blender scene as 3-D Gaussians whose truth is known: what tools/splats_from_scene.py is made of."""
