"""Elements of XML files with their line numbers. Document types are refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from cboxlab.utils.errors import InputError

from ._spectrum_reader import InstrumentText

__all__ = ["XmlElement", "parse_xml"]

#: Depth of nested elements, at most: CxF3 has fewer than ten.
_MAX_DEPTH = 64


@dataclass
class XmlElement:
    """An element, with local names in place of qualified ones."""

    #: Local name of the element.
    name: str
    #: By local name, the attributes.
    attributes: dict[str, str]
    #: Line of its start tag.
    line: int
    #: Elements directly within it.
    children: list[XmlElement] = field(default_factory=list)
    #: Pieces of its text.
    pieces: list[str] = field(default_factory=list)

    @property
    def text(self) -> str:
        """Text directly within the element, without white space around."""
        return "".join(self.pieces).strip()

    def all(self, name: str) -> Iterator[XmlElement]:
        """Elements of a name at any depth, in the order of the file.

        Parameters
        ----------
        name
            Local name.

        Yields
        ------
        XmlElement
            Each element, before those within it.
        """
        for child in self.children:
            if child.name == name:
                yield child
            yield from child.all(name)

    def text_of(self, name: str) -> str:
        """Text of the first element of a name.

        Parameters
        ----------
        name
            Local name.

        Returns
        -------
        str
            The text; empty if there is no such element.
        """
        return next((element.text for element in self.all(name)), "")


def _local(name: str) -> str:
    return name.rpartition(" ")[2]


def parse_xml(source: InstrumentText) -> XmlElement:
    """Root element of a file.

    Parameters
    ----------
    source
        The file.

    Returns
    -------
    XmlElement
        The root, with all elements below it.

    Raises
    ------
    InputError
        For invalid XML, a document type (DOCTYPE), and more than 64 levels.
    """
    parser = expat.ParserCreate("utf-8", " ")
    stack = [XmlElement("", {}, 0)]

    def start(name: str, attributes: dict[str, str]) -> None:
        local = {_local(key): value for key, value in attributes.items()}
        element = XmlElement(_local(name), local, parser.CurrentLineNumber)
        if len(stack) > _MAX_DEPTH:
            hint = "Export the file again."
            raise InputError(
                source.at(element.line), "elements nested too deeply", f"at most {_MAX_DEPTH} levels", hint
            )
        stack[-1].children.append(element)
        stack.append(element)

    def doctype(*_: object) -> None:
        hint = "Remove the DOCTYPE: its entities are not read."
        raise InputError(source.at(parser.CurrentLineNumber), "a document type (DOCTYPE)", "XML without one", hint)

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda name: stack.pop()
    parser.CharacterDataHandler = lambda text: stack[-1].pieces.append(text)
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(source.text.lstrip().encode("utf-8"), True)
    except expat.ExpatError as error:
        hint = "The file is damaged or truncated: export it again."
        where, fault = source.at(error.lineno), f"a fault in the XML, {expat.errors.messages[error.code]}"
        raise InputError(where, fault, "well-formed XML", hint) from None
    return stack[0].children[0]
