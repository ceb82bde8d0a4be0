"""Train a field on recordings of one's own, save it and render a new stroke with it. Needs torch.

    python examples/own_recordings.py [FOLDER]

The recordings here are made up; yours come from an accelerometer on a pen, with the force and speed of the hand.
"""

import sys
from pathlib import Path

import numpy as np

import hnf_core as hnf

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
rng = np.random.default_rng(0)
RATE_HZ, SECONDS = 10_000, 4.0

recordings = []
for speed in (0.05, 0.1, 0.15):
    action = hnf.Action([0.0, SECONDS], 0.0, speed, 1.0)
    noise = rng.normal(size=round(RATE_HZ * SECONDS))
    acceleration = 20.0 * speed * np.convolve(noise, np.hanning(20), mode="same") / 3.0
    recordings.append(hnf.Recording(acceleration, rate_hz=RATE_HZ, action=action, material="my-material"))

field = hnf.train(recordings, seed=0, epochs=3)  # a few epochs show the way; leave the argument out for a real field
hnf.save_field(folder / "my-material.safetensors", field)

touch = hnf.synthesise(hnf.load_material(folder / "my-material.safetensors"), "left-right-soft", seed=1)
hnf.write_wav(folder / "my-material.wav", touch.signal)
print(f"{touch.signal.duration_s:.2f} s, {touch.signal.rms:.3g} m/s² RMS")
