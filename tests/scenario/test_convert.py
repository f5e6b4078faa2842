import math
from dataclasses import dataclass, field
from decimal import Decimal
from typing import ClassVar, Literal

import pytest

from vrcaps.config.convert import from_plain, to_plain
from vrcaps.core.errors import InputError


@dataclass(frozen=True)
class Cat:
    lives: int = 9
    kind: ClassVar[str] = "cat"


@dataclass(frozen=True)
class Dog:
    name: str
    kind: ClassVar[str] = "dog"


@dataclass(frozen=True)
class Keeper:
    age: int = 30
    hours: float = 8.0


@dataclass(frozen=True)
class Zoo:
    star: Cat | Dog
    size: float = 1.0
    is_open: bool = True
    mood: Literal["calm", "wild"] = "calm"
    area: float | None = None
    names: tuple[str, ...] = ()
    corner: tuple[int, float] = (0, 0.5)
    cats: tuple[Cat, ...] = field(default_factory=tuple)
    keeper: Keeper = Keeper(age=50)
    guard: Cat | Dog = Dog("Rex")


def test_round_trip():
    zoo = Zoo(Dog("Rex"), 2.5, False, "wild", 3.0, ("a", "b"), (1, 2.0), (Cat(7), Cat()))
    plain = to_plain(zoo, Zoo)
    assert plain["star"] == {"kind": "dog", "name": "Rex"}
    assert plain["cats"] == [{"lives": 7}, {"lives": 9}]
    assert from_plain(Zoo, plain, at="zoo") == zoo


def test_defaults_and_whole_numbers_as_floats():
    zoo = from_plain(Zoo, {"star": {"kind": "cat"}, "size": 3}, at="zoo")
    assert zoo == Zoo(Cat(), 3.0)
    assert isinstance(zoo.size, float)


def test_a_part_of_a_table_leaves_the_rest_as_its_field_has_it():
    star = {"kind": "cat"}
    zoo = from_plain(Zoo, {"star": star, "keeper": {"hours": 6}, "guard": star}, at="zoo")
    assert zoo == Zoo(Cat(), keeper=Keeper(50, 6.0), guard=Cat())
    assert from_plain(Zoo, {"star": star, "guard": {"kind": "dog"}}, at="zoo") == Zoo(Cat())


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"sise": 1}, r"Unknown key zoo\.sise\. Allowed: star, size, is_open"),
        ({"star": {"kind": "cow"}}, r"zoo\.star\.kind is 'cow'\. Allowed: cat, dog\."),
        ({"star": {"kind": ["cat"]}}, r"zoo\.star\.kind is \['cat'\]\. Allowed: cat, dog\."),
        ({"star": {"kind": {"a": 1}}}, r"zoo\.star\.kind is \{'a': 1\}\. Allowed: cat, dog\."),
        ({"star": {"kind": "cat-2"}}, r"is 'cat-2'\. Allowed: cat, dog; parts after a hyphen are"),
        ({"star": {}}, r"zoo\.star\.kind is missing\. Allowed: cat, dog\."),
        ({"star": {"kind": "dog"}}, r"Missing key zoo\.star\.name: a string"),
        ({"star": 3}, r"zoo\.star is 3\. Allowed: a table\."),
        ({"size": "big"}, r"zoo\.size is 'big'\. Allowed: a number"),
        ({"size": True}, r"zoo\.size is True\. Allowed: a number"),
        ({"is_open": 1}, r"zoo\.is_open is 1\. Allowed: true or false"),
        ({"mood": "sad"}, r"zoo\.mood is 'sad'\. Allowed: 'calm', 'wild'"),
        ({"area": []}, r"zoo\.area is \[\]\. Allowed: a number or null"),
        ({"names": "ab"}, r"zoo\.names is 'ab'\. Allowed: a list"),
        ({"names": ["a", 2]}, r"zoo\.names\[1\] is 2\. Allowed: a string"),
        ({"corner": [1, 2, 3]}, r"zoo\.corner has 3 values\. Allowed: 2"),
        ({"corner": [1.5, 2]}, r"zoo\.corner\[0\] is 1\.5\. Allowed: a whole number"),
        ({"cats": [{"lives": None}]}, r"zoo\.cats\[0\]\.lives is None\. Allowed: a whole number"),
    ],
)
def test_errors_name_the_place(change, match):
    with pytest.raises(InputError, match=match):
        from_plain(Zoo, {"star": {"kind": "cat"}, **change}, at="zoo")


@dataclass(frozen=True)
class Cage:
    width: float = field(metadata={"unit": "mm"})
    door: tuple[float, ...] = field(default=(), metadata={"unit": "deg", "key": "angles"})
    depth: float | None = field(default=None, metadata={"unit": "mm"})


def test_units_stand_in_keys_and_convert_exactly():
    cage = Cage(0.0054, (math.radians(85.0), 0.0))
    plain = to_plain(cage, Cage, units=True)
    assert plain == {"width_mm": Decimal("5.4"), "angles_deg": [Decimal(85), Decimal(0)]}
    assert from_plain(Cage, plain, at="cage", units=True) == cage
    assert to_plain(cage, Cage) == {"width": 0.0054, "door": list(cage.door), "depth": None}
    with pytest.raises(InputError, match=r"^mine\.toml: unknown key width\. Allowed: width_mm"):
        from_plain(Cage, {"width": 1}, at="mine.toml:", units=True)
    with pytest.raises(InputError, match=r"^mine\.toml: angles_deg\[1\] is 'a'\. Allowed: a numb"):
        from_plain(Cage, {"width_mm": 1, "angles_deg": [1, "a"]}, at="mine.toml:", units=True)
