"""Gaussian-splat files → a surface mesh that can be touched, its splats as a Blender object, and close-ups of both.

Read `reconstruction.py` first.
"""
