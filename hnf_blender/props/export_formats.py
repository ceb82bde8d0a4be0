"""Formats that strokes leave in, as artists choose them; what they do stands in hnf_core.export.formats."""

from __future__ import annotations

from typing import NamedTuple


class FormatChoice(NamedTuple):
    """word: in hnf_core.export.formats.FORMATS. scaled: its numbers are shares of the actuator's full scale. stem: what
    is added to the name of its files, where another format has the same suffix."""

    format_name: str
    label: str
    description: str
    scaled: bool = True
    stem: str = ""


FORMAT_CHOICES = (
    FormatChoice("wav", "WAV in m/s²", "10 kHz, 32-bit float, never normalised: nothing is lost", scaled=False),
    FormatChoice("wav8k", "WAV 8 kHz", "16 bit, for an actuator; 1 is the actuator's largest acceleration", stem="-8k"),
    FormatChoice("wav48k", "WAV 48 kHz", "16 bit, for a sound card and an amplifier; 1 is the largest acceleration",
                 stem="-48k"),
    FormatChoice("listen", "WAV to Listen to", "48 kHz, 16 bit, as loud as it goes without clipping: for ears, not for "
                 "an actuator", scaled=False, stem="-listen"),
    FormatChoice("haptic", ".haptic (Meta)", "Strength and frequency over time, for Meta Haptics; no waveform"),
    FormatChoice("ahap", ".ahap (Apple)", "Strength and sharpness over time, for iPhones; no waveform"),
    FormatChoice("android", "Android Waveform", "Strength over time, for VibrationEffect.createWaveform; no waveform",
                 stem="-android"),
    FormatChoice("hjif", ".hjif (MPEG)", "The vibration along the stroke and the vertices that it lies on; their mesh "
                 "is written beside it, as GLB"),
    FormatChoice("glb", "GLB (glTF)", "The touched mesh with what is baked on it (MPEG_haptic_material) and the signal",
                 scaled=False),
    FormatChoice("csv", "CSV", "A table of time and acceleration in m/s²", scaled=False),
    FormatChoice("npz", "NPZ", "numpy arrays, in m/s²", scaled=False),
)  # fmt: skip
CHOICE_BY_NAME = {choice.format_name: choice for choice in FORMAT_CHOICES}
FORMAT_ITEMS = [(choice.format_name, choice.label, choice.description) for choice in FORMAT_CHOICES]
