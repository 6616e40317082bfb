"""Run times of everyday scenes by both schemes and by MuJoCo: dominoes, stacks, piles and separate boxes.

    python benchmarks/everyday.py

The table has seconds of run time per second of motion. Time stepping and MuJoCo use 1 ms steps on one thread,
with the same masses, sizes, friction and initial states. MuJoCo (elliptic cones, Newton's method) has soft
contacts, so run times are compared, not results. Time stepping skips bodies at rest: standing boxes, and
separate boxes after they have landed. The default scheme locates events where it can, and compares two step
sizes where it takes time steps.
"""

from __future__ import annotations

import itertools
import math
import time
import warnings
from typing import NamedTuple

import coal
import mujoco
import numpy as np
import pinocchio as pin
from benchmarks.timing import keep

from pinimpact import Contact, Plane, Scene, Shape, SteppedWarning, simulate

STEP = 1e-3

RUNS = 3
"""Number of runs of each scene; the table has the shortest run time, as the first run loads kernels. The
default scheme runs once, after a short run."""


class Boxes(NamedTuple):
    """Free boxes on a floor.

    Attributes:
        name: Name in the table.
        size: (3,) edges [m].
        mass: Mass of each box [kg].
        floor, between: Coefficients of friction with the floor and between boxes.
        places: (n, 3) initial centres [m].
        first: (6,) initial velocity of the first box.
        duration: Duration of the motion [s].
        restitution: Coefficient of all contacts; MuJoCo's contacts have none.
    """

    name: str
    size: tuple[float, float, float]
    mass: float
    floor: float
    between: float
    places: np.ndarray
    first: np.ndarray
    duration: float
    restitution: float = 0.0


def dominoes(count: int) -> Boxes:
    thick, high, rate = 0.008, 0.048, 6.0
    places = np.array([(0.028 * k, 0.0, 0.5 * high) for k in range(count)])
    first = np.array([0.5 * rate * high, 0, 0.5 * rate * thick, 0, rate, 0])
    return Boxes(
        f"{count} dominoes fall", (thick, 0.024, high), 0.01, 0.6, 0.3, places, first, 0.1 + 0.04 * count
    )


def stack(count: int) -> Boxes:
    places = np.array([(0.0, 0.0, 0.05 + 0.1 * k) for k in range(count)])
    return Boxes(f"{count} boxes stand", (0.2, 0.2, 0.1), 1.0, 0.5, 0.5, places, np.zeros(6), 1.0)


def with_restitution(boxes: Boxes, e: float) -> Boxes:
    return boxes._replace(name=f"{boxes.name}, e = {e:g}", restitution=e)


def pile(count: int) -> Boxes:
    rng = np.random.default_rng(0)
    places = np.array([(*rng.normal(0.0, 0.05, 2), 0.06 + 0.13 * k) for k in range(count)])
    return Boxes(f"{count} boxes pile up", (0.2, 0.2, 0.1), 1.0, 0.5, 0.5, places, np.zeros(6), 3.0)


def apart(count: int) -> Boxes:
    side = int(np.ceil(np.sqrt(count)))
    places = np.array([(0.5 * (k % side), 0.5 * (k // side), 0.06) for k in range(count)])
    return Boxes(f"{count} boxes apart", (0.2, 0.2, 0.1), 1.0, 0.5, 0.5, places, np.zeros(6), 1.0)


def scene_of(boxes: Boxes, pairs: list[tuple[int, int]]) -> tuple[Scene, np.ndarray, np.ndarray]:
    """Return the scene of boxes with contacts of the given pairs, and its initial q and v."""
    model, shapes = pin.Model(), pin.GeometryModel()
    size = np.array(boxes.size)
    inertia = boxes.mass / 12.0 * np.diag(np.sum(size**2) - size**2)
    contacts = []
    for k in range(len(boxes.places)):
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), f"box_{k}")
        model.appendBodyToJoint(joint, pin.Inertia(boxes.mass, np.zeros(3), inertia), pin.SE3.Identity())
        model.addJointFrame(joint)
        shapes.addGeometryObject(pin.GeometryObject(f"box_{k}_0", joint, pin.SE3.Identity(), coal.Box(*size)))
        contacts.append(
            Contact(
                geometry=f"box_{k}_0",
                plane=Plane(),
                friction=boxes.floor,
                restitution=boxes.restitution,
                name=f"floor {k}",
            )
        )
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -np.inf, np.inf
    for i, j in pairs:
        other = Shape(f"box_{i}_0")
        contacts.append(
            Contact(
                geometry=f"box_{j}_0",
                plane=other,
                friction=boxes.between,
                restitution=boxes.restitution,
                name=f"pair {i} {j}",
            )
        )
    q0 = np.hstack([boxes.places, np.tile([0, 0, 0, 1.0], (len(boxes.places), 1))]).ravel()
    v0 = np.zeros(model.nv)
    v0[:6] = boxes.first
    return Scene(model, contacts, geometry=shapes), q0, v0  # not a RobotWrapper, whose Data has nv³ numbers


def time_pinimpact(boxes: Boxes, pairs: list[tuple[int, int]]) -> tuple[float, str]:
    """Return the run time of pinimpact [s], and the notes of the trajectory."""
    scene, q0, v0 = scene_of(boxes, pairs)
    seconds = math.inf
    for _ in range(RUNS):
        begun = time.process_time()
        run = simulate(scene, q0, v0, boxes.duration, scheme="time-stepping", dt=STEP)
        seconds = min(seconds, time.process_time() - begun)
    return seconds, "; ".join(note.text for note in run.notes)


def time_default(boxes: Boxes, pairs: list[tuple[int, int]]) -> float:
    """Return the run time of pinimpact with the default scheme [s]."""
    scene, q0, v0 = scene_of(boxes, pairs)
    begun = math.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SteppedWarning)
        for duration in (0.01, boxes.duration):
            begun = time.process_time()
            simulate(scene, q0, v0, duration)
    return time.process_time() - begun


def in_mujoco(boxes: Boxes, pairs: list[tuple[int, int]], step: float = STEP) -> mujoco.MjModel:
    """Return the model of the boxes in MuJoCo."""
    half = " ".join(str(0.5 * x) for x in boxes.size)
    bodies = "".join(
        f'<body name="b{k}" pos="{x} {y} {z}"><freejoint/><geom name="g{k}" type="box" size="{half}" '
        f'mass="{boxes.mass}" contype="0" conaffinity="0"/></body>'
        for k, (x, y, z) in enumerate(boxes.places.tolist())
    )
    touching = [("floor", f"g{k}", boxes.floor) for k in range(len(boxes.places))]
    touching += [(f"g{i}", f"g{j}", boxes.between) for i, j in pairs]
    contact = "".join(
        f'<pair geom1="{a}" geom2="{b}" friction="{mu} {mu} 0 0 0" condim="3"/>' for a, b, mu in touching
    )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{step}" cone="elliptic"/><worldbody><geom name="floor" type="plane" '
        f'size="50 50 1" contype="0" conaffinity="0"/>{bodies}</worldbody>'
        f"<contact>{contact}</contact></mujoco>"
    )


def time_mujoco(boxes: Boxes, pairs: list[tuple[int, int]]) -> float:
    """Return the run time of MuJoCo [s]."""
    model, seconds = in_mujoco(boxes, pairs), math.inf
    for _ in range(RUNS):
        data = mujoco.MjData(model)
        data.qvel[:6] = boxes.first
        begun = time.process_time()
        for _ in range(round(boxes.duration / STEP)):
            mujoco.mj_step(model, data)
        seconds = min(seconds, time.process_time() - begun)
    return seconds


def may_touch(boxes: Boxes) -> list[tuple[int, int]]:
    """Return the pairs of boxes with contacts: neighbours in rows and stacks, else all."""
    numbers = range(len(boxes.places))
    near = boxes.name.endswith(("fall", "stand"))
    return list(itertools.pairwise(numbers) if near else itertools.combinations(numbers, 2))


def main() -> None:
    rows, table = {}, [f"{'scene':<27}{'time steps':>12}{'MuJoCo':>10}{'ratio':>8}{'default scheme':>18}"]
    for boxes in (
        dominoes(5),
        dominoes(20),
        stack(5),
        stack(10),
        pile(10),
        pile(30),
        apart(10),
        apart(30),
        apart(100),
        with_restitution(pile(10), 0.3),
        with_restitution(pile(30), 0.3),
        with_restitution(apart(100), 0.3),
    ):
        pairs = may_touch(boxes)
        seconds, remark = time_pinimpact(boxes, pairs)
        mujoco_seconds, default = time_mujoco(boxes, pairs), time_default(boxes, pairs)
        rows[boxes.name] = {
            "seconds": seconds / boxes.duration,
            "mujoco": mujoco_seconds / boxes.duration,
            "default": default / boxes.duration,
            "ratio": seconds / mujoco_seconds,
            "remark": remark,
        }
        table.append(
            f"{boxes.name:<27}{seconds / boxes.duration:>10.2f} s"
            f"{mujoco_seconds / boxes.duration:>8.3f} s{seconds / mujoco_seconds:>8.0f}"
            f"{default / boxes.duration:>16.2f} s"
        )
    keep("everyday", "\n".join(table) + "\n", {"step": STEP, "scenes": rows})


if __name__ == "__main__":
    main()
