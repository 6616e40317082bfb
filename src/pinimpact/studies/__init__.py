"""Parameters from measurements; accuracy against run time; other solvers of the same problem."""

from .estimate import Identified
from .found import FoundImpacts
from .identification import identify
from .recordings import Motion, impacts

__all__ = ["FoundImpacts", "Identified", "Motion", "identify", "impacts"]
