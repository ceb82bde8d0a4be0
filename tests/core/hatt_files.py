"""A HaTT model file as the toolkit writes one: nine vertices over 200 mm/s × 4 N, those on the axes silent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hnf_core.datasets.hatt_models import TextureModel, polynomial_from_lsf, read_texture_model

HATT = Path(__file__).resolve().parents[3] / "shared" / "data" / "hatt"
needs_hatt = pytest.mark.skipif(not HATT.is_dir(), reason="the HaTT sample (shared/data/hatt) is not here")

SPEEDS = [0.0, 100.0, 200.0, 0.0, 100.0, 200.0, 0.0, 100.0, 200.0]
FORCES = [0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 4.0, 4.0, 4.0]
TRIANGLES = [(1, 2, 5), (1, 5, 4), (2, 3, 6), (2, 6, 5), (4, 5, 8), (4, 8, 7), (5, 6, 9), (5, 9, 8)]


def values(numbers) -> str:
    return "".join(f"<value>{number}</value>" for number in numbers)


def lsf_at(vertex: int, order: int) -> np.ndarray:
    even = np.linspace(0.0, np.pi, order + 2)[1:-1]
    return even + 0.4 * np.pi / (order + 1) * np.sin(np.arange(order) * 1.7 + vertex)


def model_xml(order=7, ma_order=0, rate="10000", swap=(), drop=()) -> str:
    """swap: (old, new) texts; drop: tags to leave out."""
    parts = {
        "material": "Test Cloth", "AccelUnits": "m/s^2", "SpeedUnits": "mm/s", "ForceUnits": "N", "SampleRate": rate,
        "mu": "0.25", "htmlPicture": "../../../etc/passwd", "numMod": "9", "numTri": "8", "maxSpeed": "200.0",
        "maxForce": "4.0", "speedList": values(SPEEDS), "forceList": values(FORCES),
    }  # fmt: skip
    lines = [f"<{tag}>{text}</{tag}>" for tag, text in parts.items() if tag not in drop]
    lines += [f'<tri type="array">{values(tri)}</tri>' for tri in TRIANGLES if "tri" not in drop]
    for vertex in range(9):
        lsf, ma = lsf_at(vertex, order), lsf_at(vertex + 3, ma_order)
        own = {
            "modNum": vertex + 1, "ARcoeff": values(polynomial_from_lsf(lsf)), "ARlsf": values(lsf),
            "MAcoeff": values(polynomial_from_lsf(ma)) if ma_order else "", "MAlsf": values(ma) if ma_order else "",
            "var": 0.0 if SPEEDS[vertex] * FORCES[vertex] == 0.0 else 0.01 * (vertex + 1),
            "speedMod": SPEEDS[vertex], "forceMod": FORCES[vertex],
        }  # fmt: skip
        if ma_order:
            own["gain"] = 2.0 + vertex
        lines.append(f"<model>{''.join(f'<{t}>{x}</{t}>' for t, x in own.items() if t not in drop)}</model>")
    text = '<?xml version="1.0" encoding="utf-8"?>\n<modelSet texture="3">\n' + "\n".join(lines) + "\n</modelSet>"
    for old, new in swap:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def read(tmp_path: Path, **changes) -> TextureModel:
    path = tmp_path / "Models_Test Cloth.xml"
    path.write_text(model_xml(**changes), encoding="utf-8")
    return read_texture_model(path)
