"""YAML front matter against PyYAML."""

import pytest
import yaml

from vrcaps.config.plain_files import front_matter, size_category


def read(text: str) -> dict:
    start, header, rest = text.split("---\n")
    assert start == rest == ""
    return yaml.safe_load(header)


def test_yaml_reads_the_same_values() -> None:
    values = {
        "name": 'quoted "text": with – signs',
        "license": "apache-2.0",
        "sizes": ["1K<n<10K", "n<1K"],
        "words": ["yes", "No", "null", "1e5", "0x1F", "12:30:00", "2026-01-01", "~", "a b"],
        "numbers": [1, -2, 0.5, 1e-05, 1.5e-7, 3e20, True, False],
        "model-index": [
            {"name": "x", "results": [{"task": {"type": "t"}, "metrics": [{"value": 0.25}]}]}
        ],
        "configs": [{"config_name": "a", "default": True, "data_files": [{"path": ["x/*", "y"]}]}],
    }
    assert read(front_matter(values)) == values


@pytest.mark.parametrize("empty", ["", None, [], (), {}])
def test_empty_values_are_left_out(empty: object) -> None:
    assert read(front_matter({"license": "mit", "datasets": empty})) == {"license": "mit"}


@pytest.mark.parametrize(
    ("frames", "name"),
    [(999, "n<1K"), (1000, "1K<n<10K"), (10**6, "1M<n<10M"), (10**11, "10B<n<100B")],
)
def test_sizes_have_the_names_of_the_hub(frames: int, name: str) -> None:
    assert size_category(frames) == name
