"""Figures of strokes, tactile maps and training runs, drawn with matplotlib without a display.

`figure.py` holds the common style, the panels and the figure of a tactile map; `stroke_figure.py` composes the page of
a stroke from them.
"""
