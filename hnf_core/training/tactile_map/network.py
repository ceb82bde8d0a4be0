"""D_φ in torch, for training; hnf_core.tactile.diffusion.network computes the same in numpy."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor, nn
from torch.nn import functional

from ...tactile.diffusion.config import HEADS, INPUT_CHANNELS, MapConfig


class Block(nn.Module):
    """Residual block (He et al. 2016), group norm and SiLU before each convolution; FiLM (Perez et al. 2018)."""

    def __init__(self, size: int, config: MapConfig) -> None:
        super().__init__()
        self.norm1 = nn.GroupNorm(config.groups, size)
        self.conv1 = nn.Conv2d(size, size, 3, padding=1)
        self.norm2 = nn.GroupNorm(config.groups, size)
        self.film = nn.Linear(config.embedding, 2 * size)
        self.conv2 = nn.Conv2d(size, size, 3, padding=1)
        _zero_weights(self.conv2)

    def forward(self, x: Tensor, embedding: Tensor) -> Tensor:
        scale, shift = self.film(embedding)[:, :, None, None].chunk(2, dim=1)
        inner = self.conv1(functional.silu(self.norm1(x)))
        inner = functional.silu(torch.addcmul(shift, self.norm2(inner), 1.0 + scale))
        out: Tensor = x + self.conv2(inner)
        return out


class Attention(nn.Module):
    """Every pixel looks at every other, once, where there are 64 of them."""

    def __init__(self, size: int, config: MapConfig) -> None:
        super().__init__()
        self.norm = nn.GroupNorm(config.groups, size)
        self.into = nn.Conv2d(size, 3 * size, 1)
        self.out = nn.Conv2d(size, size, 1)
        _zero_weights(self.out)

    def forward(self, x: Tensor) -> Tensor:
        batch, size, rows, columns = x.shape
        parts = self.into(self.norm(x)).reshape(batch, 3, HEADS, size // HEADS, rows * columns)
        query, key, value = (part.transpose(-1, -2) for part in parts.unbind(1))
        mixed = functional.scaled_dot_product_attention(query, key, value)
        out: Tensor = x + self.out(mixed.transpose(-1, -2).reshape(batch, size, rows, columns))
        return out


class MapNetwork(nn.Module):
    """(pictures (n, 6, 64, 64), conditions (n, condition_size)) → slopes (n, 2, 64, 64) and level (n,), both of v."""

    def __init__(self, config: MapConfig) -> None:
        super().__init__()
        self.config = config
        wide, middle, deep = config.channels
        emb = config.embedding
        self.embed = nn.ModuleList([nn.Linear(config.condition_size, emb), nn.Linear(emb, emb)])
        self.enter = nn.Conv2d(4 * INPUT_CHANNELS, wide, 3, padding=1)
        self.down = nn.ModuleList(_make_blocks(size, config.down, config) for size in (wide, middle))
        self.up = nn.ModuleList(_make_blocks(size, config.up, config) for size in (wide, middle))
        self.shrink = nn.ModuleList(nn.Conv2d(4 * a, b, 1) for a, b in ((wide, middle), (middle, deep)))
        self.grow = nn.ModuleList(nn.Conv2d(b, a, 1) for a, b in ((wide, middle), (middle, deep)))
        self.deep = _make_blocks(deep, config.deep, config)
        self.attention = Attention(deep, config)
        self.level = nn.ModuleList([nn.Linear(deep + emb, emb), nn.Linear(emb, 1)])
        self.leave_norm = nn.GroupNorm(config.groups, wide)
        self.leave = nn.Conv2d(wide, 8, 3, padding=1)
        _zero_weights(self.leave)
        _zero_weights(self.level[1])

    def forward(self, images: Tensor, conditions: Tensor) -> tuple[Tensor, Tensor]:
        embedding = functional.silu(self.embed[1](functional.silu(self.embed[0](conditions))))
        x = self.enter(functional.pixel_unshuffle(images, 2).contiguous(memory_format=torch.channels_last))
        kept = []
        for level, shrink in enumerate(self.shrink):
            x = _apply_blocks(self._get_level(self.down, level), x, embedding)
            kept.append(x)
            x = shrink(functional.pixel_unshuffle(x, 2).contiguous(memory_format=torch.channels_last))
        x = _apply_blocks(self.deep[:-1], x, embedding)
        x = self.deep[-1](self.attention(x), embedding)
        coarse = self.level[1](functional.silu(self.level[0](torch.cat([x.mean(dim=(2, 3)), embedding], dim=1))))
        for level in reversed(range(len(kept))):
            x = functional.interpolate(self.grow[level](x), scale_factor=2, mode="nearest") + kept[level]
            x = _apply_blocks(self._get_level(self.up, level), x, embedding)
        slopes = functional.pixel_shuffle(self.leave(functional.silu(self.leave_norm(x))), 2)
        return slopes, coarse[:, 0]

    @staticmethod
    def _get_level(levels: nn.ModuleList, index: int) -> Iterable[nn.Module]:
        blocks = levels[index]
        assert isinstance(blocks, nn.ModuleList)
        return blocks


def _apply_blocks(blocks: Iterable[nn.Module], x: Tensor, embedding: Tensor) -> Tensor:
    for block in blocks:
        x = block(x, embedding)
    return x


def _make_blocks(size: int, count: int, config: MapConfig) -> nn.ModuleList:
    return nn.ModuleList(Block(size, config) for _ in range(count))


def _zero_weights(layer: nn.Module) -> None:
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
