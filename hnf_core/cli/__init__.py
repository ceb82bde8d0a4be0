"""The `hnf` command line: `main.py` builds the parser and runs a command; each command has its own module."""
