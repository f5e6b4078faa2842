"""The organ that docs/how-to/extending.md adds, run as it stands there."""

import re
from pathlib import Path

import numpy as np
import pytest

from vrcaps.anatomy import catalog
from vrcaps.mesh.mesh import Mesh, find_edges, signed_volume
from vrcaps.mesh.self_intersection import self_intersections
from vrcaps.organ.segments import ORGANS, organ_segments
from vrcaps.tissue.motility.segment import MOTILITIES, segment_motilities

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "extending.md"


@pytest.fixture
def names(tmp_path, monkeypatch):
    """Names that the section defines."""
    monkeypatch.setenv("VRCAPS_CACHE", str(tmp_path))
    text = PAGE.read_text(encoding="utf-8")
    section = re.search(r"^## An organ\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert section is not None
    found: dict = {"__name__": __name__}
    for code in re.findall(r"```python\n(.*?)```", section[1], re.DOTALL):
        exec(code, found)
    yield found
    del ORGANS["esophagus"], catalog._GENERATORS["esophagus"]


@pytest.mark.slow
def test_an_organ_of_ones_own_has_a_wall_a_look_and_motility(names):
    organ = names["organ"]
    assert organ.label_names == ("background", "esophagus")
    assert (find_edges(organ.faces).counts == 2).all()
    assert not len(self_intersections(organ.vertices, organ.faces))
    volume = abs(signed_volume(Mesh(organ.vertices, organ.faces)))
    assert volume == pytest.approx(np.pi * 0.01**2 * 0.2, rel=0.1)
    assert organ.appearance is not None
    assert segment_motilities()["esophagus"] is MOTILITIES["duodenum"]
    assert organ_segments("esophagus") == ("esophagus",)
