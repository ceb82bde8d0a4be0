"""Cycles renders in temporary scenes: close-ups of patches (squares of a surface), and lit views of the scene.

Read `closeup.py` first.
"""
