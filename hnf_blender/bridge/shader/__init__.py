"""Material node trees → shading values, micro-geometry (bump, displacement, normal maps) and content hashes.

Values that only the renderer can compute are written to AOV passes by nodes added to a copy ("taps"). Read
`closures.py` first.
"""
