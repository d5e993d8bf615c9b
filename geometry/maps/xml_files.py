"""XML from anywhere, read without the traps that XML has: entities, bombs, endless files."""

from pathlib import Path
from xml.etree.ElementTree import Element, ParseError

from ..errors import InputError, Unquoted

MAX_FILE_BYTES = 500_000_000


def read_xml(path: Path, *, expected: str) -> Element:
    """Read an XML document as a whole.

    Parameters
    ----------
    path : Path
        A file.
    expected : str
        What it should be, for messages: "OpenDRIVE".

    Returns
    -------
    root : Element
        Of the document.

    Raises
    ------
    InputError
        The file cannot be read, is larger than half a gigabyte, is not well-formed XML, or has
        entities or other parts that this cannot be trusted with.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import parse

    try:
        check_size(path)
        root: Element = parse(path, forbid_dtd=False).getroot()
    except OSError as error:
        raise InputError(str(path), Unquoted(error.strerror or error), "a readable file") from None
    except DefusedXmlException as error:
        raise InputError(
            str(path), Unquoted(f"{type(error).__name__}"), f"{expected} without entities"
        ) from None
    except (ParseError, ValueError, LookupError) as error:  # LookupError: unknown encoding
        raise InputError(str(path), Unquoted(error), f"{expected}: well-formed XML") from None
    return root


def check_size(path: Path, max_bytes: int = MAX_FILE_BYTES) -> None:
    """Refuse a file that is too large to be read as a whole.

    Raises
    ------
    InputError
        It is.
    OSError
        There is no such file.
    """
    n_bytes = path.stat().st_size
    if n_bytes > max_bytes:
        raise InputError(
            str(path), Unquoted(f"{n_bytes:,} bytes"), f"at most {max_bytes:,}; cut it out first"
        )


def local_name(element: Element) -> str:
    """Name of an element without its namespace."""
    return str(element.tag).rpartition("}")[2]


def read_xml_root(path: Path) -> Element:
    """The first element of an XML document, without what it holds.

    Raises
    ------
    InputError
        As :func:`read_xml`, as far as the file is read.
    """
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import iterparse

    try:
        for _, element in iterparse(path, events=("start",), forbid_dtd=False):
            first: Element = element
            return first
    except OSError as error:
        raise InputError(str(path), Unquoted(error.strerror or error), "a readable file") from None
    except DefusedXmlException as error:
        raise InputError(
            str(path), Unquoted(f"{type(error).__name__}"), "XML without entities"
        ) from None
    except (ParseError, ValueError, LookupError) as error:
        raise InputError(str(path), Unquoted(error), "well-formed XML") from None
    raise InputError(str(path), Unquoted("no element"), "well-formed XML")
