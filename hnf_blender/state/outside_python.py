"""What is known of a Python outside Blender, in which a material can be learned."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ExternalPython:
    """path: as the artist named it. version: "3.11.9", "" = it is no Python. found: (package, version) of what it can
    import. missing: packages that it cannot. problem: why it cannot train, one sentence; "" = it can. command: what
    installs the missing, "" = nothing would help."""

    path: str
    version: str
    found: tuple[tuple[str, str], ...]
    missing: tuple[str, ...]
    problem: str
    command: str = ""
