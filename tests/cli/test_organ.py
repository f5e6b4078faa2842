"""."""

from vrcaps.cli.organ import lesion_lines


def test_lines():
    record = {
        **{"instance": 2, "kind": "polyp", "grade": "Is", "segment": "sigmoid"},
        **{"arc_length_m": 1.5, "specification": {"size": 0.008}},
    }
    (line,) = lesion_lines([record], 2.0)
    assert line == "2: polyp Is of 8.0 mm, sigmoid, 150.0 cm (0.750 of the centerline)"
