"""From a file of 3-D Gaussian splats to a triangle mesh that can be touched.

Start with `reconstruct.py`, which prunes, renders depth views, fuses them into a TSDF and meshes it. `io_ply.py` reads
the files, `rasterize.py` renders them.
"""
