from dataclasses import replace

import numpy as np
import pytest

from vrcaps.core.errors import InputError, UnknownNameError
from vrcaps.core.units import CM, MM
from vrcaps.lesion import LESIONS, Bleeding, Colitis, Location, Polyp, lesion_library, parse_lesion
from vrcaps.lesion.structural import Stricture

LIBRARY = lesion_library()


@pytest.mark.parametrize(
    ("text", "lesion"),
    [
        ("polyp", Polyp()),
        (
            "polyp-Ip:size=12mm,segment=sigmoid",
            Polyp(shape="Ip", size=12 * MM, location=Location("sigmoid")),
        ),
        (
            " polyp : theta = 90deg , arc_length=0.8m",
            Polyp(location=Location(None, 0.8, np.pi / 2)),
        ),
        ("colitis-2:spread=E2", Colitis(mayo=2, spread="E2")),
        ("colitis-3:spread=20cm,variant=4", Colitis(mayo=3, spread=20 * CM, variant=4)),
        ("bleeding-4", Bleeding(severity=4)),
        ("stricture:narrowing=0.4", Stricture(narrowing=0.4)),
        ("polyp-IIa-serrated:size=9mm", replace(LIBRARY["polyp-IIa-serrated"], size=9 * MM)),  # type: ignore[call-arg]
        ("colitis-1-20", LIBRARY["colitis-1-20"]),
    ],
)
def test_texts(text, lesion):
    assert parse_lesion(text) == lesion


@pytest.mark.parametrize("kind", LESIONS)
def test_every_kind_by_its_name(kind):
    assert parse_lesion(kind) == LESIONS[kind]()


def test_library_of_the_paper():
    counts = {kind: sum(name.startswith(kind) for name in LIBRARY) for kind in LESIONS}
    assert (counts["polyp"], counts["colitis"], counts["bleeding"]) == (20, 60, 40)
    assert len(set(LIBRARY.values())) == 120


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        ("polip", UnknownNameError, "No lesion named 'polip'"),
        ("polyp-Iq", UnknownNameError, "polyp-IIb, polyp-IIc, polyp-Ip, polyp-Ip-tubular to"),
        ("colitis-1-21", UnknownNameError, "colitis-1, colitis-1-01 to colitis-3-20, colitis-2"),
        ("polyp:size=12", InputError, "size is '12'. Allowed: a length such as 8mm"),
        ("polyp:size=50mm", InputError, "Polyp size is 50 mm. Allowed: 2 to 30 mm"),
        ("polyp:sise=5mm", UnknownNameError, "No setting of polyp named 'sise'"),
        ("polyp:size", InputError, "Allowed: key=value"),
        ("polyp:variant=a", InputError, "Allowed: a number"),
        ("tumor-3", InputError, "tumor has no grades"),
        ("colitis-4", UnknownNameError, "No lesion named .colitis-4."),
        ("colitis:spread=E9", InputError, "Allowed: E1, E2, E3, a length such as 8mm"),
        ("colitis:spread=5mm", InputError, "Allowed: E1, E2, E3, 10 to 3000 mm"),
        ("stricture:narrowing=0.99", InputError, "Allowed: 0.2 to 0.85"),
        (
            "ulcer-aphthous:size=20mm",
            InputError,
            "Aphthous ulcer size is 20 mm",
        ),
    ],
)
def test_bad_texts(text, error, match):
    with pytest.raises(error, match=match):
        parse_lesion(text)


def test_bad_grades():
    with pytest.raises(InputError, match=r"Colitis mayo is 7\. Allowed: 1, 2, 3"):
        Colitis(mayo=7)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Allowed: 1, 2, 3, 4"):
        Bleeding(severity=0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Allowed: E1, E2, E3"):
        Colitis(spread="E4")  # type: ignore[arg-type]
