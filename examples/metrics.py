"""Compare two signals: spectra, distances and similarity scores.

python examples/metrics.py
"""

import numpy as np

import hnf_core as hnf

stroke = hnf.parse_stroke("scrape left to right, 1 N, 100 mm/s")
oak, other_oak, cork = (
    hnf.synthesise(name, stroke, seed=seed).signal for name, seed in (("oak-wood", 0), ("oak-wood", 1), ("cork", 0))
)

frequency, density = hnf.metrics.welch(oak)
print(f"oak peaks at {frequency[np.argmax(density)]:.0f} Hz")
for name, signal in (("oak, another draw", other_oak), ("cork", cork)):
    print(
        f"{name}: average spectra {hnf.metrics.average_spectrum_distance(signal, oak):.2f} dB apart, "
        f"LSD {hnf.metrics.log_spectral_distance(signal, oak):.2f} dB, "
        f"ST-SIM {hnf.metrics.st_sim(signal, oak):.3f}, SPQI {hnf.metrics.spqi(signal, oak):.3f}"
    )
