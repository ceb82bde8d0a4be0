"""`blender --enable-event-simulate --python begin.py -- SCENARIO FOLDER`: play a scenario, write to FOLDER, quit."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from drive.player import play

scenario, folder = sys.argv[sys.argv.index("--") + 1 :]
play(scenario, Path(folder))
