"""Draw the stroke tool's icon and write it in Blender's triangle format: hnf_blender/tool/data/hnf.stroke.dat.

The icon shows a fingertip on a surface, and a wave that runs along the surface from the contact.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

TARGET = Path(__file__).resolve().parents[1] / "hnf_blender" / "tool" / "data" / "hnf.stroke.dat"
Float = NDArray[np.float64]
Colour = tuple[int, int, int, int]

WHITE: Colour = (229, 229, 229, 255)
SHADE: Colour = (160, 160, 160, 255)
MINT: Colour = (117, 255, 175, 255)
WIDTH, HEIGHT = 255, 255


def make_fan(outline: Float, colour: Colour) -> list[tuple[Float, Colour]]:
    """Triangulate a convex outline (n, 2) as a fan."""
    return [(outline[[0, k, k + 1]], colour) for k in range(1, len(outline) - 1)]


def make_ribbon(path: Float, width: Float, colour: Colour) -> list[tuple[Float, Colour]]:
    """Triangulate a line through path (n, 2) with a width (n,) at each point."""
    along = np.gradient(path, axis=0)
    aside = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    left, right = path + aside * width[:, None] / 2.0, path - aside * width[:, None] / 2.0
    triangles: list[tuple[Float, Colour]] = []
    for k in range(len(path) - 1):
        triangles.append((np.array([left[k], right[k], left[k + 1]]), colour))
        triangles.append((np.array([right[k], right[k + 1], left[k + 1]]), colour))
    return triangles


def draw_finger() -> list[tuple[Float, Colour]]:
    """Draw a rounded bar that leans to the right, with its nail."""
    angle = np.linspace(np.pi, 2.0 * np.pi, 13)
    tip = np.stack([34.0 * np.cos(angle), 34.0 * np.sin(angle)], axis=1)
    outline = np.concatenate([tip, [[34.0, 130.0], [-34.0, 130.0]]])
    nail = np.stack([15.0 * np.cos(angle), -4.0 + 17.0 * np.sin(angle)], axis=1)
    nail = np.concatenate([nail, [[15.0, 22.0], [-15.0, 22.0]]])
    lean = np.radians(-32.0)
    turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])
    position = np.array([92.0, 92.0])
    return make_fan(outline @ turn.T + position, WHITE) + make_fan(nail @ turn.T + position, SHADE)


def draw_wave() -> list[tuple[Float, Colour]]:
    """Draw the line of the surface, with a wave under the finger."""
    x = np.linspace(20.0, 236.0, 73)
    deflection = 15.0 * np.exp(-(((x - 150.0) / 60.0) ** 2)) * np.sin((x - 96.0) / 8.5)
    deflection[x < 96.0] = 0.0
    return make_ribbon(np.stack([x, 46.0 + deflection], axis=1), np.full(len(x), 15.0), MINT)


def encode_triangles(triangles: list[tuple[Float, Colour]]) -> bytes:
    """Encode triangles as Blender's VCO version 0: header, corners as bytes, a colour for each corner."""
    corners = np.concatenate([corner for corner, _ in triangles])
    colours = np.repeat(np.array([colour for _, colour in triangles]), 3, axis=0)
    header = b"VCO\x00" + struct.pack("<BBBB", WIDTH, HEIGHT, 0, 0)
    return header + np.clip(np.round(corners), 0, 255).astype(np.uint8).tobytes() + colours.astype(np.uint8).tobytes()


def main() -> None:
    TARGET.parent.mkdir(exist_ok=True)
    TARGET.write_bytes(encode_triangles(draw_wave() + draw_finger()))
    print(TARGET)


if __name__ == "__main__":
    main()
