"""The tables of docs/concepts/lesions.md are those of the lesions' declarations."""

import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "docs" / "lesion_tables.py"


def test_tables_are_up_to_date():
    spec = importlib.util.spec_from_file_location("lesion_tables", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.PAGE.read_text(encoding="utf-8")
    assert module.written(text) == text, "Run: python docs/lesion_tables.py"
