"""Synthesise what a pen feels on two materials, and write it as WAV files (m/s²).

python examples/synthesise.py [FOLDER]
"""

import sys
from pathlib import Path

import hnf_core as hnf

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")

# A stroke in words …
scrape = hnf.parse_stroke("scrape left to right, 1.5 N, 80 mm/s")
for name in ("oak-wood", "corduroy"):
    touch = hnf.synthesise(hnf.material(name), scrape, seed=0)
    hnf.write_wav(folder / f"{name}.wav", touch.signal)
    print(
        f"{name}: {touch.signal.duration_s:.2f} s, {touch.signal.rms:.3g} m/s² RMS, confidence {touch.confidence:.2f}"
    )

# … or an action of one's own: a fingertip that speeds up under constant force.
action = hnf.Action(time_s=[0.0, 1.0], direction_rad=0.0, speed_m_s=[0.02, 0.15], force_n=0.5, probe="finger")
touch = hnf.synthesise("corduroy", action)
hnf.write_wav(folder / "corduroy-finger.wav", touch.signal)
print("\n".join(touch.warnings) or "nothing lies outside the field's training ranges")
