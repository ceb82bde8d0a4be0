"""Write a touch for phones and engines, and play it on an actuator; here on the virtual one.

python examples/export_and_stream.py [FOLDER]
"""

import sys
from pathlib import Path

import hnf_core as hnf

folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
touch = hnf.synthesise("knurled-metal", "left-right-hard", seed=0)

for suffix in ("haptic", "ahap", "hjif"):
    written = hnf.export(folder / f"knurled-metal.{suffix}", touch.signal, full_scale=30.0)
    print(f"{written.path.name}: {'; '.join(written.dropped) or 'nothing is lost'}")

print([device.target for device in hnf.list_devices()])
with hnf.open_stream("virtual", gain_db=-6.0) as out:  # or "audio", "serial:/dev/ttyACM0", "osc:HOST:PORT"
    report = out.play(touch.signal)
print(f"played {report.played_s:.2f} s, {report.limited_samples} samples limited")
