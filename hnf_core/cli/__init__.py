"""The `hnf` command line, with one module per command.

A module has `add_parser` and, unless its command needs Blender, `run`. Read `main.py` first (parser and exit codes),
then `commands.py` (the table of commands).
"""
