"""Difference between solutions of Pinocchio's constraint solvers and of the impulse path (e = 0).

python -m benchmarks.other_model
"""

from __future__ import annotations

import numpy as np
from benchmarks.timing import FIGURES
from matplotlib.figure import Figure

from pinimpact import Flag, ImpactProblem, solve_impact
from pinimpact.studies.pinocchio_baseline import SOLVERS, solve_constraint

COUNT = 1000
SIZES = (3, 7)


def draw_problems() -> list[ImpactProblem]:
    """Return random spatial contacts, some planar ones, and some whose slip stops."""
    rng = np.random.default_rng(0)
    problems = []
    for k in range(COUNT):
        X = rng.standard_normal(SIZES)
        v = rng.standard_normal(3)
        v[2] = -abs(v[2])
        if k % 10 == 0:  # planar: no motion along t₂
            X[1], v[1] = 0.0, 0.0
        problems.append(ImpactProblem(X @ X.T / SIZES[1], v, float(rng.choice([0.1, 0.3, 0.6])), 0.0))
    return problems


def regime(flags: Flag) -> str:
    """Return a name for the evolution of slip along the path."""
    if Flag.STICK in flags:
        return "slip stops, stick"
    if Flag.SLIP_RESUMED in flags:
        return "slip stops and resumes"
    return "slip turns" if Flag.SLIP_TURNED in flags else "slip keeps its direction"


def main() -> None:
    """Solve by both, print a line per regime, and plot the difference over the rotation of slip."""
    found: dict[str, list[tuple[float, float, dict[str, float]]]] = {}
    for problem in draw_problems():
        path = solve_impact(problem)
        before, after = np.asarray(problem.velocity)[:2], path.velocity[:2]
        turn = 0.0
        if np.linalg.norm(after) > 0.0:
            turn = abs(np.arctan2(before[0] * after[1] - before[1] * after[0], before @ after))
        apart = {}
        for solver in SOLVERS:
            v, _ = solve_constraint(problem.delassus, problem.velocity, problem.friction, solver)
            apart[solver] = float(np.linalg.norm(v - path.velocity) / np.linalg.norm(problem.velocity))
        found.setdefault(regime(path.flags), []).append((turn, problem.friction, apart))
    lines = [
        f"{'slip on the path':<28}{'problems':>9}  solver {'not solved':>11}{'median':>10}{'largest':>10}"
    ]
    for name, rows in sorted(found.items(), key=lambda item: -len(item[1])):
        for solver in SOLVERS:
            apart = np.array([row[2][solver] for row in rows])
            solved = apart[np.isfinite(apart)]
            lines.append(
                f"{name:<28}{len(rows):>9}  {solver:<7}{len(apart) - len(solved):>11}"
                f"{np.median(solved):>10.1e}{solved.max():>10.1e}"
            )
    table = "\n".join(lines)
    print(table)
    FIGURES.mkdir(parents=True, exist_ok=True)
    (FIGURES / "other_model.txt").write_text(table + "\n", encoding="utf-8")
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for name, rows in found.items():
        axes.semilogy(
            [np.degrees(row[0]) for row in rows],
            [max(row[2]["admm"], 1e-16) for row in rows],
            ".",
            markersize=4,
            label=name,
        )
    axes.set_xlabel("angle between the first and the last slip [°]")
    axes.set_ylabel("|v⁺(ADMM) − v⁺(path)| / |v⁻|")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(FIGURES / "other_model.png", dpi=140)


if __name__ == "__main__":
    main()
