"""Tables of channels in the docs are those that their declarations give."""

import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "channel_tables.py"))


@pytest.mark.parametrize("page", SCRIPT["TABLES"])
def test_tables_are_up_to_date(page):
    text = (DOCS / page).read_text("utf-8")
    table = SCRIPT["TABLES"][page]()
    assert SCRIPT["with_table"](text, table) == text, "Run: python docs/channel_tables.py"
