"""Strokes: from words, curves, keyframes or pen samples to an action u(t), motion and force on a surface.

Start with `action.py`, the result; `curves.py` and `motion_profile.py` give a path and its timing, `contacts.py` puts
it on a mesh, `parse_stroke.py` (with `stroke_tokens.py`) and `primitives.py` make ready-made strokes.
"""
