"""Run times of impacts at several contacts: policy "propagate" by accuracy, other policies, many contacts.

python -m benchmarks.many_contacts
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from benchmarks.timing import best_of, keep

import pinimpact
from pinimpact.studies.cost import duration

TOLERANCES = (1e-2, 1e-4, 1e-6, 1e-8, 1e-12, 1e-16)


def cradle(balls: int, restitution: float) -> pinimpact.ImpactProblem:
    """Return the impact of a ball on a row of balls in contact."""
    jacobian = np.zeros((3 * balls - 3, balls))
    for j in range(balls - 1):
        jacobian[3 * j + 2, j : j + 2] = -1.0, 1.0
    velocity = jacobian[:, 0].reshape(-1, 3)
    return pinimpact.ImpactProblem(jacobian @ jacobian.T, velocity, 0.0, restitution, "energetic")


def cube(corners: int) -> pinimpact.ImpactProblem:
    """Return a cube of 10 cm and 1 kg that lands flat on corners² points of a face, spinning and slipping."""
    sides = np.linspace(-0.05, 0.05, corners)
    points = [(x, y, -0.05) for x in sides for y in sides]
    jacobian = np.concatenate([np.hstack([np.eye(3), -pin.skew(np.array(point))]) for point in points])
    inverse = np.diag([1.0] * 3 + [600.0] * 3)
    velocity = (jacobian @ [0.5, 0.1, -1.0, 0.3, 0.2, 0.1]).reshape(-1, 3)
    return pinimpact.ImpactProblem(jacobian @ inverse @ jacobian.T, velocity, 0.5, 0.5, "energetic")


def feet() -> pinimpact.ImpactProblem:
    """Return a quadruped that lands on four feet while it rotates and moves sideways."""
    robot = pinimpact.load_robot("solo12")
    v = np.zeros(robot.model.nv)
    v[:6] = 0.4, 0.1, -1.0, 0.3, 0.2, 0.1
    contacts = [
        pinimpact.Contact(foot, pinimpact.Plane(), friction=0.4, restitution=0.5, law="energetic")
        for foot in ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
    ]
    return pinimpact.impact(robot.model, robot.data, robot.q0, v, contacts).problem


def main() -> None:
    """Measure run times and write the table."""
    lines, figures = [], {}
    for name, problem in (("five balls, no friction", cradle(5, 0.9)), ("four feet, friction", feet())):
        exact = pinimpact.solve_impact(problem).velocity
        calls = {
            f"propagate, rtol {rtol:.0e}": (
                lambda problem=problem, rtol=rtol: pinimpact.solve_impact(
                    problem, simultaneous="propagate", rtol=rtol
                )
            )
            for rtol in TOLERANCES
        }
        calls |= {
            policy: (
                lambda problem=problem, policy=policy: pinimpact.solve_impact(problem, simultaneous=policy)
            )
            for policy in ("sequence", "any")
        }
        seconds = best_of(calls, rounds=30)
        lines.append(f"{name:<36}{'time':>10}{'difference from propagate, 1e-16':>36}")
        for what, taken in seconds.items():
            error = float(np.abs(calls[what]().velocity - exact).max() / np.abs(exact).max())
            lines.append(f"  {what:<34}{duration(taken):>10}{error:>36.1e}")
            figures[f"{name}: {what}"] = {"seconds": taken, "difference": error}
    many = {f"cube on {k * k} points, friction": cube(k) for k in (4, 5, 6)}
    many |= {f"row of 64 balls, e = {e}": cradle(64, e) for e in (1.0, 0.9, 0.5)}
    solve = pinimpact.solve_impact
    seconds = best_of({name: lambda one=one: solve(one) for name, one in many.items()}, rounds=5)
    lines.append("many contacts")
    for name, taken in seconds.items():
        lines.append(f"  {name:<34}{duration(taken):>10}")
        figures[name] = {"seconds": taken}
    keep("many_contacts", "\n".join(lines) + "\n", {"rows": figures})


if __name__ == "__main__":
    main()
