"""A quadruped lands on its feet: contact forces from touchdown to standing.

python examples/quadruped_landing.py

It prints the largest impulse and the final normal force of each foot, and plots the forces to
quadruped_landing.png.
"""

import numpy as np
import pinocchio as pin

import pinimpact
from pinimpact.visual import plots

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
HEIGHT, DURATION = 0.08, 1.0  # of the lowest foot at the start [m]; of the motion [s]


def landing():
    """Return the motion and the model."""
    robot = pinimpact.load_robot("solo12")
    model, data = robot.model, robot.data
    floor = pinimpact.Plane()
    contacts = [pinimpact.Contact(foot, floor, friction=0.6, restitution=0.1, name=foot) for foot in FEET]
    q = pin.neutral(model)
    q[7:] = np.tile([0.0, 0.7, -1.4], 4)
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.05, 0.08, 0.0)).coeffs()
    q[2] += HEIGHT - min(contact.gap(model, data, q) for contact in contacts)
    springs = pinimpact.JointPD(kp=20.0, kd=1.0, q_ref=q)
    scene = pinimpact.Scene(robot, contacts, control=springs)
    return pinimpact.simulate(scene, q, np.zeros(model.nv), DURATION, rtol=1e-6, atol=1e-8), model


def main():
    """Print the loads and plot them."""
    trajectory, model = landing()
    times = np.linspace(0.0, DURATION, 2001)
    for foot in FEET:
        hardest = max(
            (impact for impact in trajectory.impacts if impact.source == foot),
            key=lambda impact: impact.solution.impulse[2],
        )
        normal = trajectory.forces(foot, times)[:, 2]
        print(
            f"{foot}: largest impulse {hardest.solution.impulse[2]:.3f} N s at {hardest.time:.3f} s; "
            f"normal force up to {normal.max():.0f} N, {normal[-1]:.2f} N in the end"
        )
    total = sum(trajectory.forces(foot, DURATION)[2] for foot in FEET)
    print(f"sum {total:.2f} N, weight {9.81 * pin.computeTotalMass(model):.2f} N")
    print(plots.save_figure(plots.forces_figure(trajectory, FEET, "A landing"), "quadruped_landing.png"))


if __name__ == "__main__":
    main()
