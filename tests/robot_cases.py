"""Robots with contact frames, random states and contacts, and independent mass matrices and energies."""

import functools

import numpy as np
import pinocchio as pin

import pinimpact

FRAMES = {
    "panda": "panda_hand_tcp",
    "ur5": "tool0",
    "kinova": "j2s6s200_end_effector",  # continuous joints: nq ≠ nv
    "talos_arm": "gripper_left_base_link",
    "solo12": "FL_FOOT",  # free-flyer
    "talos": "right_sole_link",  # free-flyer
    "xarm7": "link_eef",
    "double_pendulum_continuous": "link2",
}


@functools.cache
def _loaded(name):
    return pinimpact.load_robot(name)


def load(name):
    """Return a copy of the model of a robot, and its data."""
    model = _loaded(name).model.copy()
    return model, model.createData()


def q0_of(name):
    """Return the initial configuration of a robot."""
    return _loaded(name).q0.copy()


def two_arms() -> tuple[pin.Model, pin.Data]:
    """Return two arms side by side; names of the second begin with "other_"."""
    arm = load("ur5")[0]
    other = arm.copy()
    for frame in other.frames:
        frame.name = "other_" + frame.name
    for joint in range(1, other.njoints):
        other.names[joint] = "other_" + other.names[joint]
    model = pin.appendModel(arm, other, 0, pin.SE3(np.eye(3), np.array([0.5, 0, 0])))
    return model, model.createData()


def random_state(model, rng):
    """Return a random configuration around the neutral one, and a random velocity."""
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.5, 1.5, model.nv))
    return q, rng.normal(size=model.nv)


def random_rotation(rng):
    return pin.Quaternion(*(x := rng.normal(size=4)) / np.linalg.norm(x)).matrix()


def random_plane(rng, body=None, **rates):
    return pinimpact.Plane(point=rng.normal(size=3), normal=rng.normal(size=3), body=body, **rates)


def random_sphere(rng, body=None, **rates):
    return pinimpact.Sphere(
        center=rng.normal(scale=0.3, size=3), radius=rng.uniform(0.01, 0.3), body=body, **rates
    )


def random_contact(frame, rng, plane=None, **changes):
    settings = {
        "friction": rng.uniform(0.0, 1.0),
        "restitution": rng.uniform(0.0, 1.0),
        "offset": rng.normal(scale=0.1, size=3),
        "radius": rng.uniform(0.0, 0.1),
    }
    return pinimpact.Contact(frame, plane or random_plane(rng), **(settings | changes))


def approaching(model, data, q, v, contact):
    """Return a multiple of v, reversed or scaled up, for which the contact approaches."""
    matrices = pinimpact.contact_matrices(model, data, q, contact)
    for factor in (1, -1, 10, -10, 1000, -1000):
        if matrices.velocity(factor * v)[2] < 0.0:
            return factor * v
    raise AssertionError("nothing approaches")


def mass_by_rnea(model, q):
    """Return M, computed by columns from inverse dynamics, independently of crba."""
    data = model.createData()
    at_rest = pin.rnea(model, data, q, np.zeros(model.nv), np.zeros(model.nv)).copy()
    columns = [
        pin.rnea(model, data, q, np.zeros(model.nv), unit).copy() - at_rest for unit in np.eye(model.nv)
    ]
    mass = np.array(columns).T
    return 0.5 * (mass + mass.T)


def kinetic_energy(model, q, v):
    """Return ½ v·(rnea(q, 0, v) − rnea(q, 0, 0)), the kinetic energy with rotors but without the matrix M."""
    data = model.createData()
    zero = np.zeros(model.nv)
    momentum = pin.rnea(model, data, q, zero, v).copy() - pin.rnea(model, data, q, zero, zero)
    return 0.5 * float(v @ momentum)


GRIPPER = """<robot name="gripper"><link name="world"/>
<joint name="arm" type="revolute"><parent link="world"/><child link="hand"/>
  <axis xyz="0 1 0"/>{{limit}}</joint>
<link name="hand">{{inertial}}</link>
<joint name="left" type="revolute"><parent link="hand"/><child link="left_finger"/>
  <origin xyz="1 0.1 0"/><axis xyz="0 0 1"/>{{limit}}</joint>
<link name="left_finger">{{inertial}}</link>
<joint name="right" type="revolute"><parent link="hand"/><child link="right_finger"/>
  <origin xyz="1 -0.1 0"/><axis xyz="0 0 1"/>{{limit}}
  <mimic joint="{leader}" multiplier="-2" offset="0.1"/></joint>
<link name="right_finger">{{inertial}}</link>
{more}</robot>"""


def gripper(leader: str, inertial: str, more: str = "") -> str:
    """Return the URDF of a hand whose right finger mimics another joint.

    Args:
        leader: The mimicked joint.
        inertial: Inertial element of each link.
        more: Further links and joints, with placeholders {limit} and {inertial}.
    """
    limit = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
    return GRIPPER.format(leader=leader, more=more).format(limit=limit, inertial=inertial)
