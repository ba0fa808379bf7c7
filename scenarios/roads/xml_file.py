"""XML files of roads and tracks.

A document type is what lets an XML file define entities that grow without bound, or name other files and addresses. No
file of roads or tracks needs one, so it is refused.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from xml.parsers import expat

from vehicle.foundation.user_file import MAX_ELEMENTS, MAX_NESTING, FileKind, read_bytes, shown

_TEXT: Final = 10_000  # characters of an element's text that are kept


@dataclass(slots=True)
class Element:
    """An element; names are without the prefix of their namespace."""

    name: str
    attributes: dict[str, str]
    line: int  # in the file
    children: list[Element] = field(default_factory=list)
    text: str = ""

    def all(self, name: str) -> list[Element]:
        """Its children of this name."""
        return [child for child in self.children if child.name == name]

    def first(self, name: str) -> Element | None:
        """Its first child of this name; None if there is none."""
        return next((child for child in self.children if child.name == name), None)


def read_xml(path: Path, root: str) -> Element:
    """The root element of an XML file, which must have this name.

    Raises:
        ValueError: one line naming file and line, if the file cannot be read, is not XML, has a document type, too many
            elements or elements nested too deep, or another root.
    """
    content = read_bytes(path, FileKind.ROAD)
    builder = _Builder(path)
    try:
        builder.parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.errors.messages.get(error.code) or str(error)
        raise ValueError(f"{path}: not XML: line {error.lineno}: {shown(reason)}") from None
    except (LookupError, UnicodeError) as error:  # an encoding that Python does not know
        raise ValueError(f"{path}: not XML: {shown(str(error))}; save it as UTF-8") from None
    found = builder.top.children[0]
    if found.name != root:
        raise ValueError(f"{path}: its outermost element is <{shown(found.name, 40)}>: must be <{root}>")
    return found


class _Builder:
    """Builds the tree while expat parses."""

    def __init__(self, path: Path) -> None:
        self.top = Element("", {}, 0)
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._data
        self._path, self._count, self._stack = path, 0, [self.top]

    def _doctype(self, *_: object) -> None:
        raise ValueError(f"{self._path}: line {self.parser.CurrentLineNumber}: a document type (<!DOCTYPE) is refused")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise ValueError(f"{self._path}: has more than {MAX_ELEMENTS} elements")
        if len(self._stack) > MAX_NESTING:
            line = self.parser.CurrentLineNumber
            raise ValueError(f"{self._path}: line {line}: elements must be nested at most {MAX_NESTING} deep")
        element = Element(name.rpartition(":")[2], attributes, self.parser.CurrentLineNumber)
        self._stack[-1].children.append(element)
        self._stack.append(element)

    def _end(self, _: str) -> None:
        self._stack.pop()

    def _data(self, text: str) -> None:
        element = self._stack[-1]
        if len(element.text) < _TEXT:
            element.text += text[:_TEXT]
