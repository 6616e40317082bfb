"""An unactuated arm falls onto a block and the floor; contacts from collision shapes.

All collision shapes of the arm can make contact with the floor, a plane; those of the forearm and the hand
also with the block, convex shape against convex shape.
"""

from __future__ import annotations

import warnings

import matplotlib.pyplot as plt
import numpy as np

import pinimpact

HAND = ("forearm_link", "wrist_1_link", "wrist_2_link", "wrist_3_link")


def scene() -> pinimpact.Scene:
    """Return a scene of a UR5 on a floor, next to a block."""
    robot = pinimpact.load_robot("ur5")
    floor = pinimpact.Plane(name="floor")
    block = pinimpact.Box(size=(0.2, 0.4, 0.1), center=(0.83, 0.12, 0.05), name="block")
    rubber = {"friction": 0.5, "restitution": 0.2, "law": "energetic"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # meshes that are not convex are replaced by their hulls
        bare = pinimpact.Scene(robot)
        return bare.contacts_from_geometry(floor, **rubber).contacts_from_geometry(
            block, links=HAND, **rubber
        )


def main() -> None:
    """Print the first contacts, plot them, and write a replay."""
    fall = scene()
    print(fall.plan()["contact guards"].reason)
    q = np.array([0.0, -0.9, 0.9, 0.0, 0.0, 0.0])
    motion = pinimpact.simulate(fall, q, np.zeros(6), 1.0)
    shapes = {contact.label: f"{contact.shape} on {contact.plane.label}" for contact in fall.contacts}
    first: dict[str, float] = {}
    for impact in motion.impacts:
        first.setdefault(shapes[impact.source], impact.time)
    for source, time in first.items():
        print(f"{time:.4f} s  {source}")

    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 5), sharex=True)
    above.plot(motion.t, motion.energy.kinetic, label="kinetic energy")
    above.set(ylabel="[J]")
    for k, (source, time) in enumerate(first.items()):
        above.axvline(time, color=f"C{k + 1}", lw=0.8, label=source)
    above.legend(fontsize=7)
    t = np.linspace(0.0, motion.t[-1], 400)
    closed = {mode.source for mode in motion.modes}  # at times; the others have no sustained forces
    for k, pair in enumerate(first):
        names = [label for label, shape in shapes.items() if shape == pair and label in closed]
        force = sum((motion.forces_world(name, t)[:, 2] for name in names), np.zeros(len(t)))
        below.plot(t, force, color=f"C{k + 1}")
    below.set(xlabel="t [s]", ylabel="sustained force up [N]", yscale="symlog")
    figure.tight_layout()
    figure.savefig("arm_falls_on_elbow_and_hand.png", dpi=110)
    print("Figure: arm_falls_on_elbow_and_hand.png")
    path = pinimpact.replay(pinimpact.load_robot("ur5"), motion, path="arm_falls_on_elbow_and_hand.html")
    print(f"Replay: {path}")


if __name__ == "__main__":
    main()
