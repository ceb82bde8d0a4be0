"""Tactile maps: heights or images of a surface patch converted to what a touch sensor (GelSight, DIGIT) would show.

Start with `tactile_map.py`; `height.py` makes maps from measured relief, `optics.py` models the sensor, and
`diffusion.py` predicts maps from images by the network in `unet.py`.
"""
