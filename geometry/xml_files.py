"""Read XML files of users, without entities and other dangerous parts."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from xml.etree.ElementTree import Element, ParseError

from .errors import refuse
from .opening import MAX_FILE_BYTES, open_file, reading


def read_xml(path: Path, *, expected: str) -> Element:
    """Read a whole XML document and return its root.

    `expected` names the format, such as "OpenDRIVE".

    Raises
    ------
    InputError
        The file cannot be read, is larger than half a gigabyte, is not well-
        formed, or has entities or other dangerous parts.
    """
    from defusedxml.ElementTree import parse

    with _open_xml(path, expected, f"{expected}: well-formed XML") as file:
        root: Element = parse(file, forbid_dtd=False).getroot()
    return root


def read_xml_root(path: Path) -> Element:
    """The first element of an XML document, without its content.

    Raises
    ------
    InputError
        As :func:`read_xml`.
    """
    from defusedxml.ElementTree import iterparse

    with _open_xml(path, "XML", "well-formed XML") as file:
        for _, element in iterparse(file, events=("start",), forbid_dtd=False):
            first: Element = element
            return first
    refuse(str(path), "no element", "well-formed XML")


def read_xml_children(path: Path, *, expected: str, root: str) -> Iterator[Element]:
    """Children of the root of an XML document, one after the other.

    Each is forgotten when the next one is asked for. `root` is the name that the
    first element must have.

    Raises
    ------
    InputError
        As :func:`read_xml`, or the first element has another name.
    """
    from defusedxml.ElementTree import iterparse

    with _open_xml(path, expected, f"{expected}: well-formed XML") as file:
        parents: list[Element] = []
        for event, element in iterparse(
            file, events=("start", "end"), forbid_dtd=False
        ):
            if event == "start":
                if not parents and local_name(element) != root:
                    refuse(str(path), f"<{local_name(element)}>", f"<{root}>")
                parents.append(element)
                continue
            parents.pop()
            if len(parents) == 1:
                yield element
                parents[0].clear()


@contextmanager
def _open_xml(path: Path, expected: str, well_formed: str) -> Iterator[BinaryIO]:
    """Open an XML file; what its reader raises becomes an InputError."""
    from defusedxml import DefusedXmlException

    with reading(path, well_formed, ParseError, ValueError, LookupError):
        # Of encodings.
        try:
            with open_file(path, max_bytes=MAX_FILE_BYTES) as file:
                yield file
        except DefusedXmlException as error:
            refuse(str(path), type(error).__name__, f"{expected} without entities")


def local_name(element: Element) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]
