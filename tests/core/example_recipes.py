"""Recipes of surfaces: noise with and without a direction, a weave, a grating, and pits."""

from __future__ import annotations

from hnf_core.simulation.surface_recipe import Grains, Noise, SurfaceRecipe, grating, plain_weave

EXAMPLE_RECIPES = {
    "rough": SurfaceRecipe(noise=(Noise(6e-6),)),
    "grained": SurfaceRecipe(noise=(Noise(4e-6, stretch=8.0),)),
    "woven": SurfaceRecipe(noise=(Noise(3e-6),), lattices=(plain_weave(12e-6, 0.4e-3),)),
    "grating": SurfaceRecipe(noise=(Noise(1e-6),), lattices=(grating(8e-6, 0.5e-3),)),
    "pitted": SurfaceRecipe(noise=(Noise(3e-6),), grains=(Grains(6e-6, 0.4e-3, sign=-1),)),
}
