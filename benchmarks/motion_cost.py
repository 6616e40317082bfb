"""Accuracy against run time of whole motions by both schemes, MuJoCo and Drake.

    python -m benchmarks.motion_cost

The error is the largest distance of bodies from their positions in a reference run, at ten times of the
motion. The reference of both schemes of pinimpact is event-driven with rtol = 1e-11 or, for scenes that need
time steps, time stepping with an eighth of the shortest step shown. MuJoCo and Drake have compliant contacts;
the reference of each is its own run with such steps, so their curves show convergence, not the distance of
their limit from rigid contact. Run times are for one thread.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
from benchmarks.everyday import Boxes, dominoes, in_mujoco, may_touch, pile, scene_of
from benchmarks.persistent_contact import GAINS, ORIGINS, over_a_floor, quadruped
from benchmarks.persistent_contact import in_mujoco as robot_in_mujoco
from benchmarks.timing import FIGURES, keep
from matplotlib.figure import Figure
from matplotlib.ticker import StrMethodFormatter

from pinimpact import JointPD, Scene, SteppedWarning, simulate

SAMPLES = 10
EVENTS, TIME_STEPS, OTHERS = "event-driven", "time steps", ("MuJoCo", "Drake")
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)
STEPS = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)
LIMIT = 1e-11
"""Tolerance rtol of reference runs."""
LONGEST = 5.0
"""Run time after which shorter steps and smaller tolerances are omitted [s]."""
FINER = 8
"""Ratio of the shortest step shown to the step of reference runs."""

Path = np.ndarray
"""(SAMPLES, n, 3) positions of bodies [m]."""
Run = Callable[[float], tuple[Path, float]]
"""Computes a motion with a given tolerance or step size; returns it and the run time [s]."""


def times(duration: float) -> np.ndarray:
    return np.linspace(0.0, duration, SAMPLES + 1)[1:]


def positions(model: pin.Model, q: np.ndarray) -> Path:
    """Return the positions of the joints of a model (n, 3)."""
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    return np.array([placement.translation for placement in list(data.oMi)[1:]])


def schemes(scene: Scene, q0: np.ndarray, v0: np.ndarray, duration: float) -> dict[str, Run]:
    """Return runs of a scene by both schemes."""

    def run(**options: Any) -> tuple[Path, float]:
        begun = time.process_time()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SteppedWarning)
            trajectory = simulate(scene, q0, v0, duration, **options)
        seconds = time.process_time() - begun
        return np.array([positions(scene.model, trajectory.at(t)[0]) for t in times(duration)]), seconds

    return {
        EVENTS: lambda rtol: run(rtol=rtol, atol=0.01 * rtol),
        TIME_STEPS: lambda dt: run(scheme="time-stepping", dt=dt),
    }


def steps_of_mujoco(model_at: Callable[[float], mujoco.MjModel], v0: Sequence[float], duration: float) -> Run:
    """Return a run by MuJoCo; velocities that are not given are zero."""

    def run(dt: float) -> tuple[Path, float]:
        model = model_at(dt)
        data = mujoco.MjData(model)
        data.qvel[: len(v0)] = v0
        path, seconds = [], 0.0
        for t in times(duration):
            begun = time.process_time()
            while data.time < t - 0.5 * dt:
                mujoco.mj_step(model, data)
            seconds += time.process_time() - begun
            mujoco.mj_kinematics(model, data)
            path.append(data.xpos[1:].copy())
        return np.array(path), seconds

    return run


def steps_of_drake(boxes: Boxes, pairs: list[tuple[int, int]]) -> Run:
    """Return a run of boxes by Drake's discrete plant, with hydroelastic contact of all pairs."""
    from pydrake.geometry import AddCompliantHydroelasticProperties, AddContactMaterial, ProximityProperties
    from pydrake.geometry import Box as DrakeBox
    from pydrake.math import RigidTransform
    from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
    from pydrake.multibody.tree import SpatialInertia
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder

    def properties(friction: float) -> ProximityProperties:
        found = ProximityProperties()
        AddCompliantHydroelasticProperties(min(boxes.size), 1e7, found)
        AddContactMaterial(dissipation=20.0, friction=CoulombFriction(friction, friction), properties=found)
        return found

    def run(dt: float) -> tuple[Path, float]:
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=dt)
        # Drake's friction of a pair is 2 μ₁ μ₂/(μ₁ + μ₂), which determines the coefficient of the floor
        floor = boxes.floor * boxes.between / max(2.0 * boxes.between - boxes.floor, 1e-9)
        ground = DrakeBox(20.0, 20.0, 1.0)
        below = RigidTransform([0.0, 0.0, -0.5])
        plant.RegisterCollisionGeometry(plant.world_body(), below, ground, "floor", properties(floor))
        bodies = []
        for k in range(len(boxes.places)):
            inertia = SpatialInertia.SolidBoxWithMass(boxes.mass, *boxes.size)
            body = plant.AddRigidBody(f"box {k}", inertia)
            plant.RegisterCollisionGeometry(
                body, RigidTransform(), DrakeBox(*boxes.size), f"box {k}", properties(boxes.between)
            )
            bodies.append(body)
        plant.Finalize()
        diagram = builder.Build()
        simulator = Simulator(diagram)
        context = plant.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        for body, place in zip(bodies, boxes.places, strict=True):
            plant.SetFreeBodyPose(context, body, RigidTransform(place))
        v = np.zeros(6 * len(bodies))
        v[:3], v[3:6] = boxes.first[3:], boxes.first[:3]
        plant.SetVelocities(context, v)
        simulator.Initialize()
        path, seconds = [], 0.0
        for t in times(boxes.duration):
            begun = time.process_time()
            simulator.AdvanceTo(t)
            seconds += time.process_time() - begun
            path.append([plant.EvalBodyPoseInWorld(context, body).translation() for body in bodies])
        return np.array(path), seconds

    return run


def landing() -> dict[str, Run]:
    """Return runs of a solo12 that lands on four feet from 5 cm, with PD control of its joints."""
    model, posture, contacts = quadruped()
    q = posture.copy()
    q[2] += 0.05
    scene = Scene(model, contacts, control=JointPD(*GAINS, posture))

    def bodies(dt: float) -> mujoco.MjModel:
        return over_a_floor(robot_in_mujoco("Solo12Loader", GAINS), q, posture, ORIGINS, dt)

    return schemes(scene, q, np.zeros(model.nv), 0.3) | {OTHERS[0]: steps_of_mujoco(bodies, (), 0.3)}


def of_boxes(boxes: Boxes) -> dict[str, Run]:
    """Return runs of boxes by both schemes, MuJoCo and Drake."""
    pairs = may_touch(boxes)
    scene, q0, v0 = scene_of(boxes, pairs)
    return schemes(scene, q0, v0, boxes.duration) | {
        OTHERS[0]: steps_of_mujoco(lambda dt: in_mujoco(boxes, pairs, dt), boxes.first, boxes.duration),
        OTHERS[1]: steps_of_drake(boxes, pairs),
    }


def sliding() -> Boxes:
    """Return a box that slides and spins on a floor until it stops."""
    places = np.array([(0.0, 0.0, 0.05)])
    first = np.array([1.0, 0.5, 0.0, 0.0, 0.0, 4.0])
    return Boxes("box slides to rest", (0.2, 0.2, 0.1), 1.0, 0.4, 0.4, places, first, 0.5)


def measured(run: Run, settings: Sequence[float], limit: Path) -> list[dict[str, float]]:
    """Return the error [m] and the shortest of three run times [s] for each setting."""
    rows = []
    for setting in settings:
        path, seconds = run(setting)
        if seconds < LONGEST:
            seconds = min(seconds, *(run(setting)[1] for _ in range(2)))
        rows.append({"setting": setting, "error": float(np.abs(path - limit).max()), "seconds": seconds})
        if seconds > LONGEST:
            break
    return rows


def main() -> None:
    regular = {"quadruped lands, 0.3 s": landing(), "box slides to rest, 0.5 s": of_boxes(sliding())}
    crowded = {
        "5 dominoes fall, 0.3 s": of_boxes(dominoes(5)),
        "10 boxes pile up, 0.5 s": of_boxes(pile(10)._replace(duration=0.5)),
    }
    results: dict[str, Any] = {}
    limit = np.empty(0)
    for name, runs in (regular | crowded).items():
        results[name] = {}
        for what, run in runs.items():
            settings = TOLERANCES if what == EVENTS else STEPS
            if what not in (EVENTS, TIME_STEPS):
                limit = run(STEPS[-1] / FINER)[0]
            elif what == EVENTS:
                limit = runs[EVENTS](LIMIT)[0] if name in regular else runs[TIME_STEPS](STEPS[-1] / FINER)[0]
            results[name][what] = measured(run, settings, limit)
        print(table({name: results[name]}), end="", flush=True)
    keep("motion_cost", table(results), {"motions": results})
    draw(results)


def table(results: dict[str, dict[str, list[dict[str, float]]]]) -> str:
    """Return errors and run times of each motion and method as a table."""
    lines = []
    for name, runs in results.items():
        lines.append(name)
        for what, rows in runs.items():
            of = "rtol" if what == EVENTS else "dt [s]"
            lines.append(f"  {what:<14}{of:<9}" + "".join(f"{r['setting']:10.2g}" for r in rows))
            lines.append(f"  {'':<14}error [m]" + "".join(f"{r['error']:10.1e}" for r in rows))
            lines.append(f"  {'':<14}time [ms]" + "".join(f"{1e3 * r['seconds']:10.3g}" for r in rows))
    return "\n".join(lines) + "\n"


def draw(results: dict[str, dict[str, list[dict[str, float]]]]) -> None:
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    panels = figure.subplots(2, 2, sharey=True)
    for axes, (name, runs) in zip(panels.flat, results.items(), strict=True):
        for colour, marker, what in zip(
            ["C0", "C1", "C2", "C3"], "osv^", (EVENTS, TIME_STEPS, *OTHERS), strict=True
        ):
            rows = runs.get(what, [])
            axes.loglog(
                [1e3 * r["seconds"] for r in rows],
                [r["error"] for r in rows],
                f"{marker}-",
                color=colour,
                label=what,
            )
        axes.set_title(name, fontsize=10)
        axes.grid(True, which="major", alpha=0.3)
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    for axes in panels[:, 0]:
        axes.set_ylabel("error [m]")
    for axes in panels[1]:
        axes.set_xlabel("run time [ms]")
    panels[1, 1].legend(fontsize=8, loc="lower left")
    figure.savefig(FIGURES / "motion_cost.png", dpi=150)


if __name__ == "__main__":
    main()
