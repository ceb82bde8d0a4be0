"""Stroke objects: created on a surface, edited, and read as samples of position, velocity and force over time.

Read `read_stroke.py` first.
"""
