"""Data of a robot and of the contact that collides, for the kernels of impacts."""

from __future__ import annotations

from ..._compile.workspace import Workspace, integer, integers, real, reals, size
from ...geometry._kernels.constants import CONSTANTS

REVOLUTE, UNBOUNDED, PRISMATIC, FREE_FLYER, SPHERICAL, TRANSLATION, PLANAR = range(7)
"""Kinds of joints: by angle, by its cosine and sine, by length; others as in Pinocchio."""


class RobotWorkspace(Workspace):
    """See `pinimpact._compile.workspace` for its declaration and access.

    Kernels that run without the global interpreter lock do not write to it, so threads can share it.
    Placements are twelve numbers, see `placement`.
    """

    nq = size("numbers of a configuration")
    nv = size("velocities")
    bodies = size("joints of the model, with the world")
    room = size("numbers that one impact needs room for, see `room_for`")

    # the robot, in Pinocchio's memory, so that changes of the model take effect
    joint_placements = reals("bodies", 12, given=True, meaning="on the parent joint")
    inertias = reals("bodies", 10, given=True, meaning="mass, centre (3), about it xx, xy, yy, xz, yz, zz")
    armature = reals("nv", given=True, meaning="rotor inertias")
    frame = reals(12, given=True, meaning="placement of the contact's frame on its joint")
    carrier = reals(12, given=True, meaning="of the frame that carries the surface, or of the world")

    joint_kind = integers("bodies", given=True, meaning="see `REVOLUTE` and its neighbours")
    joint_axis = integers(
        "bodies", given=True, meaning="which of its own axes it turns or slides along, else −1"
    )
    joint_parent = integers("bodies", given=True, meaning="the parent joint")
    velocity_axis = reals("nv", 3, given=True, meaning="direction of each velocity in the joint's own axes")
    joint_q = integers("bodies", given=True, meaning="where its coordinates begin in q")
    velocity_joint = integers("nv", given=True, meaning="the joint that each velocity belongs to")
    velocity_turns = integers("nv", given=True, meaning="1 where it is a rotation, else 0")
    joint_v = integers("bodies", given=True, meaning="where its velocities begin in v")
    velocity_parent = integers("nv", given=True, meaning="the next velocity on the way to the root, or −1")
    bounds = reals(2, "nq", given=True, meaning="the least and the greatest value of each coordinate")

    # the contact
    frame_joint = integer("the joint that its frame is fixed to")
    carrier_joint = integer("the joint that the surface is fixed to, 0 for the world")
    signs = reals("nv", given=True, meaning="1: moves the tip only, −1: the surface only, else 0")
    constants = reals(CONSTANTS, meaning="see `constants`")
    friction = real("its coefficient of friction")
    law = integer("the code of its law")

    scratch = reals("room", given=True, meaning="room for an impact that is alone")
