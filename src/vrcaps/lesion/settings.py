"""Settings of a lesion kind, declared by the types of its fields: parsed, checked and described."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Literal, get_args, get_origin, get_type_hints

from vrcaps.config.limits import Range, range_of
from vrcaps.core.errors import InputError
from vrcaps.core.units import DEG, MM, parse_length

LENGTH = Range(unit="m")
"""Annotation of a length of any size: ``Annotated[float, LENGTH]``."""


@dataclass(frozen=True)
class Setting:
    """Field of a specification.

    Attributes:
        name: Name of the field.
        words: Allowed named values.
        limits: Limits of a number, a length for the unit "m". None if there are none.
        is_text: Whether it accepts any text.
        is_integer: Whether it accepts integers only.
    """

    name: str
    words: tuple[Any, ...]
    limits: Range | None
    is_text: bool
    is_integer: bool

    @property
    def is_length(self) -> bool:
        """Whether it is a length."""
        return self.limits is not None and self.limits.unit == "m"

    def parse(self, text: str) -> Any:
        """Parse a value from the command line.

        Raises:
            InputError: If the text is not a value of this setting.
        """
        for word in self.words:
            if text == str(word):
                return word
        allowed = [str(word) for word in self.words]
        if self.is_length:
            try:
                return parse_length(text)
            except InputError:
                allowed.append("a length such as 8mm")
        if allowed:
            raise InputError(f"{self.name} is {text!r}. Allowed: {', '.join(allowed)}.")
        if self.is_text:
            return text
        scale, number = (DEG, text.removesuffix("deg")) if text.endswith("deg") else (1.0, text)
        try:
            return int(number) if self.is_integer else scale * float(number)
        except ValueError:
            raise InputError(f"{self.name} is {text!r}. Allowed: a number.") from None

    def check(self, value: Any, kind: str) -> None:
        """Check a value for a lesion kind.

        Raises:
            InputError: If it is not allowed.
        """
        if value is None or value in self.words:
            return
        is_number = isinstance(value, float | int) and self.limits is not None
        if not is_number and not self.words:
            return
        if not is_number or value not in self.limits:  # type: ignore[operator]
            given = f"{value / MM:g} mm" if is_number and self.is_length else repr(value)
            raise InputError(
                f"{kind.capitalize()} {self.name} is {given}. Allowed: {self.allowed}."
            )

    @property
    def allowed(self) -> str:
        """Allowed values in words; empty if any number or text is allowed."""
        parts = [str(word) for word in self.words]
        if self.limits is not None and self.limits != LENGTH:
            scale = MM if self.is_length else 1.0
            low, high = self.limits.min / scale, self.limits.max / scale
            parts.append(f"{low:g} to {high:g}{' mm' if self.is_length else ''}")
        return ", ".join(parts)


@cache
def settings_of(cls: type) -> dict[str, Setting]:
    """Settings of a dataclass by name, except fields that hold another dataclass."""
    hints = get_type_hints(cls, include_extras=True)
    found = {}
    for name in (f.name for f in fields(cls)):
        parts = _parts(hints[name])
        limits = next((r for r in map(range_of, (hints[name], *parts)) if r is not None), None)
        words = [w for part in parts if get_origin(part) is Literal for w in get_args(part)]
        bare = {get_args(p)[0] if hasattr(p, "__metadata__") else p for p in parts}
        if words or bare & {float, int, str}:
            found[name] = Setting(name, tuple(words), limits, str in bare, int in bare)
    return found


def _parts(hint: Any) -> tuple[Any, ...]:
    """Members of a union, or the type itself."""
    is_single = get_origin(hint) is Literal or hasattr(hint, "__metadata__")
    return (hint,) if is_single or not get_args(hint) else get_args(hint)
