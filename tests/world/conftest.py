from tests.support.bent_tube import model, rng, tube

__all__ = ["model", "rng", "tube"]
