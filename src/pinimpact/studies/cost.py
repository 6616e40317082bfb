"""Benchmark of accuracy against run time, for every method over its steps or tolerances."""

from __future__ import annotations

import json
import math
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ..contact_space.laws import law_code
from ..contact_space.methods import LEAST_RTOL, METHODS
from ..contact_space.problem import ImpactProblem, delassus_upper
from ..contact_space.solution import Solution
from ..contact_space.solve import solve_impact
from ..errors import InputError, PinimpactError
from ..tables import nulls

SETTINGS: dict[str, tuple[dict[str, Any], ...]] = {
    "euler": tuple({"steps": n} for n in (10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)),
    "rk4": tuple({"steps": n} for n in (3, 10, 30, 100, 300, 1000, 3000)),
    "adaptive": tuple({"rtol": 10.0**-k} for k in range(2, 14)),
    "solve_ivp": tuple({"rtol": 10.0**-k} for k in range(3, 13)),
}
"""Options with which each method is measured; a method without an entry is measured with its defaults."""

TIGHTEST: dict[str, Any] = {"method": "adaptive", "rtol": LEAST_RTOL}
"""Reference of "exact"; that of every other method is "exact"."""

STYLES: dict[str, dict[str, Any]] = {
    "exact": {"marker": "*", "color": "#d62728", "markersize": 12},
    "euler": {"marker": "o", "color": "#1f77b4"},
    "rk4": {"marker": "s", "color": "#2ca02c"},
    "adaptive": {"marker": "D", "color": "#9467bd"},
    "solve_ivp": {"marker": "x", "color": "#7f7f7f"},
    "admm": {"marker": "P", "color": "#ff7f0e", "markersize": 6},
    "pgs": {"marker": "X", "color": "#ff7f0e", "markersize": 6},
}
"""Plot styles of methods and of Pinocchio's solvers."""

TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)
"""Errors for which the summary gives the shortest run time."""

BATCH = 2e-4
"""Minimum duration of one timing [s]; shorter calls are repeated."""


def problem_classes() -> dict[str, ImpactProblem]:
    """Return the standard problems, one for each regime of impacts."""
    skewed = np.array([[1.3, 0.2, 0.4], [0.2, 0.8, -0.3], [0.4, -0.3, 0.9]])
    s, c = math.sin(0.46), math.cos(0.46)
    rod = np.array(
        [[4.0, 0.0, 0.0], [0.0, 1.0 + 3.0 * s * s, -3.0 * s * c], [0.0, -3.0 * s * c, 1.0 + 3.0 * c * c]]
    )
    stick = 3.0 * s * c / (1.0 + 3.0 * s * s)
    jam = np.array([[1.2, 0.0, 1.0], [0.0, 8.0, 0.0], [1.0, 0.0, 1.0]])
    planar = np.array([[1.5, 0.0, 0.6], [0.0, 0.0, 0.0], [0.6, 0.0, 0.9]])
    # fast enough for slip to end in restitution only: the compression impulse then depends on the path
    start = (0.9, 0.9 * math.sqrt(3.0), -2.0)
    # −t₁ is an unstable invariant direction here, so slip that starts near it turns back
    symmetric = np.array([[1.2, 0.0, 0.5], [0.0, 0.4, 0.0], [0.5, 0.0, 0.9]])
    return {
        "smooth slip": ImpactProblem(skewed, (1.0, 0.7, -1.0), 0.3, 0.5),
        "slip to stick": ImpactProblem(rod, start, 1.1, 0.8),
        "resumed slip": ImpactProblem(rod, start, 0.7, 0.8),
        "near-critical friction": ImpactProblem(rod, start, stick * (1.0 - 1e-6), 0.8),
        "near-invariant start": ImpactProblem(symmetric, (-1.0, 1e-4, -1.0), 0.3, 0.5),
        "jam": ImpactProblem(jam, (0.5, 12.0, -0.6), 1.5, 0.5),
        "planar": ImpactProblem(planar, (0.3, 0.0, -1.0), 0.3, 0.5),
        "frictionless": ImpactProblem(skewed, (1.0, 0.7, -1.0), 0.0, 0.5),
    }


@dataclass(frozen=True, slots=True)
class Point:
    """The measurement of one method at one setting on one problem."""

    problem: str
    method: str
    setting: dict[str, Any]  # options of the method
    error: float  # the larger of the errors of v⁺ over |v⁻| and of P over |P|; NaN where the method failed
    seconds: float  # run time of the kernel, called from compiled code [s]; NaN for a method without kernel
    call_seconds: float  # run time of `solve_impact`, called from Python [s]

    @property
    def cost(self) -> float:
        """The run time of the kernel, or of the call for a method without kernel [s]."""
        return self.call_seconds if math.isnan(self.seconds) else self.seconds

    def __str__(self) -> str:
        setting = ", ".join(f"{name}={value:g}" for name, value in self.setting.items())
        return f"{self.method}({setting})"


@dataclass(frozen=True, slots=True)
class Contrast:
    """Difference of the final state by a solver of Pinocchio from that of "exact", at e = 0."""

    problem: str
    solver: str  # Pinocchio's solver
    turned: str  # effects on the path: turning, stopping or resuming slip, jam
    velocity: float  # difference of v⁺ over |v⁻|
    impulse: float  # difference of P over |P|
    call_seconds: float  # run time of the call [s]


@dataclass(frozen=True, slots=True)
class Report:
    """Measurements, with tables, plots and files."""

    points: tuple[Point, ...]
    contrasts: tuple[Contrast, ...]
    machine: dict[str, Any]

    @property
    def problems(self) -> tuple[str, ...]:
        """Names of the problems, in the order measured."""
        return tuple(dict.fromkeys(point.problem for point in self.points))

    def table(self) -> str:
        """Return error and time of every point as text."""
        lines = []
        for problem in self.problems:
            lines += [problem, f"  {'method':<26}{'error':>10}{'kernel':>12}{'from Python':>14}"]
            lines += [
                f"  {point!s:<26}{point.error:>10.1e}{duration(point.seconds):>12}"
                f"{duration(point.call_seconds):>14}"
                for point in self.points
                if point.problem == problem
            ]
        if self.contrasts:
            lines += [
                "",
                "Another model: Pinocchio's constraint solvers at e = 0, compared with the final state",
            ]
            lines += [f"  {'problem':<26}{'solver':<8}{'Δv⁺':>10}{'ΔP':>10}  slip on the path"]
            lines += [
                f"  {c.problem:<26}{c.solver:<8}{c.velocity:>10.1e}{c.impulse:>10.1e}  {c.turned}"
                for c in self.contrasts
            ]
        return "\n".join(lines)

    def summary(self) -> str:
        """Return the run time of each method within each of `TARGETS`, and `contrasts`, as text."""
        count = len(self.problems)
        lines = [
            f"Run time of the fastest setting within an error, median over {count} "
            f"problem{'' if count == 1 else 's'} (number of problems, if not all)",
            f"  {'method':<14}" + "".join(f"{target:>16.0e}" for target in TARGETS),
        ]
        for method in dict.fromkeys(point.method for point in self.points):
            cells = []
            for target in TARGETS:
                costs = [point.cost for point in self.cheapest(target, method) if point is not None]
                reached = "" if len(costs) in (0, count) else f" ({len(costs)}/{count})"
                cells.append(f"{duration(float(np.median(costs))) if costs else '–'}{reached}")
            lines.append(f"  {method:<14}" + "".join(f"{cell:>16}" for cell in cells))
        for solver in dict.fromkeys(contrast.solver for contrast in self.contrasts):
            differences = [max(c.velocity, c.impulse) for c in self.contrasts if c.solver == solver]
            lines.append(
                f"Another model: Pinocchio's {solver.upper()} at e = 0 differs from the final "
                f"state by {min(differences):.1e} to {max(differences):.1e}"
            )
        lines.append(
            f"{len(self.points)} points were measured; --all prints them, --target the fastest for an error."
        )
        return "\n".join(lines)

    def cheapest(self, target: float, method: str | None = None) -> tuple[Point | None, ...]:
        """Return for each problem the fastest point with an error of at most `target`, or None.

        Args:
            target: Largest error, > 0.
            method: Method of the points; None for all methods.
        """
        if not 0.0 < target < math.inf:
            raise InputError(f"target: {target!r} given, a number > 0 expected", value=target)
        good = [p for p in self.points if p.error <= target and method in (None, p.method)]
        return tuple(
            min((p for p in good if p.problem == problem), key=lambda point: point.cost, default=None)
            for problem in self.problems
        )

    def advice(self, target: float) -> str:
        """Return the fastest method and setting with an error of at most `target`, as text."""
        lines = [f"cheapest within an error of {target:g}"]
        for problem, point in zip(self.problems, self.cheapest(target), strict=True):
            found = "no method reaches it"
            if point is not None:
                found = f"{point!s:<26}{point.error:>10.1e}{duration(point.cost):>12}"
            lines.append(f"  {problem:<26}{found}")
        return "\n".join(lines)

    def save(self, path: str | Path) -> None:
        """Write the measurements as JSON (NaN as null)."""
        raw = {
            "machine": self.machine,
            "points": [asdict(point) for point in self.points],
            "contrasts": [asdict(contrast) for contrast in self.contrasts],
        }
        Path(path).write_text(json.dumps(nulls(raw), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")

    def plot(self, path: str | Path) -> None:
        """Draw a work-precision diagram as PNG, with a panel for each problem."""
        from ..visual.work_precision import draw_work_precision

        panels: dict[str, list[tuple[str, list[tuple[float, float]], dict[str, Any]]]] = {}
        for problem in self.problems:
            curves = panels[problem] = []
            for method in dict.fromkeys(point.method for point in self.points):
                points = [p for p in self.points if (p.problem, p.method) == (problem, method)]
                curves.append((method, [(p.cost, p.error) for p in points], STYLES.get(method, {})))
            for c in self.contrasts:
                if c.problem == problem:
                    label = f"Pinocchio {c.solver.upper()} (another model, e = 0)"
                    curves.append((label, [(c.call_seconds, max(c.velocity, c.impulse))], STYLES[c.solver]))
        draw_work_precision(panels, path)


def run_cost(
    problems: Mapping[str, ImpactProblem] | None = None,
    methods: Iterable[str] | None = None,
    repeats: int = 20,
    time_cap: float = 2.0,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Measure errors and run times; they are NaN for a method that fails on a problem.

    Args:
        problems: Problems by name; None for `problem_classes`.
        methods: Names of methods; None for all.
        repeats: Maximum number of timings of each point, of which the shortest counts.
        time_cap: Time after which a point is not timed again [s]. If a single call takes longer, the further
            settings of its method are skipped.
        progress: Function that is called with the name of each problem before it is measured.

    Raises:
        PinimpactError: A problem without a solution, or an unknown method.
    """
    points: list[Point] = []
    contrasts: list[Contrast] = []
    for name, problem in (problem_classes() if problems is None else problems).items():
        if progress is not None:
            progress(name)
        exact, tight = solve_impact(problem), solve_impact(problem, **TIGHTEST)
        for method in METHODS if methods is None else methods:
            reference = tight if method == "exact" else exact
            for setting in SETTINGS.get(method, ({},)):
                point = _measure(name, problem, method, setting, reference, repeats, time_cap)
                points.append(point)
                if point.call_seconds > time_cap:
                    break
        contrasts += _contrasts(name, problem, repeats, time_cap)
    return Report(tuple(points), tuple(contrasts), machine())


def relative_error(solution: Solution, reference: Solution, problem: ImpactProblem) -> float:
    """Return the larger of the error of v⁺ over |v⁻| and of P over |P|."""
    size = float(np.linalg.norm(reference.impulse)) or 1.0
    return max(
        float(np.linalg.norm(solution.velocity - reference.velocity) / np.linalg.norm(problem.velocity)),
        float(np.linalg.norm(solution.impulse - reference.impulse)) / size,
    )


def best_time(call: Callable[[int], Any], repeats: int, time_cap: float) -> float:
    """Return the shortest run time of ``call(count)`` divided by the count [s]."""
    begun = time.perf_counter()
    call(1)
    once = time.perf_counter() - begun
    count = math.ceil(BATCH / once) if once > 0.0 else 1
    best = once
    for _ in range(repeats):
        now = time.perf_counter()
        if now - begun > time_cap:
            break
        call(count)
        best = min(best, (time.perf_counter() - now) / count)
    return best


def _measure(
    name: str,
    problem: ImpactProblem,
    method: str,
    setting: dict[str, Any],
    reference: Solution,
    repeats: int,
    time_cap: float,
) -> Point:
    def call(count: int) -> None:
        for _ in range(count):
            solve_impact(problem, method, **setting)

    try:
        error = relative_error(solve_impact(problem, method, **setting), reference, problem)
    except PinimpactError:
        if method not in METHODS:
            raise
        return Point(name, method, setting, math.nan, math.nan, math.nan)
    kernel = _kernel(problem, method, setting)
    seconds = best_time(kernel, repeats, time_cap) if kernel else math.nan
    return Point(name, method, setting, error, seconds, best_time(call, repeats, time_cap))


def _kernel(problem: ImpactProblem, method: str, setting: dict[str, Any]) -> Callable[[int], Any] | None:
    """Return a function (count) that solves the problem in compiled code; None if there is no kernel."""
    from ..contact_space._kernels.butcher import DORMAND_PRINCE, EULER, RK4
    from ..contact_space._kernels.timing import repeat_exact, repeat_stepping
    from ..contact_space.methods import FIRST_STEPS

    v1, v2, v3 = map(float, np.asarray(problem.velocity))
    numbers = (*delassus_upper(problem.delassus), v1, v2, v3, float(problem.friction))
    inputs = (*numbers, float(problem.restitution), law_code(problem.law))

    tables = {"exact": None, "euler": EULER, "rk4": RK4, "adaptive": DORMAND_PRINCE}
    if method not in tables:
        return None

    def call(count: int) -> None:
        if method == "exact":
            repeat_exact(count, *inputs)
        else:
            steps, rtol = setting.get("steps", FIRST_STEPS), setting.get("rtol", 0.0)
            repeat_stepping(count, *inputs, tables[method], steps, rtol)

    call(1)
    return call


def _contrasts(name: str, problem: ImpactProblem, repeats: int, time_cap: float) -> list[Contrast]:
    from .pinocchio_baseline import SOLVERS, solve_constraint

    plastic = ImpactProblem(problem.delassus, problem.velocity, problem.friction, 0.0)
    path = solve_impact(plastic)
    events = [effect for effect in path.effects if effect in ("spatial slip", "stick", "resumed slip", "jam")]
    found = []
    for solver in SOLVERS:

        def call(count: int, solver: str = solver) -> None:
            for _ in range(count):
                solve_constraint(problem.delassus, problem.velocity, problem.friction, solver)

        velocity, impulse = solve_constraint(problem.delassus, problem.velocity, problem.friction, solver)
        found.append(
            Contrast(
                name,
                solver,
                ", ".join(events) or "straight",
                float(np.linalg.norm(velocity - path.velocity) / np.linalg.norm(problem.velocity)),
                float(np.linalg.norm(impulse - path.impulse) / (np.linalg.norm(path.impulse) or 1.0)),
                best_time(call, repeats, time_cap),
            )
        )
    return found


def machine() -> dict[str, Any]:
    """Return a description of the machine and the versions of packages."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.split(":")[1].strip() for line in info.read_text().splitlines() if "model name" in line
        ]
        cpu = models[0] if models else cpu
    packages = ("pinimpact", "pin", "numba", "llvmlite", "numpy", "scipy")
    return {
        "cpu": cpu,
        "cores": os.cpu_count(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "packages": {package: version(package) for package in packages},
    }


def duration(seconds: float) -> str:
    """Return a time [s] as text in s, ms, µs or ns."""
    if math.isnan(seconds):
        return "–"
    for unit in ("s", "ms", "µs"):
        if seconds >= 1.0:
            return f"{seconds:.3g} {unit}"
        seconds *= 1000.0
    return f"{seconds:.3g} ns"
