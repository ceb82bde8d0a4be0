"""Readers of texture data sets, and generated data, with one interface: materials, recordings, processes, images.

Start with `recording.py` (what every texture data set becomes) and `registry.py` (opens one by its kind).
`vision_touch.py` is the counterpart for pairs of photograph and touch image.
"""
