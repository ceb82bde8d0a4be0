"""Blender on one side, numpy and hnf_core on the other."""
