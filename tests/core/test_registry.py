"""Registries: built-in classes by import path, registered classes, and plug-ins."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import pytest

from tests.support.small_plugin import install, site
from vrcaps.config.convert import from_plain, register_family, to_plain
from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.registry import Registry

__all__ = ["site"]


class Shape:
    kind: ClassVar[str]


@dataclass(frozen=True)
class Disc(Shape):
    """Round."""

    kind: ClassVar[str] = "disc"
    radius: float = 2.0


@dataclass(frozen=True)
class Box(Shape):
    """Four corners.

    More text.
    """

    kind: ClassVar[str] = "box"
    side: float = 1.0


def shapes() -> Registry[Shape]:
    registry: Registry[Shape] = Registry("shape", {"disc": (f"{__name__}:Disc", "a disc")})
    return registry


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, __name__, sys.modules[Disc.__module__])


def test_names_do_not_import_the_classes():
    registry: Registry[Shape] = Registry("shape", {"disc": ("no.such.module:Disc", "a disc")})
    assert list(registry) == ["disc"]
    assert registry.summary("disc") == "a disc"


def test_a_registered_class_is_a_member():
    registry = shapes()
    assert registry.register(Box) is Box
    assert registry.register(Box) is Box
    assert dict(registry) == {"disc": Disc, "box": Box}
    assert registry.summary("box") == "Four corners."


@pytest.mark.parametrize("kind", [None, 3, "", "two words", "../x"])
def test_a_name_must_be_a_word(kind: object):
    cls = type("Odd", (), {"kind": kind})
    with pytest.raises(InputError, match=r"kind of Odd is .* Allowed: letters"):
        shapes().register(cls)


def test_a_name_belongs_to_one_class():
    registry = shapes()
    for kind, owner in (("disc", Disc), ("box", Box)):
        if owner is Box:
            registry.register(Box)
        with pytest.raises(InputError, match=f"shape '{kind}' exists already"):
            registry.register(type("Other", (Shape,), {"kind": kind}))


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(
        UnknownNameError, match=r"No shape named 'disk'\. Known: disc\. Did you mean"
    ):
        shapes()["disk"]


def test_an_unknown_name_loads_plugins(site: Path, monkeypatch: pytest.MonkeyPatch):
    registry = shapes()
    monkeypatch.setattr(sys.modules[__name__], "REGISTRY", registry, raising=False)
    code = f"import sys\nm = sys.modules[{__name__!r}]\nm.REGISTRY.register(m.Box)\n"
    install(site, code)
    assert registry["box"] is Box
    assert "box" in registry
    assert len(registry) == 2


def test_a_broken_plugin_is_left_out_with_a_warning(site: Path):
    install(site, "raise RuntimeError('no license')\n")
    with pytest.warns(UserWarning, match="plug-in 'mine' of the-plugin 1.2 was not loaded: no lic"):
        assert list(shapes()) == ["disc"]


def test_a_family_is_converted_by_kind():
    registry = shapes()

    class Base(Shape):
        pass

    register_family(Base, registry)

    @dataclass(frozen=True)
    class Drawing:
        shape: object = field(default_factory=Disc)

    Drawing.__annotations__["shape"] = Base
    registry.register(Box)
    drawing = from_plain(Drawing, {"shape": {"kind": "box", "side": 3.0}}, at="drawing")
    assert drawing == Drawing(Box(3.0))
    assert to_plain(drawing, Drawing) == {"shape": {"kind": "box", "side": 3.0}}
    with pytest.raises(InputError, match=r"drawing.shape.kind is 'ball'. Allowed: box, disc"):
        from_plain(Drawing, {"shape": {"kind": "ball"}}, at="drawing")
