"""Accuracy against run time of three scenes for various tolerances, and run time of a Panda against MuJoCo.

python -m benchmarks.scene_cost
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin
from benchmarks.panda_scene import START, STILL, TABLE, panda
from benchmarks.timing import FIGURES, best_of, keep, publish, row
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from scipy.integrate import solve_ivp

from pinimpact import Contact, Plane, Scene, simulate

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
MUJOCO_STEP = 0.002
GOAL = 4.0


def free_body(inertia: pin.Inertia, tips: tuple[tuple[float, float, float], ...] = ()) -> pin.Model:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    for k, point in enumerate(tips):
        placement = pin.SE3(np.eye(3), np.array(point))
        model.addFrame(pin.Frame(f"tip{k}", joint, 0, placement, pin.FrameType.OP_FRAME))
    return model


def scenes() -> dict[str, tuple[Scene, np.ndarray, np.ndarray, float]]:
    rod = free_body(
        pin.Inertia(1.0, np.zeros(3), np.diag([1e-4, 1 / 12, 1 / 12])), ((-0.5, 0, 0), (0.5, 0, 0))
    )
    tips = [Contact(f"tip{k}", Plane(), friction=0.4, restitution=0.5, radius=0.01) for k in range(2)]
    tilted = pin.Quaternion(pin.utils.rotate("y", 0.3)).coeffs()
    body = free_body(pin.Inertia(2.0, np.zeros(3), np.diag([0.01, 0.02, 0.03])))
    return {
        "rod that falls on one tip, then the other": (
            Scene(rod, tips),
            np.array([0, 0, 0.5, *tilted]),
            np.zeros(6),
            0.5,
        ),
        "tumbling body in flight": (
            Scene(body),
            np.array([0, 0, 0, 0, 0, 0, 1.0]),
            np.array([1.0, 0, 3.0, 0.1, 5.0, 0.1]),
            2.0,
        ),
        "Panda that strikes a table once": (panda(), START, STILL, 0.24),
    }


def work_precision() -> dict[str, list[dict[str, float]]]:
    """Return, for each scene and tolerance, the final error relative to a run at 1e-13 and the run time."""
    figures: dict[str, list[dict[str, float]]] = {}
    for name, (scene, q0, v0, duration) in scenes().items():
        reference = simulate(scene, q0, v0, duration, rtol=1e-13, atol=1e-14)
        runs = {
            rtol: partial(simulate, scene, q0, v0, duration, rtol=rtol, atol=1e-2 * rtol)
            for rtol in TOLERANCES
        }
        seconds = best_of(runs, rounds=20)
        figures[name] = []
        for rtol, run in runs.items():
            end = run()
            way = pin.difference(scene.model, reference.q[-1], end.q[-1])
            error = max(np.abs(way).max(), np.abs(end.v[-1] - reference.v[-1]).max())
            figures[name].append({"rtol": rtol, "error": float(error), "seconds": seconds[rtol] / duration})
    return figures


def table(figures: dict[str, list[dict[str, float]]]) -> str:
    """Return errors and milliseconds per simulated second of each scene and tolerance as a table."""
    lines = []
    for name, rows in figures.items():
        lines.append(f"{name}\n  rtol    " + "".join(f"{r['rtol']:9.0e}" for r in rows))
        lines.append("  error   " + "".join(f"{r['error']:9.1e}" for r in rows))
        lines.append("  ms per s" + "".join(f"{1e3 * r['seconds']:9.1f}" for r in rows))
    return "\n".join(lines) + "\n"


def against_mujoco() -> None:
    """Publish times per simulated second of the Panda, interleaved so that all see the same load."""
    import mujoco
    from benchmarks.mujoco_panda import load, set_state

    def mujoco_steps(limits: bool) -> None:
        other, state = loaded[limits]
        mujoco.mj_resetData(other, state)
        set_state(other, state, START, STILL)
        for _ in range(round(1.0 / MUJOCO_STEP)):
            mujoco.mj_step(other, state)

    loaded = {limits: load(TABLE, MUJOCO_STEP) for limits in (False, True)}
    loaded[False][0].jnt_limited[:] = 0
    model = panda().model
    data, damping = model.createData(), np.array(model.damping)

    def flow(t: float, y: np.ndarray) -> np.ndarray:
        v = y[9:]
        return np.concatenate([v, pin.aba(model, data, y[:9], v, -damping * v)])

    def bare_scipy() -> None:
        y0 = np.concatenate([START, STILL])
        solve_ivp(flow, (0.0, 1.0), y0, method="DOP853", rtol=1e-6, atol=1e-8)

    def simulated(**options):
        return partial(simulate, panda(**options), START, STILL, 1.0, rtol=1e-6, atol=1e-8)

    stops = ("joint limits",)
    against = {
        "MuJoCo without joint stops": partial(mujoco_steps, False),
        "MuJoCo with joint stops": partial(mujoco_steps, True),
    }
    runs = {
        "table out of play": (simulated(without=("contact guards", *stops)), False, None),
        "e = 0.5": (simulated(without=stops), False, GOAL),
        "e = 0": (simulated(restitution=0.0, without=stops), False, GOAL),
        "e = 0.5, joint stops": (simulated(), True, GOAL),
        "e = 0, joint stops": (simulated(restitution=0.0), True, GOAL),
        "bare scipy DOP853 with aba, no events": (bare_scipy, False, None),
    }
    seconds = best_of({**against, **{name: run for name, (run, _, _) in runs.items()}}, rounds=30)
    names = list(against)
    publish(
        "scene_mujoco",
        [
            row(name, seconds[name], goal, names[limits], seconds[names[limits]])
            for name, (_, limits, goal) in runs.items()
        ],
    )


def draw(figures: dict[str, list[dict[str, float]]]) -> None:
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    for name, rows in figures.items():
        milliseconds, errors = [1e3 * r["seconds"] for r in rows], [max(r["error"], 1e-16) for r in rows]
        axes.loglog(milliseconds, errors, "o-", label=name)
    axes.set_xlabel("time per simulated second [ms]")
    axes.set_ylabel("error at the end [m, rad and their rates]")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(FIGURES / "scene_cost.png", dpi=150)


def main() -> None:
    figures = work_precision()
    keep("scene_cost", table(figures), {"scenes": figures})
    draw(figures)
    try:
        against_mujoco()
    except ImportError:
        print("MuJoCo is not installed; pip install mujoco for the comparison")


if __name__ == "__main__":
    main()
