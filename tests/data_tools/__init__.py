"""Test data made by code: Blender scenes as 3-D Gaussian splats or nerfstudio exports, and bench strokes."""
