"""Strokes and touch queries of a scene → signals, tactile maps and tokens, stored on the scene or written to files.

A touch query asks what one place feels like; a token describes a material's micro-geometry. `hnf touch`, the Touch tab
and its worker process share these steps. Read `session.py` first (what has to be computed), then `synthesise.py` (one
stroke from contacts to signal).
"""
