"""Contact simulator: from a material class, a seed and a stroke to three axes of acceleration.

Start with `simulate.py`; `material_classes.py` draws materials, `surface_recipe.py` renders their height maps.
`appearance` renders how they look, for training only.
"""
