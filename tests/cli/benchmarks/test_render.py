from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vrcaps.cli.benchmarks import render
from vrcaps.cli.benchmarks.render import COMPLETE, STUDIES, Study, drawn
from vrcaps.cli.benchmarks.stage import Extent, Stage
from vrcaps.core.errors import UnknownNameError
from vrcaps.render.renderer import DEFAULT_CHANNELS

SMALL = Extent(
    num_triangles=20_000,
    coarsest=20_000,
    num_subdivisions=1,
    sizes=(16, 32),
    num_views=2,
    num_rounds=2,
)


@pytest.fixture(scope="module")
def studies(stage: Stage) -> dict[str, Study]:
    rounds: list[None] = []
    found = {
        name: study(stage, SMALL, lambda: rounds.append(None)) for name, study in STUDIES.items()
    }
    assert len(rounds) == len(STUDIES) * (SMALL.num_rounds + 1)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_every_study_measures_something_positive(name: str, studies: dict[str, Study]) -> None:
    study = studies[name]
    for row in study.table.rows:
        assert len(row.values) == len(study.table.columns)
        assert all(value is not None and value.median > 0.0 for value in row.values)
    for claim in study.claims:
        assert (claim.measured is None) == (claim.reason != "")


def test_a_frame_is_complete_and_its_arrays_are_used_again(stage: Stage) -> None:
    frame = drawn(stage)
    (first,) = frame(0)
    depth = first.depth
    (second,) = frame(1)
    assert second.depth is depth
    assert all(getattr(second, channel) is not None for channel in DEFAULT_CHANNELS)
    assert np.isfinite(depth).mean() > 0.5


@pytest.mark.slow
def test_rate_is_one_over_the_time_of_a_frame(studies: dict[str, Study]) -> None:
    study = studies["frame"]
    row = next(row for row in study.table.rows if row.name == COMPLETE)
    rate = study.claims[0].measured
    assert rate is not None
    assert row.values[0] is not None
    assert rate.p10 <= 1e3 / row.values[0].median <= rate.p90


@pytest.mark.slow
def test_a_cost_that_is_twice_is_reported_as_twice(studies: dict[str, Study]) -> None:
    """Both heads are the front and the back one after the other."""
    front, back, both = (row.values[1] for row in studies["heads"].table.rows)
    assert front is not None
    assert back is not None
    assert both is not None
    assert both.median == pytest.approx(front.median + back.median, rel=0.5)


def test_run_writes_what_it_found(
    monkeypatch: pytest.MonkeyPatch, stage: Stage, tmp_path: Path
) -> None:
    monkeypatch.setattr(render, "make_organ", lambda *_, **__: stage.model.organ)
    report = render.run(out=tmp_path / "speed.md", quick=True, only=["refit"])
    assert report.claims[0].measured is not None
    page = (tmp_path / "speed.md").read_text("utf-8")
    assert "vrcaps bench render --only refit" in page
    assert "refit of 100,000 triangles" in page


def test_unknown_study_is_named() -> None:
    with pytest.raises(UnknownNameError, match=r"No study named 'colom'. Known: frame, heads"):
        render.run(only=["colom"])
