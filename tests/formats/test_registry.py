"""All formats: names as their classes say them, and nothing loaded before it is used."""

import subprocess
import sys

import pytest

from vrcaps.formats.format import FORMATS


@pytest.mark.parametrize("kind", FORMATS)
def test_a_line_names_its_format(kind):
    form = FORMATS[kind]
    assert form.kind == kind
    assert form().read
    assert form().write
    assert FORMATS.summary(kind).endswith(".")


def test_the_registry_loads_no_format():
    code = "import sys, vrcaps.formats.format; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split())
    assert not {FORMATS[kind].__module__ for kind in FORMATS} & loaded
    assert not {"numpy", "scipy"} & loaded
