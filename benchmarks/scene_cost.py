"""Accuracy against time over the tolerance for three scenes, and the Panda against MuJoCo, in one run.

python benchmarks/scene_cost.py
"""

from __future__ import annotations

import time

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from pinimpact import Contact, Plane, Scene, simulate
from scene_bench import FIGURES, PANDA_START, TABLE, best, panda, save

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
MUJOCO_STEP = 0.002


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
        "Panda that strikes a table once": (panda(), PANDA_START, np.zeros(9), 0.24),
    }


def work_precision() -> dict[str, list[dict[str, float]]]:
    """Return per scene the error at the end against a run at 1e-13, and the time, for each tolerance."""
    figures: dict[str, list[dict[str, float]]] = {}
    for name, (scene, q0, v0, duration) in scenes().items():
        reference = simulate(scene, q0, v0, duration, rtol=1e-13, atol=1e-14)
        figures[name] = []
        for rtol in TOLERANCES:

            def run(rtol: float = rtol):
                return simulate(scene, q0, v0, duration, rtol=rtol, atol=1e-2 * rtol)  # noqa: B023

            seconds = best(run, 0.5)
            end = run()
            way = pin.difference(scene.model, reference.q[-1], end.q[-1])
            error = max(np.abs(way).max(), np.abs(end.v[-1] - reference.v[-1]).max())
            figures[name].append({"rtol": rtol, "error": float(error), "seconds": seconds / duration})
            print(f"{name:44s} rtol {rtol:.0e}  error {error:.2e}  {1e3 * seconds / duration:8.2f} ms/s")
    return figures


def against_mujoco() -> dict[str, float]:
    """Return times per simulated second of the Panda [s], interleaved so that all see the same load."""
    import mujoco

    from mujoco_panda import load, set_state

    other, state = load(TABLE, MUJOCO_STEP)
    model = panda().model
    data, damping = model.createData(), np.array(model.damping)

    def step_mujoco() -> None:
        mujoco.mj_resetData(other, state)
        set_state(other, state, PANDA_START, np.zeros(9))
        for _ in range(round(1.0 / MUJOCO_STEP)):
            mujoco.mj_step(other, state)

    def flow(t: float, y: np.ndarray) -> np.ndarray:
        v = y[9:]
        return np.concatenate([v, pin.aba(model, data, y[:9], v, -damping * v)])

    def bare_scipy() -> None:
        start = np.concatenate([PANDA_START, np.zeros(9)])
        solve_ivp(flow, (0.0, 1.0), start, method="DOP853", rtol=1e-6, atol=1e-8)

    def simulated(scene: Scene):
        return lambda: simulate(scene, PANDA_START, np.zeros(9), 1.0, rtol=1e-6, atol=1e-8)

    limits = ("joint limits",)
    runs = {
        "MuJoCo, 2 ms steps": step_mujoco,
        "bare scipy DOP853 with aba, no events": bare_scipy,
        "pinimpact, table out of play": simulated(panda(without=("contact guards", *limits))),
        "pinimpact, e = 0.5, joints without limits": simulated(panda(without=limits)),
        "pinimpact, e = 0, joints without limits": simulated(panda(restitution=0.0, without=limits)),
        "pinimpact, e = 0.5": simulated(panda()),
    }
    least = dict.fromkeys(runs, np.inf)
    for _ in range(15):
        for name, run in runs.items():
            begin = time.perf_counter()
            run()
            least[name] = min(least[name], time.perf_counter() - begin)
    for name, seconds in least.items():
        print(f"{name:44s} {1e3 * seconds:8.2f} ms/s  {seconds / least['MuJoCo, 2 ms steps']:6.2f} ×")
    return least


def draw(figures: dict[str, list[dict[str, float]]]) -> None:
    figure, axes = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for name, rows in figures.items():
        axes.loglog(
            [1e3 * r["seconds"] for r in rows], [max(r["error"], 1e-16) for r in rows], "o-", label=name
        )
    axes.set_xlabel("time per simulated second [ms]")
    axes.set_ylabel("error at the end [m, rad and their rates]")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=8)
    figure.savefig(FIGURES / "scene_cost.png", dpi=150)


def main() -> None:
    figures = work_precision()
    try:
        comparison = against_mujoco()
    except ImportError:
        comparison = {}
        print("MuJoCo is not installed; pip install mujoco for the comparison")
    print(save("scene_cost", {"work_precision": figures, "seconds_per_simulated_second": comparison}))
    draw(figures)


if __name__ == "__main__":
    main()
