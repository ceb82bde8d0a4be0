"""Appearance of simulated surfaces: color, light and large-scale depth of a height map, to train the network D_φ on.

Start with `instance.py`, which samples an appearance; `albedo.py` and `shading.py` render it. Nothing here affects how
a surface feels.
"""
