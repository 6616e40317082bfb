"""Tolerances of geometry: lengths relative to the size of the shapes, unless a unit is given."""

from __future__ import annotations

from .._numeric.tolerances import EPS, LITTLE, NOISE, ROUNDING

COAL_ERROR = 1e-10
"""Difference up to which coal's distance and the separation along its normal are the same: coal makes boxes
larger by this. If they differ by more, its points are not the closest ones."""

GJK = COAL_ERROR / 100.0
"""Tolerance of coal's distance."""

CLOSE = 1e-6
"""Gap below which coal's distance is replaced by one that is exact to rounding: far above `COAL_ERROR` and
far below the motion of a step. Where points leave a face, shapes move by it, relative to the smaller one,
before new contacts are detected; overlaps stay below it unless that fails."""

LOCAL = 10.0 * CLOSE
"""Distance of a corner behind the extreme one up to which it may belong to the closest feature."""

COINCIDE = 1e-9
"""Distance below which points coincide, points lie in a plane or on a line, and all edges of two shapes in
contact are tried; also the difference of normals of facets of one face, and the sine of the angle of edges
below which they do not determine a normal. For two shapes it is relative to the smaller one, whose features
it must distinguish, plus `NOISE` of the larger one, the rounding of its coordinates."""

TIE = NOISE
"""Tolerance for equal separations; faces then precede edges."""

NEAREST = 4.0 * ROUNDING
"""Tolerance for equally close points, and for features that touch together."""

FACE = 1.0 - LITTLE**2
"""Cosine of the angle between a normal and that of a face within which the face is the reference: 1.4 mrad,
wide enough for normals that GJK finds, and far below the angle between two faces."""

FACING = 0.9
"""Cosine of the angle within which a face faces a direction."""

SAME_DIRECTION = 1.0 - 4.0 * EPS
"""Cosine of the angle between edges above which they are parallel: rounding."""

NOT_CONVEX = LITTLE
"""Depth of a vertex of a mesh inside its hull from which on the mesh is not convex."""

SAFETY = 1.5
"""Factor on bounds and curvatures that follow from samples of a motion within a step. (theory.md, 10)"""

FAR = 0.1
"""Gap beyond which the normal need not follow the extreme features."""
