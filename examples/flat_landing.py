"""A quadruped lands flat on four feet, and with a tilt of 0.001 rad.

Motors hold the legs. The flat landing is one impact at four contacts. In the tilted landing the feet land one
after another, half a millisecond apart, in separate impacts, in which the feet on the ground take part.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

import pinimpact

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


def land(roll: float, policy: str = "propagate") -> tuple[pinimpact.Trajectory, np.ndarray]:
    """Return the motion of a drop from 5 cm and the velocity of the base 5 ms after the first contact."""
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
    stiff = list(robot.model.names)[2:]  # motors hold the legs
    scene = pinimpact.Scene(robot, contacts, locked=stiff, simultaneous=policy)
    motion = pinimpact.simulate(scene, q, np.zeros(robot.model.nv), 0.12)
    first = motion.impacts[0].time
    return motion, motion.at(first + 5e-3)[1][:6]


def draw(ax: plt.Axes, motion: pinimpact.Trajectory) -> None:
    """Draw the velocities of the base in the milliseconds around the first contact."""
    first = motion.impacts[0].time
    t = np.linspace(first - 1e-3, first + 5e-3, 600)
    v = np.array([motion.at(time)[1][:6] for time in t])
    ax.plot(1e3 * (t - first), v[:, 2], "C0", label="vertical velocity [m/s]")
    ax.plot(1e3 * (t - first), v[:, 3], "C1", label="roll rate [rad/s]")
    ax.plot(1e3 * (t - first), v[:, 4], "C2", label="pitch rate [rad/s]")
    for impact in motion.impacts:
        if impact.time < t[-1]:
            ax.axvline(1e3 * (impact.time - first), color="0.8", zorder=0)
    ax.set(xlabel="time since the first touch [ms]")


def main() -> None:
    """Print and plot both landings."""
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey=True)
    for row, policy in zip(axes, ("propagate", "sequence"), strict=True):
        for ax, (name, roll) in zip(row, (("flat", 0.0), ("rolled by 0.001 rad", 1e-3)), strict=True):
            motion, base = land(roll, policy)
            first = motion.impacts[0].time
            early = [impact for impact in motion.impacts if impact.time < first + 5e-3]
            instants = sorted({impact.time for impact in early})
            print(f"{policy}, {name}, first 5 ms: impulses {len(early)}, instants {len(instants)}")
            linear, angular = np.round(base.reshape(2, 3), 4) + 0.0  # without −0
            print(f"  base after 5 ms: v = {linear} m/s, ω = {angular} rad/s")
            draw(ax, motion)
            ax.set_title(f"{policy}, {name}")
    axes[0, 0].legend()
    figure.tight_layout()
    figure.savefig("flat_landing.png", dpi=110)
    print("Figure: flat_landing.png")


if __name__ == "__main__":
    main()
