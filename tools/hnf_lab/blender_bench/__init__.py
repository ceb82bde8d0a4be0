"""Benches of the Blender add-on: waiting times, bakes, views, and cost over scene size.

`waiting_times.py` is a good start; `scenes.py` builds the test scenes. Not part of the Blender extension.
"""
