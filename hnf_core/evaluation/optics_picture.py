"""Real balls beside what fitted optics make of them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..datasets.ball_calibration import BallPresses, PolynomialTable
from ..export.figure import write_figure
from . import polynomial_optics
from .ball_press import find_contact_radius_px, fit_linear_optics, select_pixels_under
from .optics_check import get_lamps

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Float = NDArray[np.float64]

CELL_PX, HEAD_PX, LEFT_PX, FOOT_PX = 150, 84, 96, 46
MARGIN_PX = 6
"""Of the frame, shown around the contact."""
MAX_SHOWN_CODES = 60.0
RESPONSE_PANEL_PX = (380, 340)
MAX_OFF_AXIS = 0.25
"""Largest part of the normal across a lamp's direction, of the pixels shown along it."""


def plot_presses(path: Path, presses: BallPresses, published: PolynomialTable, press_numbers: Sequence[int]) -> None:
    """Per press, named by number: the frame, ours from twelve numbers fitted to the presses of other parity, the
    published polynomials, and the errors of both. Under the ball only; around it is the real frame.

    Raises FileError where matplotlib is missing or the file cannot be written.
    """
    radius = find_contact_radius_px(presses)
    pixels = select_pixels_under(presses, radius)
    rows = []
    for number in press_numbers:
        ours = fit_linear_optics(pixels.select(pixels.press % 2 != number % 2), "difference")
        own = pixels.select(pixels.press == number)
        places = own.row.astype(int), own.column.astype(int)
        frame = presses.frames[number]
        guesses = []
        for colour in (ours.predict(own), polynomial_optics.predict_polynomial(published, own)):
            guess = frame.copy()
            guess[places] = colour
            guesses.append(guess)
        column, row = presses.centre_px[number]
        reach = radius + MARGIN_PX
        window = (slice(max(0, round(row - reach)), round(row + reach)),
                  slice(max(0, round(column - reach)), round(column + reach)))  # fmt: skip
        rows.append([each[window] for each in (frame, *guesses)])
    heads = ("frame", "ours, 12 numbers", "polynomials, saw it", "error of ours", "of polynomials")
    size = (LEFT_PX + CELL_PX * len(heads) + 90, HEAD_PX + CELL_PX * len(rows) + FOOT_PX)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "A 4 mm ball on a GelSight", fontsize=14, fontweight="bold")
        for line, (number, (frame, ours, theirs)) in enumerate(zip(press_numbers, rows, strict=True)):
            errors = [255.0 * np.abs(each - frame).mean(axis=-1) for each in (ours, theirs)]
            for place, values in enumerate((frame, ours, theirs, *errors)):
                left = (LEFT_PX + CELL_PX * place) / size[0]
                bottom = 1.0 - (HEAD_PX + CELL_PX * (line + 1)) / size[1]
                axes = figure.add_axes((left, bottom, (CELL_PX - 8) / size[0], (CELL_PX - 8) / size[1]))
                axes.set_axis_off()
                drawn = axes.imshow(values, cmap="magma", vmin=0.0, vmax=MAX_SHOWN_CODES, interpolation="nearest")
                if line == 0:
                    axes.set_title(heads[place], fontsize=10.5, loc="left")
            figure.text(0.02, 1.0 - (HEAD_PX + CELL_PX * (line + 0.5)) / size[1], f"press {number + 1}", fontsize=10.5)
        bar = figure.add_axes(((LEFT_PX + CELL_PX * 5 + 6) / size[0], FOOT_PX / size[1], 12 / size[0], 0.5))
        figure.colorbar(drawn, cax=bar, label="codes of 255")

    write_figure(path, size, draw)


def plot_response(path: Path, presses: BallPresses, published: PolynomialTable) -> None:
    """Per channel, how it changes as the ball's surface leans towards the lamp and away from it: median and quartiles
    of every second press, and ours, fitted to the others.

    Raises FileError as presses_picture.
    """
    pixels = select_pixels_under(presses, find_contact_radius_px(presses))
    ours = fit_linear_optics(pixels.select(pixels.press % 2 == 0), "difference")
    judge = pixels.select(pixels.press % 2 == 1)
    seen = 255.0 * (judge.colour - judge.background)
    guesses = {
        "ours, 12 numbers": ("#0072b2", ours.predict(judge)),
        "polynomials, saw them": ("#d55e00", polynomial_optics.predict_polynomial(published, judge)),
    }
    size = (3 * RESPONSE_PANEL_PX[0], RESPONSE_PANEL_PX[1] + 66)

    def draw(figure: Figure) -> None:
        figure.text(0.02, 1.0 - 26 / size[1], "Colour of a real GelSight under a ball", fontsize=14, fontweight="bold")
        for channel, (name, lamp) in enumerate(zip(("red", "green", "blue"), get_lamps(ours.sensor), strict=True)):
            axes = figure.add_axes(((70 + channel * RESPONSE_PANEL_PX[0]) / size[0], 92 / size[1],
                                    (RESPONSE_PANEL_PX[0] - 90) / size[0], (RESPONSE_PANEL_PX[1] - 100) / size[1]))  # fmt: skip
            towards = np.array([np.cos(np.radians(lamp[0])), np.sin(np.radians(lamp[0]))])
            along = judge.normal[:, :2] @ towards
            near = np.abs(judge.normal[:, :2] @ [-towards[1], towards[0]]) < MAX_OFF_AXIS
            edges = np.linspace(-0.8, 0.8, 17)
            steps = [(0.5 * (a + b), near & (along >= a) & (along < b)) for a, b in pairwise(edges)]
            bins = [each for _, each in steps if each.any()]
            at = np.degrees(np.arcsin([middle for middle, each in steps if each.any()]))
            low, middle, high = np.transpose([np.percentile(seen[each, channel], [25, 50, 75]) for each in bins])
            axes.fill_between(at, low, high, color="#1c2430", alpha=0.15, lw=0)
            axes.plot(
                at,
                middle,
                color="#1c2430",
                lw=2.6,
                label=f"{len(np.unique(judge.press))} real presses: median, quartiles",
            )
            for label, (colour, guess) in guesses.items():
                change = 255.0 * (guess - judge.background)[:, channel]
                axes.plot(at, [np.median(change[each]) for each in bins], color=colour, lw=1.6, label=label)
            axes.set_title(f"{name}, lit from {lamp[0]:.0f}°", fontsize=10.5, loc="left")
            axes.set_xlabel("tilt towards the lamp [°]")
            if channel == 0:
                axes.set_ylabel("frame − background [codes]")
        figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncol=3, frameon=False, fontsize=9.5)

    write_figure(path, size, draw)
