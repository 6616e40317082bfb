"""Newton's cradle and a billiard break: one blow, and the waves that it sends through balls that touch.

The balls are points of the problem's own: no robot is needed to resolve an impact at 31 contacts at once.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pinimpact


def cradle(count: int = 5, restitution: float = 0.97) -> dict[str, np.ndarray]:
    """Return the speeds of a row of equal balls after the first one strikes, by policy."""
    jacobian = np.zeros((3 * (count - 1), count))
    for j in range(count - 1):
        jacobian[3 * j + 2, j : j + 2] = -1.0, 1.0
    start = np.zeros(count)
    start[0] = 1.0
    problem = pinimpact.ImpactProblem(
        jacobian @ jacobian.T, (jacobian @ start).reshape(-1, 3), friction=0.0, restitution=restitution
    )
    found = {}
    for policy in ("propagate", "sequence", "together"):
        solution = pinimpact.solve_impact(problem, simultaneous=policy)
        found[policy] = start + jacobian.T @ solution.impulse.ravel()
    return found


def rack() -> np.ndarray:
    """Return the places (16, 2) of the cue ball and of fifteen balls in a triangle, in diameters."""
    rows = [(np.sqrt(0.75) * k, j - 0.5 * k) for k in range(5) for j in range(k + 1)]
    return np.array([(-1.0, 0.0), *rows])


def blow(
    places: np.ndarray, side: float, friction: float = 0.06, restitution: float = 0.95
) -> tuple[np.ndarray, pinimpact.ManySolution]:
    """Return the velocities (16, 2) after the cue ball strikes, somewhat from the side, and the solution.

    A ball has a mass of one, a diameter of one, and slides and turns on the table, (vx, vy, ω).
    """
    pairs = [
        (i, j) for j in range(16) for i in range(j) if np.linalg.norm(places[i] - places[j]) < 1.0 + 1e-9
    ]
    jacobian = np.zeros((3 * len(pairs), 48))
    for k, (i, j) in enumerate(pairs):
        normal = places[j] - places[i]
        along = np.array([-normal[1], normal[0]])
        for ball, sign in ((i, -1.0), (j, 1.0)):
            jacobian[3 * k + 2, 3 * ball : 3 * ball + 2] = sign * normal
            jacobian[3 * k, 3 * ball : 3 * ball + 2] = sign * along
            jacobian[3 * k, 3 * ball + 2] = -0.5  # both surfaces move the same way when both turn
    inverse = np.tile([1.0, 1.0, 10.0], 16)  # 1/m and 1/(2/5 m r²)
    start = np.zeros(48)
    start[:2] = np.cos(side), np.sin(side)
    problem = pinimpact.ImpactProblem(
        jacobian * inverse @ jacobian.T,
        (jacobian @ start).reshape(-1, 3),
        friction,
        restitution,
        law="energetic",
    )
    solution = pinimpact.solve_impact(problem)
    after = start + inverse * (jacobian.T @ solution.impulse.ravel())
    return after.reshape(16, 3)[:, :2], solution


def draw(places: np.ndarray, breaks: dict[str, np.ndarray], path: Path) -> None:
    """Draw the balls and where they go."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(breaks), figsize=(4.5 * len(breaks), 4.2), squeeze=False)
    for ax, (title, velocity) in zip(axes[0], breaks.items(), strict=True):
        ax.set_aspect("equal")
        ax.set_title(title)
        for place in places:
            ax.add_patch(plt.Circle(place, 0.5, fill=False, color="0.6"))
        ax.quiver(*places.T, *velocity.T, angles="xy", scale_units="xy", scale=0.2, color="C0", width=0.006)
        ax.set(xlim=(-3.5, 6), ylim=(-4.2, 4.2), xticks=[], yticks=[])
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the cradle, and draw two breaks."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--out", type=Path, default=Path("billiard_break.png"))
    out = parser.parse_args().out
    for policy, speeds in cradle().items():
        print(f"cradle, {policy:<9}  {np.round(speeds, 4)}")
    places = rack()
    breaks = {}
    for title, side in (("straight on", 0.0), ("2° from the side", np.radians(2.0))):
        breaks[title], solution = blow(places, side)
        energy = 0.5 - solution.work.total.sum() * -1.0
        print(
            f"break, {title}: {len(solution.impulse)} contacts, {solution.events} events, "
            f"{100 * energy / 0.5:.1f} % of the energy left"
        )
    asymmetry = np.abs(
        np.sort(breaks["straight on"][:, 1]) + np.sort(-breaks["straight on"][:, 1])[::-1]
    ).max()
    print(f"the straight break is its own mirror image to {asymmetry:.0e}")
    draw(places, breaks, out)
    print(f"Figure: {out}")


if __name__ == "__main__":
    main()
