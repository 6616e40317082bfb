"""Two robots collide: a UR5 strikes a plate that a Panda holds.

python examples/two_robots.py

Both robots are in one Pinocchio model; the plate is a `Plane` whose `body` is a frame of the Panda. The
impulses on the robots are opposite, and the change of their energy is the work of the contact.
"""

import numpy as np
import pinocchio as pin

import pinimpact

UR5_Q = np.radians([0.0, -110.0, 80.0, -150.0, -90.0, 0.0])
UR5_V = np.array([0.35, 1.5, 0.0, 0.0, 0.0, 0.0])
PANDA_Q = np.array([0.0, -0.6, 0.0, -2.3, 0.0, 3.3, 0.8, 0.02, 0.02])  # the hand points forward


def place_of(model, q, frame):
    """Return the placement of a frame."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return data.oMf[model.getFrameId(frame)]


def both():
    """Return one model of a UR5 and a Panda that faces it, with its hand at the UR5's tool."""
    ur5, panda = pinimpact.load_robot("ur5").model, pinimpact.load_robot("panda").model
    facing = pin.rpy.rpyToMatrix(0.0, 0.0, np.pi)
    tool, hand = place_of(ur5, UR5_Q, "tool0"), place_of(panda, PANDA_Q, "panda_hand_tcp")
    base = pin.SE3(facing, tool.translation - facing @ hand.translation)
    return pin.appendModel(ur5, panda, 0, base), ur5.nv


def main():
    """Compute the impact with a free Panda and with its joints locked."""
    model, split = both()
    data = model.createData()
    q, v = np.concatenate([UR5_Q, PANDA_Q]), np.concatenate([UR5_V, np.zeros(9)])
    toward = (0.0, 0.0, 1.0)  # the plate faces out of the hand
    plate = pinimpact.Plane(normal=toward, body="panda_hand_tcp")
    tool = pinimpact.Contact("tool0", plate, friction=0.4, restitution=0.5, name="tool on plate")
    mass = pinimpact.contact_matrices(model, data, q, tool).mass
    hand = [name for name in model.names if name.startswith("panda_joint")]
    for label, locked in (("free", ()), ("locked", hand)):
        hit = pinimpact.impact(model, data, q, v, tool, locked=locked)
        change = mass @ (hit.v - v)  # of the generalized momentum
        energy = 0.5 * (v @ mass @ v - hit.v @ mass @ hit.v)
        print(
            f"Panda {label}: impulse {hit.impulse_world.round(3)} N s, {energy:.4f} J lost; largest change "
            f"of a joint's momentum: UR5 {np.abs(change[:split]).max():.3f}, "
            f"Panda {np.abs(change[split:]).max():.3f} N m s. {' '.join(hit.solution.flags.describe())}"
        )


if __name__ == "__main__":
    main()
