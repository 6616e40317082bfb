"""Uncertainty of a robot's velocity after an impact if friction and restitution are uncertain.

python examples/how_sure.py

A Panda strikes a table with its hand: friction is 0.4 ± 0.1, restitution 0.5 ± 0.1. Sobol' indices show which
of the two causes the variance of velocities. The plot is how_sure.png.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import pinimpact

VELOCITY = [0.4, 2.0, 0.4, -0.8, 0.25, 1.0, 0.0, 0.0, 0.0]
OVER = {
    "friction": stats.truncnorm(-4, np.inf, 0.4, 0.1),
    "restitution": stats.truncnorm(-5, 5, 0.5, 0.1),
}


def strike(samples, design="saltelli"):
    """Return the scene of an impact and its ensemble."""
    robot = pinimpact.load_robot("panda")
    hand = pinimpact.Contact("panda_hand_tcp", pinimpact.Plane(), name="hand")
    scene = pinimpact.Scene(robot, [hand])
    found = pinimpact.ensemble(
        scene, robot.q0, VELOCITY, None, over=OVER, samples=samples, seed=1, design=design
    )
    return scene, found


def main(samples=8192):
    """Print and plot the velocities after the impact."""
    _, found = strike(samples)
    shares = ", ".join(f"{share.value:.0%} {status}" for status, share in found.frequencies().items())
    print(f"{found}: {shares}")
    names = [f"v.panda_joint{k}" for k in (1, 2, 3, 4, 5, 6, 7)]
    _, (left, right) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    for row, name in enumerate(names):
        low, middle, high = (estimate.value for estimate in found.quantiles(name))
        total = dict(zip(found.parameters, found.sobol_indices(name).total_order, strict=True))
        print(
            f"{name}: median {middle:6.3f} rad/s, 90 % from {low:6.3f} to {high:6.3f}; part of the variance "
            f"with friction {total['friction']:.2f}, with restitution {total['restitution']:.2f}"
        )
        left.plot([low, high], [row, row], color="C0", lw=5, alpha=0.4)
        left.plot(middle, row, "o", color="C0")
        left.plot(VELOCITY[row], row, "x", color="black")
        right.barh(row - 0.2, total["friction"], 0.35, color="C1")
        right.barh(row + 0.2, total["restitution"], 0.35, color="C2")
    for axes in (left, right):
        axes.set_yticks(range(len(names)), [name.removeprefix("v.panda_") for name in names])
        axes.invert_yaxis()
    left.set_xlabel("velocity before (×) and after the impact, with 90 % of the samples [rad/s]")
    right.set_xlabel("part of the variance, alone or together with the other")
    right.legend(["friction", "restitution"], loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False)
    left.figure.savefig("how_sure.png", dpi=120)
    print("how_sure.png")


if __name__ == "__main__":
    main()
