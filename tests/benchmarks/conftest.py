"""Fixtures of the tests of benchmarks."""

import pytest

from tests.cli.benchmarks.conftest import stage

__all__ = ["stage"]


@pytest.fixture
def plain_stamp(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages are stamped without reading all sources, which `test_sources` does."""
    monkeypatch.setattr("benchmarks.common.sections.sources", lambda name: "0123456789")
