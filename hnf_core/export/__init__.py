"""Conversion of signals [m/s²] to and from other haptic file formats, and figures of strokes.

Read `formats.py` first: its table lists every format with its writer and reader. `convert.py` has the two entry
points, `export_signal` and `import_signal`.
"""
