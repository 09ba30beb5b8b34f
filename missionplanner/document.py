"""A YAML document whose every value knows its line, read as YAML 1.2 reads it (core schema; JSON is a subset).

PyYAML alone reads YAML 1.1: a name ``no`` becomes False, ``12:30`` becomes 750, ``1e3`` stays text, and the second of
two equal keys silently wins. None of that may happen to a mission.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from missionplanner.errors import MissionError

_STRING_TAG = "tag:yaml.org,2002:str"
_CONSTANTS: dict[str, bool | None] = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    "true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False,
}  # fmt: skip
_INTEGER = re.compile(r"[-+]?[0-9]{1,18}")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_MAX_VALUES = 300_000  # aliases counted as often as they are used: a small file must not fill the memory

Location = Sequence[str | int]


@dataclass(frozen=True, slots=True)
class Document:
    """The values of a document, and where they stand in its text."""

    data: Any
    _root: yaml.Node

    def line(self, location: Location) -> int:
        """Return the line (from 1) of the value at ``location``, or of the innermost value around it that exists."""
        node, line = self._root, self._root.start_mark.line
        for step in location:
            child = _child(node, step)
            if child is None:
                break
            line, node = child
        return line + 1


def parse_document(text: str, source: str) -> Document:
    """Read YAML (or JSON); ``source`` names the text in errors.

    Raises
    ------
    MissionError
        Not YAML; empty; a key given twice; values that a mission cannot hold (tags, keys that are not text, cycles).
    """
    try:
        root = yaml.compose(text, Loader=yaml.BaseLoader)
        if root is None:
            raise MissionError(f"{source}: expected a mapping of fields, got an empty file")
        data = _Reader(source).read(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f":{mark.line + 1}" if mark else ""
        column = f" in column {mark.column + 1}" if mark else ""
        reason = ": ".join(part for part in (error.context, error.problem) if part)
        raise MissionError(
            f"{source}{where}: expected YAML, got a syntax error{column}: {_one_line(reason)}"
        ) from error
    except yaml.YAMLError as error:  # characters that no YAML text holds
        raise MissionError(f"{source}: expected a YAML text file, got: {_one_line(str(error))}") from error
    except RecursionError as error:
        raise MissionError(f"{source}: expected fields within fields, got nesting deeper than can be read") from error
    return Document(data, root)


class _Reader:
    """Turns nodes into plain values and refuses what YAML allows and a mission must not hold."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._open: set[int] = set()
        self._values = 0

    def read(self, node: yaml.Node) -> Any:
        self._values += 1
        if self._values > _MAX_VALUES:
            raise self._error(node, f"expected at most {_MAX_VALUES} values, got more (aliases counted each time)")
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node)
        if id(node) in self._open:
            raise self._error(node, "expected values that end, got an alias that contains itself")
        self._open.add(id(node))
        if isinstance(node, yaml.MappingNode):
            value: Any = self._mapping(node)
        else:
            value = [self.read(item) for item in node.value]
        self._open.remove(id(node))
        return value

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        if node.tag != _STRING_TAG:
            raise self._error(node, f"expected a plain value, got the tag {node.tag}: remove it")
        text: str = node.value
        if any("\ud800" <= character <= "\udfff" for character in text):
            text = self._joined(node)
        if node.style is not None:  # quoted or a block: text, whatever it looks like
            return text
        if text in _CONSTANTS:
            return _CONSTANTS[text]
        if _INTEGER.fullmatch(text):
            return int(text)
        if _HEXADECIMAL.fullmatch(text):
            return int(text, 16)
        if _FLOAT.fullmatch(text):
            return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
        return text

    def _joined(self, node: yaml.ScalarNode) -> str:
        """Return text whose characters JSON wrote as pairs of surrogates: YAML leaves these apart."""
        try:
            return str(node.value).encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError as error:
            raise self._error(node, "expected text, got half of a pair of surrogates") from error

    def _mapping(self, node: yaml.MappingNode) -> dict[str, Any]:
        own: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        lines: dict[str, int] = {}
        for key_node, value_node in node.value:
            key = self._scalar(key_node) if isinstance(key_node, yaml.ScalarNode) else None
            line = key_node.start_mark.line + 1
            if not isinstance(key, str):
                shown = key_node.value if isinstance(key_node, yaml.ScalarNode) else "a collection"
                raise self._error(key_node, f"expected the name of a field, got {shown!r}")
            if key in lines:
                raise self._error(
                    key_node, f"expected every field once, got {key!r} again (first in line {lines[key]})"
                )
            lines[key] = line
            value = self.read(value_node)
            if key == "<<":
                merged = self._merge(value_node, value)
            else:
                own[key] = value
        return merged | own

    def _merge(self, node: yaml.Node, value: Any) -> dict[str, Any]:
        parts = value if isinstance(value, list) else [value]
        merged: dict[str, Any] = {}
        for part in reversed(parts):  # the first of several wins
            if not isinstance(part, dict):
                raise self._error(node, "expected '<<' to name a mapping, or a list of mappings")
            merged |= part
        return merged

    def _error(self, node: yaml.Node, message: str) -> MissionError:
        return MissionError(f"{self._source}:{node.start_mark.line + 1}: {message}")


def _child(node: yaml.Node, step: str | int) -> tuple[int, yaml.Node] | None:
    """Return the line of a field's key (or of a list's item) and its value."""
    if isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
        item = node.value[step]
        return item.start_mark.line, item
    if isinstance(node, yaml.MappingNode):
        merges: list[yaml.Node] = []
        for key, value in node.value:
            if key.value == step:
                return key.start_mark.line, value
            if key.value == "<<":
                merges = value.value if isinstance(value, yaml.SequenceNode) else [value]
        for merge in merges:
            found = _child(merge, step)
            if found is not None:
                return found
    return None


def _one_line(text: str) -> str:
    return " ".join(text.split())
