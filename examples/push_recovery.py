"""A quadruped with joint PD control is pushed until its feet slip, and recovers; plot of the contact forces.

python examples/push_recovery.py [out]
"""

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinimpact
from pinimpact.visual.plots import forces_figure, save_figure

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
PERIOD, DURATION = 1e-3, 2.0  # of the control, and of the motion [s]
PUSH, BEGINS, ENDS = np.array([0.0, 16.0, 0.0]), 0.4, 0.5  # on the trunk, sideways [N], and when [s]
KP, KD = 8.0, 0.3


def stand(model, data):
    """Return the configuration in which the feet stand on z = 0."""
    q = pin.neutral(model)
    q[7:] = np.tile([0.0, 0.7, -1.4], 4)
    pin.framesForwardKinematics(model, data, q)
    q[2] -= min(data.oMf[model.getFrameId(foot)].translation[2] for foot in FEET)
    return q


def simulate_push():
    """Return the trajectory of a motion advanced step by step, as in a control loop."""
    robot = pinimpact.load_robot("solo12")
    model, data = robot.model, robot.model.createData()
    ground = pinimpact.Plane()
    contacts = [pinimpact.Contact(foot, ground, name=foot, friction=0.5) for foot in FEET]
    target = stand(model, data)
    stepper = pinimpact.Stepper(pinimpact.Scene(robot, contacts), target, np.zeros(model.nv))
    tau = np.zeros(model.nv)
    for k in range(round(DURATION / PERIOD)):
        q, v = stepper.q, stepper.v
        tau[6:] = KP * (target[7:] - q[7:]) - KD * v[6:]
        pushed = BEGINS <= k * PERIOD < ENDS
        tau[:3] = pin.Quaternion(q[3:7]).matrix().T @ PUSH if pushed else 0.0  # in the trunk's axes
        stepper.step(tau, PERIOD)
    return stepper.trajectory


def main(out: Path) -> None:
    """Print the intervals of slip of each foot, and write the figure."""
    trajectory = simulate_push()
    for interval in trajectory.modes:
        if interval.mode == "slip" and interval.end - interval.start > 2e-3:
            print(f"{interval.source} slips from {interval.start:.3f} s to {interval.end:.3f} s")
    drift, speed = trajectory.q[-1, :2], np.abs(trajectory.v[-1]).max()
    print(f"the trunk has moved by ({drift[0]:.3f}, {drift[1]:.3f}) m and moves at {speed:.1e} now")
    out.mkdir(parents=True, exist_ok=True)
    print(save_figure(forces_figure(trajectory, FEET, "A push at 0.4 s"), out / "push_recovery.png"))


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
