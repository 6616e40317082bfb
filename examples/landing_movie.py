"""A running quadruped lands: its feet slip, then stick; animated picture and replay.

python examples/landing_movie.py [folder]

It writes landing.gif (with Chromium, Chrome or Edge) and landing.html.
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinimpact

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
HEIGHT, DURATION = 0.1, 0.5  # of the lowest foot at the start [m]; of the motion [s]
VELOCITY = (1.1, 0.0, 0.0)  # at the start, in the axes of the trunk [m/s]


def landing():
    """Return the robot and the motion."""
    robot = pinimpact.load_robot("solo12")
    model, data = robot.model, robot.data
    floor = pinimpact.Plane(name="floor")
    contacts = [pinimpact.Contact(foot, floor, friction=0.4, restitution=0.2) for foot in FEET]
    q = pin.neutral(model)
    q[7:] = np.tile([0.0, 0.8, -1.6], 4)
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.06, -0.12, 0.3)).coeffs()
    q[2] += HEIGHT - min(contact.gap(model, data, q) for contact in contacts)
    v = np.zeros(model.nv)
    v[:3] = VELOCITY
    springs = pinimpact.JointPD(kp=8.0, kd=0.25, q_ref=q)
    scene = pinimpact.Scene(robot, contacts, control=springs)
    return robot, pinimpact.simulate(scene, q, v, DURATION, rtol=1e-6, atol=1e-8)


def main(folder: Path = Path("out")) -> None:
    """Write the picture and the replay, ten times slower than the motion."""
    folder.mkdir(parents=True, exist_ok=True)
    robot, trajectory = landing()
    shown = pinimpact.replay(robot, trajectory, folder / "landing.html", speed=0.1, slowdown=1.0)
    print(shown)
    print(shown.video(folder / "landing.gif", rate=12.5, size=(720, 420)))
    for interval in sorted(trajectory.modes, key=lambda interval: interval.start):
        print(f"{interval.source} {interval.mode}s from {interval.start:.3f} s to {interval.end:.3f} s")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
