"""Fixtures shared by all tests."""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))  # tubes


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Optional real test data beside the checkout."""
    path = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not path.is_dir():
        pytest.skip(f"optional test data not found at {path}")
    return path
