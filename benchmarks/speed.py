"""Run time of an impact relative to Pinocchio's algorithms; of laws, work and threads; of special cases.

python -m benchmarks.speed
"""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin
from benchmarks.timing import best_of, publish, row, shared_rows

import pinimpact
from pinimpact.contact_space._kernels.timing import repeat_exact
from pinimpact.contact_space.laws import law_code

COUNT = 100_000
SHARED = 40_000
STATES = 16
STATES_OF_LAWS = 500
ROWS_OF_A_PART = 500  # less than 1 ms: longer calls would be interrupted more often on a busy machine
ROWS = 20_000
ROBOTS = {"panda": "panda_hand_tcp", "ur5": "tool0", "talos": "gripper_left_fingertip_1_link"}


def random_problems(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return W and v of random spatial impacts."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((count, 3, 7))
    velocity = rng.standard_normal((count, 3))
    velocity[:, 2] = -np.abs(velocity[:, 2])
    return X @ X.transpose(0, 2, 1) / 7.0, velocity


def batch() -> list[dict]:
    """Time a batch of random spatial problems against one mass matrix of the Panda."""
    delassus, velocity = random_problems(COUNT)
    model = pinimpact.load_robot("panda").model
    data, q = model.createData(), pin.neutral(model)
    times = best_of(
        {
            "crba": lambda: pin.crba(model, data, q),
            "impacts": lambda: pinimpact.solve_impacts(delassus, velocity, 0.3, 0.5),
        },
        rounds=20,
    )
    return [row("solve_impacts, per problem", times["impacts"] / COUNT, 1.5, "crba(panda)", times["crba"])]


def laws() -> list[dict]:
    """Time the energetic law against Poisson's, work, and threads, on random spatial problems."""
    count = 4000
    few, many = random_problems(count), random_problems(SHARED)

    def call(part, law="poisson", **options):
        problems = [numbers[part : part + ROWS_OF_A_PART] for numbers in few]
        return lambda: pinimpact.solve_impacts(*problems, 0.3, 0.5, law, **options)

    ways = {
        "poisson": call,
        "energetic": partial(call, law="energetic"),
        "works": partial(call, work=True),
        "works, energetic": partial(call, law="energetic", work=True),
    }
    best = best_of(
        {(name, part): way(part) for name, way in ways.items() for part in range(0, count, ROWS_OF_A_PART)},
        rounds=60,
    )
    times = {name: sum(best[one] for one in best if one[0] == name) / count for name in ways}
    rows = [
        row("energetic law, mean", times["energetic"], 1.5, "Poisson's", times["poisson"]),
        row("work of a batch", times["works"] - times["poisson"], 1e-6),
        row("work of a batch, energetic law", times["works, energetic"] - times["energetic"], 1e-6),
    ]

    singles = []
    for W, v in zip(few[0][:STATES_OF_LAWS], few[1], strict=False):
        numbers = (*W[np.triu_indices(3)], *v, 0.3, 0.5)
        kernels = {
            law: partial(repeat_exact, 10, *numbers, law_code(law)) for law in ("poisson", "energetic")
        }
        singles.append(best_of(kernels, rounds=10, least=0.0))
    for name, part in (("median", 50), ("99 in 100", 99)):
        seconds = {law: np.percentile([s[law] for s in singles], part) / 10 for law in singles[0]}
        against = f"Poisson's {name}"
        rows.append(row(f"energetic law, {name}", seconds["energetic"], 1.5, against, seconds["poisson"]))

    def share(threads):
        return pinimpact.solve_impacts(*many, 0.3, 0.5, threads=threads)

    return [*rows, *shared_rows("solve_impacts", share, 1.0 / 1.8)]


def robots() -> list[dict]:
    """Time `impact` from Python against a frictionless impulse of Pinocchio, called from Python too."""
    rows = []
    for name, frame in ROBOTS.items():
        model = pinimpact.load_robot(name).model
        data = model.createData()
        contact = pinimpact.Contact(frame, pinimpact.Plane(), friction=0.4, restitution=0.5)
        frame_id = model.getFrameId(frame)
        rng = np.random.default_rng(0)
        times = []
        for _ in range(STATES):
            q = pin.integrate(model, pin.neutral(model), 0.3 * rng.standard_normal(model.nv))
            v = rng.standard_normal(model.nv)
            v *= -np.sign(pinimpact.contact_matrices(model, data, q, contact).h @ v)  # it approaches

            def pinocchio(model=model, data=data, q=q, v=v, frame_id=frame_id):
                J = pin.computeFrameJacobian(model, data, q, frame_id, pin.LOCAL_WORLD_ALIGNED)
                return pin.impulseDynamics(model, data, q, v, J[:3], 0.5, 0.0)

            def pinimpact_(model=model, data=data, q=q, v=v, contact=contact):
                return pinimpact.impact(model, data, q, v, contact)

            times.append(best_of({"impact": pinimpact_, "pinocchio": pinocchio}, rounds=50))
        mean = {side: float(np.mean([t[side] for t in times])) for side in times[0]}
        slowest = max(times, key=lambda t: t["impact"])
        against = "computeFrameJacobian + impulseDynamics"
        rows.append(row(f"impact, {name}, mean", mean["impact"], 2.0, against, mean["pinocchio"]))
        rows.append(row(f"impact, {name}, slowest", slowest["impact"], 3.0, against, slowest["pinocchio"]))
    return rows


def rows() -> list[dict]:
    """Time `impacts` for random approaching states of the Panda, by one thread and by two."""
    model = pinimpact.load_robot("panda").model
    data = model.createData()
    contact = pinimpact.Contact(ROBOTS["panda"], pinimpact.Plane(), friction=0.4, restitution=0.5)
    rng = np.random.default_rng(0)
    neutral = pin.neutral(model)
    q = np.array([pin.integrate(model, neutral, 0.3 * rng.standard_normal(model.nv)) for _ in range(ROWS)])
    v = rng.standard_normal((ROWS, model.nv))
    away = pinimpact.impacts(model, data, q, v, contact).status == pinimpact.Status.NO_IMPACT
    v[away] *= -1.0
    first = q[0]
    times = best_of(
        {
            "one": lambda: pinimpact.impacts(model, data, q, v, contact),
            "crba": lambda: pin.crba(model, data, first),
        },
        rounds=30,
    )
    one = times["one"] / ROWS

    def share(threads):
        return pinimpact.impacts(model, data, q, v, contact, threads=threads)

    return [
        row("impacts, panda, per row", one, 1 / 150_000),
        row("impacts, panda, per row", one, None, "crba(panda)", times["crba"]),
        *shared_rows("impacts, panda", share, 1.0 / 1.8),
    ]


def shortcuts() -> list[dict]:
    """Time special cases against the general problem, in batches of equal rows."""
    W = np.array([[1.3, 0.2, 0.4], [0.2, 0.8, -0.3], [0.4, -0.3, 0.9]])
    balanced = W * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]])
    planar = np.array([[1.3, 0, 0.4], [0, 0, 0], [0.4, 0, 0.9]])
    invariant = np.array([[1.3, 0, 0.4], [0, 0.8, 0], [0.4, 0, 0.9]])
    spatial, straight = (1.0, 0.7, -1.0), (1.0, 0.0, -1.0)
    problems = {
        "general path": (W, spatial, 0.3, 0.5),
        "no friction": (W, spatial, 0.0, 0.5),
        "no restitution": (W, spatial, 0.3, 0.0),
        "balanced contact (b = 0)": (balanced, spatial, 0.3, 0.5),
        "planar mechanism": (planar, straight, 0.3, 0.5),
        "along an invariant direction": (invariant, straight, 0.3, 0.5),
    }
    n = 1000

    def call(W, v, mu, e):
        matrices, velocities = np.tile(W, (n, 1, 1)), np.tile(v, (n, 1))
        return lambda: pinimpact.solve_impacts(matrices, velocities, mu, e)

    times = best_of({name: call(*problem) for name, problem in problems.items()}, rounds=100)
    general = times.pop("general path") / n
    return [row(name, seconds / n, 1.0, "the general path", general) for name, seconds in times.items()]


if __name__ == "__main__":
    publish("speed", batch() + laws() + robots() + rows() + shortcuts())
