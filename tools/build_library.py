"""Build hnf_core/data/library.json from tools/library_table.py and print how it feels through the simulator.

Usage: python tools/build_library.py [--check] [NAME …]    --check writes nothing; names restrict the table printed.
Exit code 1 where an entry breaks a MUST.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tools")]

from library_table import TABLE, Entry  # noqa: E402

from hnf_core.files import write_text  # noqa: E402
from hnf_core.material.encoder import describe  # noqa: E402
from hnf_core.material.token import ENCODER_ID  # noqa: E402
from hnf_core.simulation.dft321 import dft321  # noqa: E402
from hnf_core.simulation.sampling import SmoothedMaps  # noqa: E402
from hnf_core.simulation.simulate import SAMPLE_RATE_HZ, simulate_batch, straight_stroke  # noqa: E402
from hnf_core.simulation.surface import TILE_PIXELS, TILE_SIZE_M, SurfaceRecipe, height_map  # noqa: E402
from hnf_core.tactile.height import tactile_map_from_height  # noqa: E402

SCHEMA = 1
CONDITIONS = ((0.1, 1.0), (0.05, 1.0), (0.15, 1.0), (0.1, 0.5), (0.1, 2.0))
"""(m/s, N): the middle, then the ends of the speed and the force exponent."""
ANGLES = (np.radians(8.0), np.radians(98.0))
"""Almost along x and y: exactly along them, a stroke would meet the same line of the tile again and again."""
SETTLE_S = 0.1
LIMITS = {"rms": (0.1, 30.0), "below_1k": (0.5, 1.0), "v_exponent": (0.4, 1.4), "f_exponent": (-0.1, 0.7)}
"""What every entry must keep."""
RECORDED: dict[str, tuple[tuple[float, float], ...]] = {
    "Carbon fibre": ((1.57, 2.00), (241, 301), (1.31, 1.48), (0.15, 0.15)),
    "Carpet": ((2.05, 6.84), (50, 117), (0.02, 1.64), (0.32, 0.85)),
    "Fabric": ((0.24, 3.44), (67, 754), (0.51, 1.55), (-0.11, 0.83)),
    "Foam": ((0.71, 1.47), (73, 319), (0.42, 0.95), (0.15, 0.31)),
    "Metal": ((0.38, 6.24), (234, 695), (0.06, 0.97), (-0.40, 0.62)),
    "Paper": ((0.33, 7.51), (149, 601), (0.29, 1.37), (-0.07, 0.89)),
    "Plastic": ((0.22, 3.30), (137, 771), (0.73, 1.36), (-0.14, 0.57)),
    "Stone": ((1.05, 13.8), (407, 579), (0.50, 1.31), (-0.37, 0.27)),
    "Tile": ((0.69, 4.14), (131, 196), (0.70, 1.36), (0.10, 0.56)),
    "Wood": ((0.49, 1.47), (144, 345), (0.55, 1.49), (0.05, 0.49)),
}
"""RMS [m/s²], centroid [Hz], speed and force exponents of the HaTT recordings, from their published AR models."""


@dataclass(frozen=True)
class Feel:
    """Of one entry at 100 mm/s, 1 N, both directions in power; rms_along, rms_across of each alone."""

    rms: float
    rms_along: float
    rms_across: float
    centroid_hz: float
    below_1k: float
    v_exponent: float
    f_exponent: float

    def broken(self) -> list[str]:
        """The MUSTs that do not hold."""
        values = asdict(self)
        found = [f"{key} {values[key]:.2f}" for key, (low, high) in LIMITS.items() if not low <= values[key] <= high]
        low, high = LIMITS["rms"]
        found += [f"{key} {values[key]:.2f}" for key in ("rms_along", "rms_across") if not low <= values[key] <= high]
        return found

    def outside(self, hatt: str) -> list[str]:
        """What lies outside the recorded range of its category."""
        if hatt not in RECORDED:
            return []
        values = (self.rms, self.centroid_hz, self.v_exponent, self.f_exponent)
        names = ("RMS", "centroid", "v exp", "F exp")
        ranges = RECORDED[hatt]
        return [n for n, v, (low, high) in zip(names, values, ranges, strict=True) if not low <= v <= high]


def seed_of(name: str) -> int:
    return int.from_bytes(blake2b(name.encode(), digest_size=4).digest(), "little")


def recipe_of(entry: Entry) -> SurfaceRecipe:
    """The entry's parts with their weights turned into RMS heights in metres."""
    parts = (*entry.parts.noise, *entry.parts.lattices, *entry.parts.grains)
    return entry.parts.scaled(entry.roughness_um * 1e-6 / float(np.sqrt(sum(part.rms_m**2 for part in parts))))


def feel(entry: Entry, duration_s: float = 2.0) -> Feel:
    """Simulate the entry's ten strokes with the pen."""
    surface = SmoothedMaps(height_map(recipe_of(entry), seed_of(entry.name)), keep=32)
    rows = [(v, f, angle) for v, f in CONDITIONS for angle in ANGLES]
    strokes = [straight_stroke(v, f, duration_s + SETTLE_S, angle_rad=angle) for v, f, angle in rows]
    acceleration = simulate_batch([surface] * len(rows), strokes, [entry.mechanics] * len(rows))
    power, frequency = spectra(acceleration[:, round(SETTLE_S * SAMPLE_RATE_HZ) :])
    rms = np.sqrt(power.sum(axis=1).reshape(len(CONDITIONS), len(ANGLES)))
    both = np.sqrt(np.mean(np.square(rms), axis=1))
    middle = power[: len(ANGLES)].sum(axis=0)
    return Feel(
        rms=float(both[0]),
        rms_along=float(rms[0, 0]),
        rms_across=float(rms[0, 1]),
        centroid_hz=float((middle * frequency).sum() / middle.sum()),
        below_1k=float(middle[frequency < 1000.0].sum() / middle.sum()),
        v_exponent=float(np.log(both[2] / both[1]) / np.log(3.0)),
        f_exponent=float(np.log(both[4] / both[3]) / np.log(4.0)),
    )


def spectra(acceleration: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Power per bin (rows, bins) of the fused signal from 10 Hz on, and the bins' frequencies."""
    fused = dft321(acceleration - acceleration.mean(axis=1, keepdims=True))
    n = fused.shape[1]
    frequency = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE_HZ)
    power = 2.0 * np.square(np.abs(np.fft.rfft(fused, axis=1)) / n)
    return power[:, frequency >= 10.0], frequency[frequency >= 10.0]


def record(entry: Entry) -> dict[str, Any]:
    """What library.json holds of an entry."""
    recipe, seed = recipe_of(entry), seed_of(entry.name)
    pitch = TILE_SIZE_M / TILE_PIXELS
    token = describe(tactile_map_from_height(height_map(recipe, seed), None, pitch, 2.0 * pitch))
    if not token.known.all():
        raise SystemExit(f"{entry.name}: its own tile leaves parts of the token unknown.")
    return {
        "name": entry.name,
        "category": entry.category,
        "words": entry.words.split(),
        "appearance": asdict(entry.appearance),
        "mechanics": asdict(entry.mechanics),
        "recipe": recipe.to_dict(),
        "seed": seed,
        "token": [round(float(value), 5) for value in token.values],
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("names", nargs="*", help="only these entries (implies --check)")
    arguments = parser.parse_args()
    chosen = [entry for entry in TABLE if not arguments.names or entry.name in arguments.names]
    heads = f"{'RMS':>6}{'along':>7}{'across':>7}{'centr.':>7}{'<1k':>6}{'v exp':>7}{'F exp':>7}"
    print(f"{'name':18}{heads}  outside the recorded range")
    failed = 0
    for entry in chosen:
        felt = feel(entry)
        broken, outside = felt.broken(), felt.outside(entry.hatt)
        failed += bool(broken)
        print(
            f"{entry.name:18}{felt.rms:6.2f}{felt.rms_along:7.2f}{felt.rms_across:7.2f}{felt.centroid_hz:7.0f}"
            f"{felt.below_1k:6.2f}{felt.v_exponent:7.2f}{felt.f_exponent:7.2f}  {', '.join(outside)}"
            + (f"  BROKEN: {', '.join(broken)}" if broken else ""),
            flush=True,
        )
    if failed:
        print(f"{failed} entries break a MUST; nothing written.", file=sys.stderr)
        return 1
    if not (arguments.check or arguments.names):
        library = {"schema": SCHEMA, "encoder": ENCODER_ID, "materials": [record(entry) for entry in TABLE]}
        write_text(ROOT / "hnf_core" / "data" / "library.json", json.dumps(library, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
