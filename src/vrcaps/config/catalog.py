"""Catalogs: folders of TOML files in the package, with support for a user's own files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.names import listed


@dataclass(frozen=True)
class CatalogFolder:
    """A folder of TOML files; the stem of each file is a name.

    Attributes:
        path: The folder.
        kind: Kind of object that a file describes, for error messages.
    """

    path: Path
    kind: str

    def names(self) -> tuple[str, ...]:
        """Names of the catalog, sorted."""
        return tuple(path.stem for path in listed(self.path, "*.toml"))

    def find(self, name_or_path: str | Path) -> Path:
        """Return the file of a name, or a user's own file by its path.

        Raises:
            UnknownNameError: If the catalog has no such name.
            InputError: If there is no file at the path.
        """
        path = Path(name_or_path)
        if path.suffix == ".toml" or len(path.parts) > 1:
            if not path.is_file():
                known = ", ".join(self.names())
                raise InputError(
                    f"No {self.kind} file at {path}. Give a TOML file, or one of: {known}."
                )
            return path
        if str(name_or_path) not in self.names():
            raise UnknownNameError(self.kind, str(name_or_path), self.names())
        return self.path / f"{name_or_path}.toml"
