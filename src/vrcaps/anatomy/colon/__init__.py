"""A generated colon: parameters, course, wall, surface."""

from .generate import generate_colon as generate_colon
from .parameters import ColonParameters as ColonParameters
from .parameters import ColonSegment as ColonSegment
