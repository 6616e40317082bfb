"""A standing quadruped is kicked: impulses of its feet, unilateral or held.

A plate that moves at 1 m/s strikes the trunk from the side. The feet are at rest and take part in the
impact: some take up an impulse, some lift off, some slip. With `held=` they are bilateral
constraints and can pull.
"""

from __future__ import annotations

import warnings

import matplotlib.pyplot as plt
import numpy as np

import pinimpact

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")


def kick() -> tuple[np.ndarray, pinimpact.ManyHit, pinimpact.Hit]:
    """Return the configuration, the impact with free feet and the one with held ones."""
    robot = pinimpact.load_robot("solo12")
    model, data = robot.model, robot.data
    ground = pinimpact.Plane(name="ground")
    feet = [pinimpact.Contact(foot, ground, friction=0.6, restitution=0.2, law="energetic") for foot in FEET]
    q = pinimpact.place_in_contact(model, data, robot.q0, feet)
    plate = pinimpact.Plane((0, 0.2, 0), (0, -1, 0), velocity=(0, -1.0, 0), name="plate")
    trunk = pinimpact.Contact(
        "base_link", plate, friction=0.3, restitution=0.2, law="energetic", offset=(0.1, 0.1, 0.0)
    )
    v = np.zeros(model.nv)
    stiff = [name for name in model.names if name.endswith("KFE")]  # motors hold the knees
    free = pinimpact.impact(model, data, q, v, [trunk, *feet], locked=stiff)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pinimpact.HeldContactWarning)  # held feet may pull
        held = pinimpact.impact(model, data, q, v, trunk, held=feet, locked=stiff)
    return q, free, held


def main() -> None:
    """Print the impulse of each foot, and plot the impulses."""
    _, free, held = kick()
    bilateral = held.held_impulses
    print(
        f"trunk: {free.impulses_world[0].round(3)} N s with free feet, {held.impulse_world.round(3)} N s held"
    )
    for i, foot in enumerate(FEET, start=1):
        speed = free.solution.velocity[i]
        does = "lifts" if speed[2] > 1e-9 else "slips" if np.hypot(*speed[:2]) > 1e-9 else "sticks"
        unilateral, hold = free.impulses_world[i].round(3), bilateral[i - 1].round(3)
        pulls = ", which pulls" if hold[2] < 0 else ""
        print(f"{foot}: impulse {unilateral} N s if free, and {does}; {hold} N s if held{pulls}")
    print(f"base: {free.v[:3].round(3)} m/s with free feet, {held.v[:3].round(3) + 0.0} m/s held")
    ax = plt.figure(figsize=(6, 3.5)).add_subplot()
    places = np.arange(4)
    ax.bar(places - 0.2, free.impulses_world[1:, 2], 0.4, label="free to lift and slip")
    ax.bar(places + 0.2, [p[2] for p in bilateral], 0.4, label="held")
    ax.axhline(0.0, color="0.3", lw=0.8)
    ax.set(xticks=places, xticklabels=FEET, ylabel="vertical impulse on the foot [N s]")
    ax.legend()
    ax.figure.tight_layout()
    ax.figure.savefig("kicked_quadruped.png", dpi=110)
    print("Figure: kicked_quadruped.png")


if __name__ == "__main__":
    main()
