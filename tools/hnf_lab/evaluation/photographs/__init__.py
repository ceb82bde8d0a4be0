"""Judge of looks: what the product makes of photographs of recorded textures. Read `measure.py` first."""
