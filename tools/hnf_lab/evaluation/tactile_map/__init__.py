"""Evaluate predicted tactile maps as images, as slopes, and by the vibration that follows from them.

`run.py` runs the comparison on held-out tiles, `score.py` holds the metrics, `report.py` tables and plots.
"""
