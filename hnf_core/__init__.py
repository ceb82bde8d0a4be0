"""Haptic Neural Fields: from 3-D scenes and strokes to vibrotactile acceleration.

Importing this package imports numpy only: no torch, no scipy, and never bpy.
"""

__version__ = "0.1.0"
