"""Exceptions of this project, one family: every message names the problem, its location and the remedy."""

from __future__ import annotations


class HnfError(Exception):
    """A problem that a user can solve; base class of this project's exceptions.

    Parameters
    ----------
    what : str
        The problem, one sentence.
    where : str
        The object, stroke or file concerned.
    remedy : str
        What the user should do next.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what, self.where, self.remedy = what, where, remedy
        head = f"{where}: {what}" if where else what
        super().__init__(f"{head} {remedy}" if remedy else head)


class UsageError(HnfError):
    """Arguments of a command or call do not fit together (exit code 2)."""


class FileError(HnfError):
    """A file is missing, damaged, of the wrong kind, or cannot be written."""


class SceneError(HnfError):
    """The scene, or an object in it, cannot be touched as it is."""


class StrokeError(HnfError):
    """A stroke's curve, keyframes or contact cannot be used."""


class MaterialError(HnfError):
    """A material is unknown, or its description cannot be used."""


class WeightsError(HnfError):
    """Weights of a network are damaged, or belong to another encoder or architecture."""


class DeviceError(HnfError):
    """An actuator, or the way to it, is missing, busy, of another version, or gone."""
