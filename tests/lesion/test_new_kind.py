"""The kind of lesion that docs/how-to/extending.md adds, run as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_plugin import install, site
from vrcaps.core.errors import InputError
from vrcaps.core.units import MM
from vrcaps.lesion import LESIONS, parse_lesion
from vrcaps.lesion.library import describe_kind
from vrcaps.mesh.mesh import Mesh, face_areas
from vrcaps.scenario.scenario import read_lesions

__all__ = ["site"]

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extending.md"


@pytest.fixture
def run(tube, monkeypatch):
    """Names that the section defines, given an organ."""
    text = PAGE.read_text(encoding="utf-8")
    section = re.search(r"^## A lesion\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert section is not None
    monkeypatch.setattr(LESIONS, "_added", {})
    names = {"organ": tube, "__name__": __name__}
    for code in re.findall(r"```python\n(.*?)```", section[1], re.DOTALL):
        exec(code, names)
    return names


@pytest.mark.slow
def test_mask_covers_the_plaque(run):
    organ, radius = run["pair"].organ, 3 * MM
    is_in = run["mask"][organ.faces].all(axis=1)
    area = face_areas(Mesh(organ.vertices, organ.faces))[is_in].sum()
    assert area == pytest.approx(np.pi * radius**2, rel=0.15)
    assert organ.metadata["lesions"][0]["kind"] == "xanthoma"


def test_its_settings_follow_from_its_fields(run):
    assert describe_kind(run["Xanthoma"]) == ("", "`size` 1 to 10 mm")
    with pytest.raises(InputError, match=r"Xanthoma size is 20 mm\. Allowed: 1 to 10 mm\."):
        parse_lesion("xanthoma:size=20mm")


PLUGIN = """
from dataclasses import dataclass
from typing import Annotated, ClassVar
from vrcaps.core.fields import Range
from vrcaps.lesion import Lesion

@dataclass(frozen=True, kw_only=True)
class Mine(Lesion):
    kind: ClassVar[str] = "my-kind"
    size: Annotated[float, Range(1e-3, 1e-2, unit="m")] = 2e-3
"""


def test_a_kind_of_a_plugin(site, monkeypatch, tmp_path):
    """It is known to texts and scenario files before anything else imports it."""
    monkeypatch.setattr(LESIONS, "_added", {})
    install(site, PLUGIN)
    lesion = parse_lesion("my-kind:size=4mm")
    assert (lesion.kind, lesion.size) == ("my-kind", 4 * MM)
    path = tmp_path / "lesions.toml"
    path.write_text('[[lesions]]\nkind = "my-kind"\nsize = 0.004\n')
    assert read_lesions(path) == (lesion,)
