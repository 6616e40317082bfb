"""Parameters from measurements; accuracy against run time; other solvers of the same problem."""

from .bodies import identify_body
from .comparing import Comparison, compare
from .estimate import Identified
from .found import FoundImpacts
from .identification import identify
from .prediction import Prediction, predict
from .recordings import Motion, impacts
from .rolling_out import RollOuts, rollouts
from .sliding import identify_sliding

__all__ = [
    "Comparison",
    "FoundImpacts",
    "Identified",
    "Motion",
    "Prediction",
    "RollOuts",
    "compare",
    "identify",
    "identify_body",
    "identify_sliding",
    "impacts",
    "predict",
    "rollouts",
]
