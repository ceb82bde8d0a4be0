"""Tactile maps: heights or images of a patch converted to what a vision-based touch sensor would show.

Start with `tactile_map.py`; `height.py` makes maps from measured relief, `optics.py` models the sensor, and `diffusion`
predicts maps from images.
"""
