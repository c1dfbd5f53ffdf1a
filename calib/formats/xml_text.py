"""XML without entities: what a calibration needs of it and nothing a file could abuse."""

from __future__ import annotations

from xml.etree import ElementTree


def parse_xml(text: str) -> ElementTree.Element:
    """The root element.

    Raises:
        ValueError: not XML, or a document type (entities can expand without end).
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("expected XML without a document type, found one")
    try:
        return ElementTree.fromstring(text)
    # A declared encoding the parser does not know gives LookupError; nesting without end RecursionError.
    except (ElementTree.ParseError, LookupError, RecursionError, ValueError) as error:
        raise ValueError(f"expected XML, found {error}") from error
