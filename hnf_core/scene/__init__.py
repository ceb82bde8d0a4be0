"""Geometry of the touched scene: cameras, triangle meshes, ray casting, square surface patches and rendered views.

Start with `camera.py`, whose axes and units every other file uses; `splats` turns Gaussian splats into a mesh.
"""
