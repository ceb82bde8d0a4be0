"""counted(), for the command line's modules that import it from here."""

from ..counted import counted

__all__ = ["counted"]
