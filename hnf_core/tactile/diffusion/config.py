"""The shape of D_φ, a small U-Net, and the scale of what it predicts."""

from __future__ import annotations

from dataclasses import dataclass

from ..views import PITCHES_M
from .conditions import LOG_SNR_FEATURES, SCALAR_COUNT

INPUT_CHANNELS = 6
"""Two noisy slopes, three colours, depth."""
HEADS = 4
DIFFUSION, REGRESSION = "diffusion", "regression"


@dataclass(frozen=True)
class MapConfig:
    """channels: at 32, 16 and 8 pixels (the 64-pixel view enters with 2 × 2 pixels as channels). down, up: residual
    blocks at 32 and at 16 pixels on the way down and on the way up; deep: those at 8, with attention before the last.
    embedding: width of what tells every block the noise level and the conditions. groups: of the group norms.
    sensors: whose membranes it knows. level_mean, level_scale: log10 RMS slope = mean + scale × the network's level.
    objective: "regression" (one pass, no noise: it predicts x), or "diffusion" (it predicts v, and is sampled).
    """

    channels: tuple[int, int, int] = (48, 96, 160)
    down: int = 1
    up: int = 2
    deep: int = 3
    embedding: int = 128
    groups: int = 8
    sensors: tuple[str, ...] = ("gelsight", "digit")
    level_mean: float = -1.0
    level_scale: float = 0.5
    objective: str = DIFFUSION

    @property
    def condition_size(self) -> int:
        """Length of a condition: log-SNR features, noisy level, pitch, sensor, scalars of the look."""
        return LOG_SNR_FEATURES + 1 + len(PITCHES_M) + len(self.sensors) + SCALAR_COUNT

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Every parameter's name and shape; the same in torch and numpy."""
        wide, middle, deep = self.channels
        emb = self.embedding
        out: dict[str, tuple[int, ...]] = {}

        def layer(name: str, *shape: int) -> None:
            out[f"{name}.weight"], out[f"{name}.bias"] = shape, shape[:1]

        def norm(name: str, size: int) -> None:
            out[f"{name}.weight"] = out[f"{name}.bias"] = (size,)

        def block(name: str, size: int) -> None:
            norm(f"{name}.norm1", size)
            layer(f"{name}.conv1", size, size, 3, 3)
            norm(f"{name}.norm2", size)
            layer(f"{name}.film", 2 * size, emb)
            layer(f"{name}.conv2", size, size, 3, 3)

        layer("embed.0", emb, self.condition_size)
        layer("embed.1", emb, emb)
        layer("enter", wide, 4 * INPUT_CHANNELS, 3, 3)
        for level, (size, below) in enumerate(((wide, middle), (middle, deep))):
            for way, count in (("down", self.down), ("up", self.up)):
                for index in range(count):
                    block(f"{way}.{level}.{index}", size)
            layer(f"shrink.{level}", below, 4 * size, 1, 1)
            layer(f"grow.{level}", size, below, 1, 1)
        for index in range(self.deep):
            block(f"deep.{index}", deep)
        norm("attention.norm", deep)
        layer("attention.into", 3 * deep, deep, 1, 1)
        layer("attention.out", deep, deep, 1, 1)
        layer("level.0", emb, deep + emb)
        layer("level.1", 1, emb)
        norm("leave_norm", wide)
        layer("leave", 8, wide, 3, 3)
        return out
