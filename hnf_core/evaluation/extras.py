"""Tables beside the columns: where the token came from, and spectra by direction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .direction import DirectionSpectra
from .jobs import JobResult
from .report import Cell, ExtraTable, summarise

SENSOR_LABELS = {"gelsight": "GelSight", "digit": "DIGIT"}
UNSUPPORTED_SOURCES = {"predicted map": "not yet: needs D_φ", "bridged": "not yet: needs bridging"}
SENSOR_METRICS = {
    "st_sim_tum": "ST-SIM TUM ↑",
    "st_sim_cosine": "ST-SIM cosine ↑",
    "lsd_log10": "LSD log10 ↓",
    "mse": "MSE ↓",
    "mse_oracle": "MSE / oracle ↓",
    "distance_db": "average spectrum [dB] ↓",
}


def make_sensor_table(results: Sequence[JobResult]) -> ExtraTable:
    """The paper's columns: the shared field with tokens of each sensor. Sources that do not exist yet say so."""
    cells: dict[str, list[Cell]] = {}
    for each in results:
        for sensor, made in each.sensors.items():
            cells.setdefault(sensor, []).extend(made)
    figures = {sensor: summarise(made) for sensor, made in cells.items()}
    rows = [
        (SENSOR_LABELS.get(sensor, sensor), *(f"{found[name]['median']:.3g}" for name in SENSOR_METRICS))
        for sensor, found in figures.items()
    ]
    rows += [(source, why, *["–"] * (len(SENSOR_METRICS) - 1)) for source, why in UNSUPPORTED_SOURCES.items()]
    return ExtraTable(
        "token_source",
        "Token source (shared field, held-out windows)",
        "The paper's columns. Token = E of each sensor's image, by its optics model, of one and the same height map. "
        "Neither sensor is noisy, and E undoes the optics: they can differ only where the gels do.",
        ("token from", *SENSOR_METRICS.values()),
        tuple(rows),
        figures,
    )


def make_direction_table(measured: DirectionSpectra, names: Mapping[str, str]) -> ExtraTable:
    """names: key of a method → words."""
    errors = {key: measured.compute_ratio_error_db(key) for key in measured.methods}
    return ExtraTable(
        "direction",
        f"By direction: {measured.material}",
        f"Eight directions over half a circle, steady; {measured.compute_anisotropy_db():.1f} dB of anisotropy. RMS error of "
        "the level ratio of each direction's spectrum to the first one's.",
        ("method", "ratio error [dB]"),
        tuple((names.get(key, key), f"{value:.2f}") for key, value in errors.items()),
        {"material": measured.material, "anisotropy_db": measured.compute_anisotropy_db(), "ratio_error_db": errors},
    )
