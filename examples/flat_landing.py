"""A quadruped lands flat on four feet, and tilted by a thousandth: two impacts, or one with four contacts.

The flat landing is one impact at four contacts. Tilted, the feet touch one after another, microseconds
apart: each is an impact of its own, at which the feet on the ground take part.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinimpact

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


def land(roll: float, policy: str = "propagate") -> tuple[pinimpact.Trajectory, np.ndarray]:
    """Return the motion of a drop from 5 cm and the velocity of the base 5 ms after the first touch."""
    robot = pinimpact.load_robot("solo12")
    ground = pinimpact.Plane()
    contacts = [
        pinimpact.Contact(foot, ground, friction=0.7, restitution=0.3, law="energetic") for foot in FEET
    ]
    q = pinimpact.place_in_contact(robot.model, robot.data, robot.q0, contacts)
    half = 0.5 * roll
    turn = pin.Quaternion(q[6], q[3], q[4], q[5]) * pin.Quaternion(np.cos(half), np.sin(half), 0.0, 0.0)
    q[2] += 0.05
    q[3:7] = turn.coeffs()
    scene = pinimpact.Scene(robot, contacts, simultaneous=policy)
    motion = pinimpact.simulate(scene, q, np.zeros(robot.model.nv), 0.12)
    first = motion.impacts[0].time
    return motion, motion.at(first + 5e-3)[1][:6]


def main() -> None:
    """Print both landings side by side."""
    for policy in ("propagate", "sequence"):
        for name, roll in (("flat", 0.0), ("rolled by 0.001 rad", 1e-3)):
            motion, base = land(roll, policy)
            first = motion.impacts[0].time
            early = [impact for impact in motion.impacts if impact.time < first + 5e-3]
            instants = sorted({impact.time for impact in early})
            print(f"{policy}, {name}: {len(early)} impulses at {len(instants)} instants in the first 5 ms")
            print(f"  base after 5 ms: v = {np.round(base[:3], 4)} m/s, ω = {np.round(base[3:], 3)} rad/s")


if __name__ == "__main__":
    main()
