"""Appearance of simulated surfaces: colour, light and macro depth of a height tile, to train D_φ on.

Start with `instance.py`, which samples an appearance; `albedo.py` and `shading.py` render it. Nothing here affects how
a surface feels.
"""
