"""Write a haptic signal in m/s² to other file formats, read it back, and measure what the conversion lost.

`formats.py` lists all formats with their writers and readers; `convert.py` has the two entry points, `export_signal`
and `import_signal`. Read `formats.py` first. `figure.py` and `stroke_figure.py` draw strokes, tactile maps and training
runs with matplotlib, without a display.
"""
