"""Shared modules of the tests of magnets."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
