"""XML of unknown origin → element tree, with nothing in it expanded.

Any DTD is refused: entities, and with them every expansion and outside reference, can only be declared there, and no
file of the data sets has one. That needs twenty lines on the standard library's expat, so no further package (such as
defusedxml) has to travel into Blender.
"""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from ..errors import FileError

MAX_FILE_BYTES = 256 * 2**20
"""A recording of 10 s at 10 kHz is some 30 MB; more than this is no file of a data set."""
MAX_XML_DEPTH = 64
_XML_REMEDY = "Get the file again from the data set."


class _DtdError(Exception):
    pass


class _DepthError(Exception):
    pass


def read_xml(path: Path) -> Element:
    """Root element of an XML file, namespaces and comments dropped.

    Raises FileError where it cannot be read, is larger than LARGEST_BYTES, is not well-formed, declares a DTD, or nests
    deeper than DEEPEST.
    """
    try:
        size = path.stat().st_size
        if size > MAX_FILE_BYTES:
            raise FileError(f"{size / 2**20:.0f} MB are too much.", where=str(path), remedy=_XML_REMEDY)
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read it ({error.strerror}).", where=str(path), remedy="Check the path.") from error
    return parse_xml(data, str(path))


def parse_xml(data: bytes, where: str) -> Element:
    """As read_xml, from bytes."""
    builder, depth = TreeBuilder(), 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAX_XML_DEPTH:
            raise _DepthError
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def refuse(*_: object) -> NoReturn:
        raise _DtdError

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.StartDoctypeDeclHandler = refuse
    parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
        return builder.close()
    except _DtdError as error:
        line = parser.CurrentLineNumber
        raise FileError(
            f"line {line} declares a DTD, which could hide anything.", where=where, remedy="Remove it from the file."
        ) from error
    except _DepthError as error:
        raise FileError(f"elements nest deeper than {MAX_XML_DEPTH}.", where=where, remedy=_XML_REMEDY) from error
    except (expat.ExpatError, LookupError, ValueError) as error:
        raise FileError(f"not well-formed XML ({error}).", where=where, remedy=_XML_REMEDY) from error
