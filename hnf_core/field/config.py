"""The architecture of F_Θ: its layers and heads, what its states are, and which carriers its emissions drive."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..action.action import ACTION_RATE_HZ
from .carriers import Carriers
from .features import input_size
from .lines import LINE_GAIN_COUNT


@dataclass(frozen=True)
class FieldConfig:
    """Architecture.

    hidden, layers: H and L. states: N. accumulation: "past" = N past states, spacing_s apart, sharing one α head;
    "heads" = N heads of one state (published), whose carriers lag n Δt. emission: "log" = α is an amplitude exp(head);
    "linear" = α is the head (published). physics: add the linear contact to the inputs and, per carrier and weighted
    by a learned skip, to the log-amplitude head. arc_knots: values the α head gives for the arc carriers, spread evenly
    over log κ and read linearly between; 0 = one per carrier. With one each, the few training strokes whose tone falls
    on a carrier decided alone how loud that carrier's tones are (up to 28 dB off on an unseen weave). action_octaves:
    of the positional encoding of u(t), features.encode_action. directed: False for data that never told directions
    apart; the field then ignores d. line_gains: an output for each tone of the token's lattice, see lines; needs
    physics, log emission and arc carriers. stroke_frame: the network sees the token in the frame of the stroke instead
    of token and d, see features.seen_from. Raises ValueError where past states are not a whole number of action
    samples apart, one at least, and no distance of states is more than a second.
    """

    hidden: int = 256
    layers: int = 4
    states: int = 5
    accumulation: Literal["past", "heads"] = "past"
    spacing_s: float = 0.01
    carriers: Carriers = field(default_factory=Carriers)
    emission: Literal["log", "linear"] = "log"
    physics: bool = True
    arc_knots: int = 25
    action_octaves: int = 0
    directed: bool = True
    line_gains: bool = False
    stroke_frame: bool = False

    def __post_init__(self) -> None:
        if self.accumulation != "past":
            if not 0.0 <= self.spacing_s <= 1.0:
                raise ValueError(f"spacing_s must lie between 0 and 1, not {self.spacing_s:g}")
            return
        steps = self.spacing_s * ACTION_RATE_HZ
        if not 0.5 < steps < ACTION_RATE_HZ + 0.5 or abs(steps - round(steps)) > 1e-9 * steps:
            step, given = 1.0 / ACTION_RATE_HZ, self.spacing_s
            raise ValueError(f"spacing_s must lie between 0 and 1, a whole multiple of {step:g} s, not {given:g}")

    @staticmethod
    def published(hidden: int = 1024, layers: int = 4, states: int = 5) -> FieldConfig:
        """The paper's literal model: N heads, one constant carrier."""
        constant = Carriers(time_edges_hz=(), arc_octaves=0, constant=True)
        return FieldConfig(hidden, layers, states, "heads", 0.0, constant, "linear", False, 0)

    @property
    def alpha_heads(self) -> int:
        return self.states if self.accumulation == "heads" else 1

    @property
    def stride(self) -> int:
        """Action samples between neighbouring past states."""
        return round(self.spacing_s * ACTION_RATE_HZ)

    @property
    def alpha_outputs(self) -> int:
        """Values of one α head."""
        spared = self.carriers.arc_count - self.arc_knots if self.arc_knots and self.carriers.arc_count else 0
        return self.carriers.count - spared + (LINE_GAIN_COUNT if self.line_gains else 0)

    def expansion(self) -> NDArray[np.float32] | None:
        """(Ka, arc_knots) linear interpolation from knots to arc carriers, or None where each has its own value."""
        count = self.carriers.arc_count
        if not self.arc_knots or not count:
            return None
        place = np.linspace(0.0, self.arc_knots - 1.0, count)
        return np.maximum(1.0 - np.abs(place[:, None] - np.arange(self.arc_knots)), 0.0).astype(np.float32)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every parameter; weight matrices are (outputs, inputs)."""
        width = input_size(self.carriers, self.physics, self.action_octaves)
        shapes: dict[str, tuple[int, ...]] = {}
        for layer in range(self.layers):
            shapes[f"layer{layer}.weight"] = (self.hidden, width if layer == 0 else self.hidden)
            shapes[f"layer{layer}.bias"] = (self.hidden,)
        outputs = self.alpha_heads * self.alpha_outputs
        shapes["alpha.weight"], shapes["alpha.bias"] = (outputs, self.hidden), (outputs,)
        shapes["sigma.weight"], shapes["sigma.bias"] = (self.states, self.hidden), (self.states,)
        if self.physics:
            shapes["skip"] = (self.carriers.count,)
        return shapes
