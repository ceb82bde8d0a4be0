"""Pictures for the asset browser, drawn without rendering: a material's own relief under a raking light, a stroke's
path coloured by force. (H, W, 4) float32, 0–1 as shown, rows from the bottom.

Few tones on purpose: the pictures are most of the asset files, and what repeats packs well.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hnf_core.action.primitive_path import PlanarPath, make_path_curve
from hnf_core.material.material import LibraryMaterial
from hnf_core.simulation.surface import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map

PreviewImage = NDArray[np.float32]

PREVIEW_PIXELS = 96
TONE_COUNT = 20
DISPLAYED_SLOPES, TRUE_SLOPES = (0.04, 0.5), (2e-4, 0.06)
"""RMS slopes shown for the smoothest and the roughest, between them by the logarithm of the true one: both the grain of
glass and the pile of a carpet have to be seen, and told apart."""
PITCH_M = 2.0 * TILE_SIZE_M / TILE_PIXELS
LIGHT_DIRECTION = np.array([-0.6, 0.55, 0.58])
PRESSED_COLOUR, LIFTED_COLOUR = np.array([0.98, 0.55, 0.16]), np.array([0.25, 0.45, 0.85])
BACKGROUND = np.array([0.14, 0.15, 0.17])
LINE_WIDTH_PX = 2.2


def draw_material_preview(material: LibraryMaterial) -> PreviewImage:
    """A ball would show the colour; a patch of 7.5 mm shows what a finger meets."""
    crop = 2 * PREVIEW_PIXELS
    height = height_map(SurfaceRecipe.from_dict(material.recipe), material.seed)[:crop, :crop].astype(np.float64)
    height = height.reshape(PREVIEW_PIXELS, 2, PREVIEW_PIXELS, 2).mean(axis=(1, 3))
    rows, columns = np.gradient(height, PITCH_M)
    slope = max(float(np.sqrt(np.mean(rows**2 + columns**2))), 1e-9)
    shown = np.interp(np.log10(slope), np.log10(TRUE_SLOPES), DISPLAYED_SLOPES)
    normal = np.stack([-columns, rows, np.full_like(rows, slope / shown)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    light = LIGHT_DIRECTION / np.linalg.norm(LIGHT_DIRECTION)
    look = material.appearance
    diffuse = np.clip(normal @ light, 0.0, None)
    half = light + np.array([0.0, 0.0, 1.0])
    sharpness = 2.0 / max(look.roughness or 0.5, 0.15) ** 2
    glint = np.clip(normal @ half / np.linalg.norm(half), 0.0, None) ** sharpness
    tone = np.round(np.clip(0.18 + 0.85 * diffuse, 0.0, 1.0) * TONE_COUNT) / TONE_COUNT
    shine = np.round(glint * (1.0 - (look.roughness or 0.5)) * 6.0) / 6.0 * 0.6
    colour = np.array(look.base_color or (0.8, 0.8, 0.8))
    tint = colour if (look.metallic or 0.0) > 0.5 else np.ones(3)
    linear = np.clip(tone[..., None] * colour + shine[..., None] * tint, 0.0, 1.0)
    return _add_alpha(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)[::-1])


def draw_stroke_preview(path: PlanarPath) -> PreviewImage:
    """The path as seen from above, light where it presses; a dot where it begins."""
    curve = make_path_curve(path)
    time = np.linspace(0.0, path.duration_s, 600)
    points = curve.point_at(np.clip(path.progress.sample(time)[0], 0.0, 1.0) * curve.length)
    force = np.clip(path.force.sample(time)[0] / max(float(path.force.value.max()), 1e-9), 0.0, 1.0)
    strength = float(path.force.value.max()) / 2.0  # 2 N is the hardest of the eight
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    spread = float(np.abs(points - middle).max())
    at = (points - middle) / spread * 0.38 * PREVIEW_PIXELS + PREVIEW_PIXELS / 2.0
    grid = np.arange(PREVIEW_PIXELS) + 0.5
    far = np.hypot(grid[None, :, None] - at[:, 0], grid[:, None, None] - at[:, 1])
    nearest = far.argmin(axis=-1)
    width = LINE_WIDTH_PX * (0.6 + 0.8 * strength)
    cover = np.clip(width + 0.5 - far.min(axis=-1), 0.0, 1.0)
    begin = np.clip(2.2 * width + 0.5 - far[..., 0], 0.0, 1.0)
    pressed = np.round(force[nearest] * TONE_COUNT)[..., None] / TONE_COUNT
    line = pressed * PRESSED_COLOUR + (1.0 - pressed) * LIFTED_COLOUR
    picture = BACKGROUND + cover[..., None] * (line - BACKGROUND)
    return _add_alpha(picture + begin[..., None] * (1.0 - picture))


def _add_alpha(colour: NDArray[np.float64]) -> PreviewImage:
    return np.concatenate([colour, np.ones((*colour.shape[:2], 1))], axis=-1).astype(np.float32)
