"""From a file of 3-D Gaussian splats to a triangle mesh that can be touched.

Start with `reconstruct.py`, which prunes, renders depth views, fuses them into a TSDF and meshes it. `splat_file.py`
reads files of every layout, `rasterize.py` renders them.
"""
