"""Run pytest where bpy hangs at exit: `python tools/pytest_in_bpy.py ARGUMENTS…` = `python -m pytest ARGUMENTS…`.

The Python module of Blender 4.5 hangs in the process's exit where anything still refers to it when the interpreter
ends, as pytest's fixtures and collected modules do: a destructor waits for the sound device's own thread, which was
never signalled to stop. (4.2 may crash in the same place; 5.0 does neither.) All results are written by then, so the
process exits at once.
"""

import os
import sys

import pytest

if __name__ == "__main__":
    code = pytest.main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(int(code))
