"""Settings of a scenario: all paths of `--set`, and changes to plain scenarios by path."""

from __future__ import annotations

import re
import tomllib
import types
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from vrcaps.config.convert import classes_by_kind
from vrcaps.config.plain_files import require_bounded
from vrcaps.core.errors import InputError
from vrcaps.core.fields import Range, range_of
from vrcaps.scenario.scenario import Scenario

_TYPE_NAMES = {bool: "true or false", int: "int", float: "float", str: "text"}
_DOCUMENTED = re.compile(r"^        (\w+): (.*(?:\n            .*)*)", re.MULTILINE)


@dataclass(frozen=True)
class Setting:
    """One value of a scenario.

    Attributes:
        path: Names from the scenario down, such as `motion.speed`.
        kind: Kind of the table that it belongs to, if there are several, such as `dynamics`.
        declared: Its type.
        default: Its default value; `MISSING` if it is required.
        doc: Its description, with its unit.
    """

    path: str
    kind: str
    declared: Any
    default: Any
    doc: str

    @property
    def type_name(self) -> str:
        """Its type in words, with its limits."""
        return type_name(self.declared)

    @property
    def default_text(self) -> str:
        """Its default value in words."""
        if self.default is MISSING:
            return "required"
        if isinstance(self.default, tuple):
            return " ".join(map(str, self.default)) or "none"
        words = {"None": "none", "True": "true", "False": "false"}
        return words.get(str(self.default), str(self.default))


def settings(
    cls: type = Scenario, path: str = "", kind: str = "", whole: Any = None
) -> Iterator[Setting]:
    """Settings of a scenario in the order of its tables, including every kind of table.

    Args:
        cls: The table to start from.
        path: Path of the table.
        kind: Kind of the table that contains it.
        whole: Default value of the table, if it differs from that of its class.
    """
    hints, docs = get_type_hints(cls, include_extras=True), field_docs(cls)
    for f in fields(cls):
        where = f"{path}.{f.name}" if path else f.name
        default = f.default_factory() if f.default_factory is not MISSING else f.default
        default = getattr(whole, f.name, default)
        value = getattr(default, "kind", "as below") if is_dataclass(default) else default
        yield Setting(where, kind, hints[f.name], value, docs.get(f.name, ""))
        for table in _tables(hints[f.name]):
            inner = default if isinstance(default, table) else None
            yield from settings(table, where, getattr(table, "kind", kind), inner)


def field_docs(cls: type) -> dict[str, str]:
    """Description of each field in the docstrings of a class and its bases, on one line each."""
    docs = [base.__doc__ or "" for base in reversed(cls.__mro__)]
    matches = [match for doc in docs for match in _DOCUMENTED.findall(doc)]
    return {name: " ".join(text.split()) for name, text in matches}


def type_name(declared: Any) -> str:
    """Name of a type, such as ``float above 0`` or ``inflated, normal, collapsed or none``."""
    range_ = range_of(declared)
    if get_origin(declared) is Annotated:
        declared = get_args(declared)[0]
    is_union = get_origin(declared) in (Union, types.UnionType)
    members = get_args(declared) if is_union else (declared,)
    kinds = () if is_union else classes_by_kind(declared)
    words = [kind for kind in kinds if kind] or [word for word in map(_word, members) if word]
    text = " or ".join(dict.fromkeys(words))
    return f"{text} ({range_})" if isinstance(range_, Range) else text


def parse_change(text: str) -> tuple[str, Any]:
    """Parse a change such as ``motion.speed=0.01`` to its path and value, TOML or plain text.

    Raises:
        InputError: If there is no path or no value.
    """
    path, equals, value = text.partition("=")
    if not (equals and path and value):
        raise InputError(f"--set is {text!r}. Allowed: PATH=VALUE, such as motion.speed=0.01.")
    try:
        plain = tomllib.loads(f"value = {value}")["value"]
        require_bounded(plain)
    except tomllib.TOMLDecodeError:
        return path.strip(), value
    except (ValueError, RecursionError) as error:
        raise InputError(f"--set {path.strip()}: the value is not usable: {error}.") from error
    return path.strip(), plain


def changed(plain: Mapping[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return a plain scenario with one value changed.

    If the kind of a table changes, the values of the former kind are dropped.
    """
    name, _, rest = path.partition(".")
    if not rest:
        is_other = name == "kind" and plain.get("kind", value) != value
        return {"kind": value} if is_other else {**plain, name: value}
    inner = plain.get(name)
    inner = inner if isinstance(inner, Mapping) else {}
    return {**plain, name: changed(inner, rest, value)}


def _tables(declared: Any) -> list[type]:
    """Dataclasses that a value of this type may hold and that paths may lead into."""
    if get_origin(declared) is Annotated:
        declared = get_args(declared)[0]
    classes = classes_by_kind(declared).values()
    return [cls for cls in classes if cls.__module__ not in _NO_SETTINGS]


_NO_SETTINGS = {"vrcaps.capsule.device", "vrcaps.core.fields"}
"""Modules whose tables are stored in separate files or as a path."""


def _word(member: Any) -> str:
    if member is types.NoneType:
        return "none"
    if get_origin(member) is Literal:
        return ", ".join(map(str, get_args(member)))
    if get_origin(member) is tuple:
        items = get_args(member)
        return f"list of {type_name(items[0])}"
    if isinstance(member, type) and is_dataclass(member):
        return getattr(member, "kind", "" if member.__name__ == "FileRef" else "table")
    return _TYPE_NAMES.get(member, getattr(member, "__name__", str(member)))
