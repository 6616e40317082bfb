"""The layout of the constants of a contact.

In the axes of the tip's body: the tip's centre (3) and radius. In the axes of the surface's body: its point
(3), its axes (3, 3), and the velocity and angular velocity of its material (3 + 3). Then the code of its kind
and the number of its kind. In the tip's axes again, the radius of its rim (0 if it has none) and the unit
axis of that, or the unit direction of its edge (3). Last, in the axes of the surface's body, the unit
direction of a surface that is a line (3).

The bodies are frames for an impact and joints for a scene.
"""

from __future__ import annotations

TIP, RADIUS, POINT, AXES, VELOCITY, SPIN, KIND, SIZE, RIM, RIM_AXIS, LINE_AXIS, CONSTANTS = (
    *(0, 3, 4, 7, 16, 19, 22, 23),
    *(24, 25, 28, 31),
)

PLANE, SPHERE, LINE, EDGE, TIP_PLANE, FACE_EDGE = range(6)
"""The codes of kinds: a line is for points and spheres, an edge for edges, both with a radius. With the next
the tip is a plane, whose inward normal stands in place of the rim's axis, and the surface a sphere about its
point. The last is an edge for edges, with the normal of a plane: both bound faces in that plane."""

SOLID = -1
"""Code of surfaces that kernels do not support."""

ABSENT = -2
"""Code of the contacts reserved for two shapes while these do not touch. Their gap is infinite."""
