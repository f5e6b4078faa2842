from tests.cli.benchmarks.conftest import stage

__all__ = ["stage"]
