"""Measure time, memory and error of each method, and faults of streams; run by `hnf bench`.

`harness.py` holds rows, timing and the text table; the other modules are one bench each. Not part of the Blender
extension.
"""
