"""Material node trees → shading values, micro-geometry (bump, displacement, normal maps) and content hashes.

Values that only the renderer can compute are tapped with AOV outputs. Read `closures.py` first.
"""
