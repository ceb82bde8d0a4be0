"""Five by seven dots: the few characters that the preview's pictures need."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

GLYPH_HEIGHT, GLYPH_ADVANCE = 7, 6

_GLYPH_COLUMNS = {
    "0": "3E5149453E", "1": "00427F4000", "2": "4261514946", "3": "2141454B31", "4": "1814127F10", "5": "2745454539",
    "6": "3C4A494930", "7": "0171090503", "8": "3649494936", "9": "064949291E", ".": "0060600000", "-": "0808080808",
    "+": "08083E0808", "/": "2010080402", "m": "7C04180478", "s": "4854545424", "N": "7F0408107F", "H": "7F0808087F",
    "z": "4464544C44", "k": "007F102844", "d": "384444487F", "B": "7F49494936", "A": "7C1211127C", "²": "00090D0A00",
    "±": "44445F4444", "l": "00417F4000", "i": "00447D4000", "t": "043F444020", "e": "3854545418", "r": "7C08040408",
    "o": "3844444438", "c": "3844444420", "p": "7C14141408", "a": "2054545478", "n": "7C08040478", "g": "0C5252523E",
    "u": "3C4040207C", "f": "087E090102", "h": "7F08040478", "v": "1C2040201C", "w": "3C4030403C", "b": "7F48444438",
    "y": "0C5050503C", "x": "4428102844", "%": "2313086462", " ": "0000000000",
}  # fmt: skip


def rasterise_text(text: str) -> NDArray[np.bool_]:
    """(7, 6 · len) True where there is ink, the top row first. Raises KeyError for a character without a shape."""
    columns = [bytes.fromhex(_GLYPH_COLUMNS[character]) + b"\0" for character in text]
    lines = np.frombuffer(b"".join(columns), np.uint8)
    return np.asarray((lines[None, :] >> np.arange(GLYPH_HEIGHT)[:, None]) & 1, dtype=bool)
