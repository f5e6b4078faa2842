"""File references with checksums, so that a recording can be repeated from the same data."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from vrcaps.core.errors import InputError
from vrcaps.core.files import file_sha256

_TEXTURE_HEAD = "mucosa.json"


@dataclass(frozen=True)
class FileRef:
    """A file, or the folder of a texture, by its path and checksum.

    Attributes:
        path: Path relative to the working directory.
        sha256: Checksum of the file, or of a texture's head file; set when recorded, verified when
            given.
    """

    path: str
    sha256: str = ""

    def checked(self) -> FileRef:
        """Return the reference with the current checksum of the file.

        Raises:
            InputError: If the file cannot be read, or does not match the given checksum.
        """
        path = Path(self.path)
        try:
            actual = file_sha256(path / _TEXTURE_HEAD if path.is_dir() else path)
        except OSError as error:
            raise InputError(f"Cannot read {self.path}: {error.strerror}.") from error
        if self.sha256 and actual != self.sha256:
            raise InputError(
                f"{self.path} has sha256 {actual[:12]}…, but the scenario was made with "
                f"{self.sha256[:12]}…. Give the original file, or remove the sha256."
            )
        return replace(self, sha256=actual)


def file_ref(given: FileRef | str | Path) -> FileRef:
    """Convert a path to a reference; references are unchanged."""
    return given if isinstance(given, FileRef) else FileRef(str(given))


def path_of(given: FileRef | str | Path) -> Path:
    """Path of a file that is given as a reference or as a path."""
    return Path(given.path if isinstance(given, FileRef) else given)


def with_checksums(tree: Any) -> Any:
    """Add the checksum to all file references in a tree of dataclasses and tuples.

    Raises:
        InputError: If a file cannot be read or does not match its checksum.
    """
    if isinstance(tree, FileRef):
        return tree.checked()
    if isinstance(tree, tuple):
        items = tuple(with_checksums(item) for item in tree)
        return items if any(a is not b for a, b in zip(items, tree, strict=True)) else tree
    if not is_dataclass(tree) or isinstance(tree, type):
        return tree
    values = {f.name: getattr(tree, f.name) for f in fields(tree)}
    checked = {name: with_checksums(value) for name, value in values.items()}
    changed = {name: value for name, value in checked.items() if value is not values[name]}
    return replace(tree, **changed) if changed else tree
