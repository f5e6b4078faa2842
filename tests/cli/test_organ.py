"""Lines on lesions, and names of figures."""

import pytest

from tests.support.tubes import straight_gut
from vrcaps import cli
from vrcaps.cli.organ import Inspect, lesion_lines


@pytest.mark.parametrize(
    ("command", "figure"),
    [
        ("scan.stl --unit mm", "scan-overview.png"),
        ("runs/colon-3.glb", "colon-3-overview.png"),
        ("stomach --seed 3", "stomach-3-overview.png"),
        ("stomach", "stomach-0-overview.png"),
    ],
)
def test_a_figure_has_the_name_of_the_organ_or_its_file(command, figure, monkeypatch):
    drawn = []
    monkeypatch.setattr("vrcaps.cli.organ.report_organ", lambda _, path: drawn.append(str(path)))
    monkeypatch.setattr(Inspect, "_load", lambda _: straight_gut({"colon": 0.2}, radius=0.02))
    cli.main(["organ", "inspect", *command.split()])
    assert drawn == [figure]


def test_lines():
    record = {
        **{"instance": 2, "kind": "polyp", "grade": "Is", "segment": "sigmoid"},
        **{"arc_length_m": 1.5, "specification": {"size": 0.008}},
    }
    (line,) = lesion_lines([record], 2.0)
    assert line == "2: polyp Is of 8.0 mm, sigmoid, 150.0 cm (0.750 of the centerline)"
