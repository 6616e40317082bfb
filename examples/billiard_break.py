"""Newton's cradle and a billiard break: simultaneous impacts of balls in contact.

The break has 31 contacts. No robot is needed: masses, positions and contact directions define the problem.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np

import pinimpact


def cradle(policy: str, count: int = 5, restitution: float = 0.97) -> np.ndarray:
    """Return the speeds of a row of equal balls after the impact of the first one."""
    jacobian = np.zeros((3 * (count - 1), count))
    for j in range(count - 1):
        jacobian[3 * j + 2, j : j + 2] = -1.0, 1.0
    start = np.eye(count)[0]
    velocity = (jacobian @ start).reshape(-1, 3)
    problem = pinimpact.ImpactProblem(jacobian @ jacobian.T, velocity, friction=0.0, restitution=restitution)
    return start + jacobian.T @ pinimpact.solve_impact(problem, simultaneous=policy).impulse.ravel()


def rack() -> np.ndarray:
    """Return the positions (16, 2) of the cue ball and of fifteen balls in a triangle, in ball diameters."""
    rows = [(np.sqrt(0.75) * k, j - 0.5 * k) for k in range(5) for j in range(k + 1)]
    return np.array([(-1.0, 0.0), *rows])


def strike(places: np.ndarray, side: float) -> tuple[np.ndarray, pinimpact.ManySolution]:
    """Return the velocities (16, 2) after the cue ball strikes at an angle, and the solution.

    Balls have unit mass and diameter; their velocities on the table are (vx, vy, ω).
    """
    near = [(i, j) for j in range(16) for i in range(j) if np.linalg.norm(places[i] - places[j]) < 1 + 1e-9]
    jacobian = np.zeros((3 * len(near), 48))
    for k, (i, j) in enumerate(near):
        normal = places[j] - places[i]
        for ball, sign in ((i, -1.0), (j, 1.0)):
            jacobian[3 * k + 2, 3 * ball : 3 * ball + 2] = sign * normal
            jacobian[3 * k, 3 * ball : 3 * ball + 2] = sign * np.array([-normal[1], normal[0]])
            jacobian[3 * k, 3 * ball + 2] = -0.5  # equal spins move the surfaces in opposite directions
    inverse = np.tile([1.0, 1.0, 10.0], 16)  # 1/m and 1/(2/5 m r²)
    start = np.zeros(48)
    start[:2] = np.cos(side), np.sin(side)
    problem = pinimpact.ImpactProblem(
        jacobian * inverse @ jacobian.T,
        (jacobian @ start).reshape(-1, 3),
        friction=0.06,
        restitution=0.95,
        law="energetic",
    )
    solution = pinimpact.solve_impact(problem)
    after = start + inverse * (jacobian.T @ solution.impulse.ravel())
    return after.reshape(16, 3)[:, :2], solution


def main() -> None:
    """Print the cradle, and draw two breaks."""
    print("cradle: speeds of five balls after the first one has struck at a speed of 1, with e = 0.97")
    for policy in ("propagate", "sequence", "together"):
        print(f"  {policy:<9}  {np.round(cradle(policy), 4)}")
    places = rack()
    figure, axes = plt.subplots(1, 2, figsize=(9, 4.2))
    for ax, title, side in zip(axes, ("straight on", "at 20°"), (0.0, np.radians(20.0)), strict=True):
        velocity, solution = strike(places, side)
        left, fastest = 1.0 + solution.work.total.sum() / 0.5, np.linalg.norm(velocity[1:], axis=1).max()
        print(
            f"break, {title}: {len(solution.impulse)} contacts, {100 * left:.1f} % of the energy left; "
            f"the fastest ball has {fastest:.2f} of the speed of the cue ball"
        )
        ax.set(title=title, aspect="equal", xlim=(-3.5, 6), ylim=(-4.2, 4.2), xticks=[], yticks=[])
        for place in places:
            ax.add_patch(plt.Circle(place, 0.5, fill=False, color="0.6"))
        ax.quiver(*places.T, *velocity.T, angles="xy", scale_units="xy", scale=0.2, color="C0", width=0.006)
    figure.tight_layout()
    figure.savefig("billiard_break.png", dpi=110)
    print("Figure: billiard_break.png")


if __name__ == "__main__":
    main()
