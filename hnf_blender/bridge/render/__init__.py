"""Cycles renders in temporary scenes: close-ups of patches, and lit views of the scene.

Read `closeup.py` first.
"""
