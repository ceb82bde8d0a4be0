"""Entry point of the command line: one parser for `hnf COMMAND` and `blender -b FILE --command hnf COMMAND`.

Exit codes: 0 done, 1 failed (one clear line on stderr), 2 wrong usage.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Callable, Sequence

from .. import __version__
from ..errors import HnfError, UsageError
from .commands import (
    COMMAND_GROUP,
    COMMAND_HINTS,
    COMMAND_MODULES,
    EXAMPLES,
    HELP,
    LABORATORY_HELP,
    find_plugins,
    import_command,
    make_laboratory_error,
)

Runner = Callable[[argparse.Namespace], int]


def build_parser(
    run_touch: Runner,
    run_export: Runner | None = None,
    only: str | None = None,
    subject: str = "",
    run_views: Runner | None = None,
) -> argparse.ArgumentParser:
    """Build the parser of the command line.

    Parameters
    ----------
    run_touch, run_export, run_views : callable
        Functions that run `hnf touch`, `hnf export` and `hnf views`, which need Blender; this package may not import
        it.
    only : str or None
        The one command whose options are needed, "" for none; the others get only their help. None means all commands.
    subject : str
        Subject of `hnf train`, such as "field"; other packages' subjects are loaded only if it is not one of this
        package.

    Returns
    -------
    argparse.ArgumentParser
        The parser; its result has `run`.
    """
    parser = argparse.ArgumentParser(
        prog="hnf",
        description="Haptic Neural Fields: strokes on 3-D scenes become vibrotactile acceleration.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"hnf {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="COMMAND", required=True)
    runners = {"touch": run_touch, "export": run_export, "views": run_views}
    registered = () if only in COMMAND_MODULES else find_plugins(COMMAND_GROUP)
    for verb in (*COMMAND_MODULES, *registered):
        if only not in (None, verb):
            verbs.add_parser(verb, help=HELP.get(verb) or LABORATORY_HELP.get(verb))
            continue
        module = import_command(verb)
        command_parser = module.add_parser(verbs, subject) if verb == "train" else module.add_parser(verbs)
        run = runners.get(verb) or getattr(module, "run", None)
        if run is not None:
            command_parser.set_defaults(run=run)
    return parser


def main(
    argv: Sequence[str], run_touch: Runner, run_export: Runner | None = None, run_views: Runner | None = None
) -> int:
    """Parse `argv` (without the program's name), run the command, and return the exit code."""
    for out in (sys.stdout, sys.stderr):
        if isinstance(out, io.TextIOWrapper):  # not every encoding of a terminal or file has "²"
            out.reconfigure(errors="backslashreplace")
    try:
        verb, subject = (*(word for word in argv if not word.startswith("-")), "", "")[:2]
        parser = build_parser(run_touch, run_export, verb, subject, run_views)
        if not argv:
            parser.print_help()
            return 2
        # An option as first word is left to argparse, for example --help.
        if (
            argv[0] not in COMMAND_MODULES
            and not argv[0].startswith("-")
            and argv[0] not in find_plugins(COMMAND_GROUP)
        ):
            raise _make_unknown_command_error(argv[0])
        arguments = parser.parse_args(list(argv))
        code = int(arguments.run(arguments))
        print(end="", flush=True)
        return code
    except SystemExit as stop:  # raised by argparse: 0 for --help, 2 for wrong words
        return stop.code if isinstance(stop.code, int) else 2
    except BrokenPipeError:  # the reader has closed the pipe, as in `hnf … | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except UsageError as error:
        print(f"hnf: {error}", file=sys.stderr)
        return 2
    except HnfError as error:
        print(f"hnf: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("hnf: stopped. What was finished before is kept.", file=sys.stderr)
        return 1


def _make_unknown_command_error(word: str) -> UsageError:
    if word in LABORATORY_HELP:
        return make_laboratory_error(word)
    from ..errors import close_matches  # imported only when a correction is needed

    verbs = (*COMMAND_MODULES, *find_plugins(COMMAND_GROUP))
    matches = close_matches(word, verbs)
    guess = f"Did you mean {' or '.join(repr(name) for name in matches)}? " if matches else ""
    return UsageError(
        f"there is no command '{word}'.",
        remedy=COMMAND_HINTS.get(word) or f"{guess}Commands: {', '.join(verbs)}. What each does: hnf --help",
    )
