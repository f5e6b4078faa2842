"""YAML front matter of Markdown cards, as the Hugging Face Hub reads it.

The keys are those of https://huggingface.co/docs/hub/model-cards and
https://huggingface.co/docs/hub/datasets-cards.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

_PLAIN = re.compile(r"[A-Za-z][\w./<-]*")
_RESERVED = {"true", "false", "yes", "no", "on", "off", "y", "n", "null"}
"""Words that YAML 1.1 reads as a boolean or as null, in lower case."""
_SIZES = (
    *((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M")),
    *((10**7, "1M<n<10M"), (10**8, "10M<n<100M"), (10**9, "100M<n<1B"), (10**10, "1B<n<10B")),
)
_MAX_SIZE = "10B<n<100B"


def front_matter(values: Mapping[str, Any]) -> str:
    """Return values as a YAML block with its delimiters; keys with empty values are left out.

    Args:
        values: Strings, numbers, booleans, and mappings and sequences of them.

    Example:
        >>> print(front_matter({"license": "mit", "tags": ["a", "1"], "datasets": []}), end="")
        ---
        license: mit
        tags:
        - a
        - "1"
        ---
    """
    return "\n".join(["---", *_lines(values), "---", ""])


def size_category(frames: int) -> str:
    """Size category of the Hub for a number of frames."""
    return next((name for limit, name in _SIZES if frames < limit), _MAX_SIZE)


def _lines(values: Mapping[str, Any]) -> Iterator[str]:
    for key, value in values.items():
        if isinstance(value, Mapping) and value:
            yield f"{key}:"
            yield from (f"  {line}" for line in _lines(value))
        elif _is_list(value) and value:
            yield f"{key}:"
            yield from (line for item in value for line in _item(item))
        elif not (_is_list(value) or value in ("", None) or isinstance(value, Mapping)):
            yield f"{key}: {_scalar(value)}"


def _item(value: Any) -> Iterator[str]:
    """Lines of an item of a list."""
    lines = list(_lines(value)) if isinstance(value, Mapping) else [_scalar(value)]
    yield f"- {lines[0]}"
    yield from (f"  {line}" for line in lines[1:])


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _scalar(value: object) -> str:
    if isinstance(value, float):
        text = repr(value)  # YAML 1.1 reads 1e-05 as text, 1.0e-05 as a number
        return text if "." in text else text.replace("e", ".0e")
    if isinstance(value, str) and _PLAIN.fullmatch(value) and value.lower() not in _RESERVED:
        return value
    return json.dumps(value, ensure_ascii=False)
