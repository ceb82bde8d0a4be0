"""Matplotlib figures of strokes, training runs and tactile maps; read `figure.py` first."""
