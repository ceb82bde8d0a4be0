"""Figures of strokes, tactile maps and training runs, drawn with matplotlib without a display.

`figure.py` holds the common style and the panels; `stroke_figure.py` and `tactile_map_figure.py` compose pages from
them.
"""
