"""Actuator: which device the level is shown against, and what its maker or its owner says of it."""

from __future__ import annotations

from typing import Any

import bpy

from hnf_core.actuators.profile import OWN, ActuatorProfile

from ..props.scene import actuator_of
from ..translations import tr
from .layout import TouchPanel, paragraph


def profile_lines(profile: ActuatorProfile) -> tuple[str, ...]:
    """The limits that are known, one a line."""
    lines = []
    if profile.range_hz is not None:
        low, high = profile.range_hz
        lines.append(tr("Range: {low} to {high} Hz").format(low=f"{low:g}", high=f"{high:g}"))
    if profile.peak_m_s2 is not None:
        lines.append(tr("Largest acceleration: {peak} m/s²").format(peak=f"{profile.peak_m_s2:.3g}"))
    else:
        lines.append(tr("Largest acceleration: not stated by its maker"))
    return tuple(lines)


class HNF_PT_actuator(TouchPanel, bpy.types.Panel):  # type: ignore[misc]  # noqa: N801  # bpy has no types
    bl_label = "Actuator"
    bl_order = 5
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012  # Blender reads a set

    def draw(self, context: Any) -> None:
        layout, settings = self.layout, context.scene.hnf
        layout.prop(settings, "actuator", text="")
        if settings.actuator == OWN:
            draw_own(layout, settings)
            return
        profile = actuator_of(context.scene)
        column = layout.column(align=True)
        for line in profile_lines(profile):
            paragraph(column, context, line, icon="DOT")
        paragraph(layout, context, tr("Source: {source}").format(source=profile.source), icon="INFO")


def draw_own(layout: Any, settings: Any) -> None:
    """The artist's own figures, to be entered."""
    column = layout.column(align=True)
    column.prop(settings, "own_peak_m_s2", text="Largest (m/s²)")
    column.prop(settings, "own_lowest_hz", text="Lowest (Hz)")
    column.prop(settings, "own_highest_hz", text="Highest (Hz)")


CLASSES = (HNF_PT_actuator,)
