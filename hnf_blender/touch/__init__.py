"""Strokes and touch queries of a scene → signals, tactile maps and tokens, stored on the scene or written to files.

`hnf touch`, the Touch tab and its worker process share these steps. Read `session.py` first (what has to be computed),
then `synthesise.py` (one stroke from contacts to signal).
"""
