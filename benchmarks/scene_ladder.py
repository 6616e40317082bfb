"""Run time of a scene per simulated second and per impact, as effects are added one by one.

python -m benchmarks.scene_ladder
"""

from __future__ import annotations

from functools import partial

import numpy as np
from benchmarks.panda_scene import START, STILL, panda
from benchmarks.timing import best_of, keep

from pinimpact import simulate

RTOL = 1e-6
ROUNDS = 20
RUNGS = (
    ("gravity only", ()),
    ("+ joint damping", ("joint damping",)),
    ("+ contact guards, sustained contact", ("contact guards", "sustained contact")),
    ("+ restitution", ("restitution",)),
    ("+ contact friction", ("contact friction",)),
    ("+ joint limits", ("joint limits",)),
    ("+ control", ("control",)),
    ("+ recorded path", ("recorded path",)),
)


def control(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    return -0.5 * v


def main() -> None:
    left_out = [name for _, names in RUNGS for name in names]
    runs = {}
    for label, names in RUNGS:
        left_out = [name for name in left_out if name not in names]
        scene = panda(control=control, record=True, without=tuple(left_out))
        runs[label] = partial(simulate, scene, START, STILL, 1.0, rtol=RTOL, atol=1e-2 * RTOL)
    seconds = best_of(runs, rounds=ROUNDS)
    rows, lines = (
        [],
        [f"{'effects':<38}{'ms per s':>9}{'evaluations':>13}{'impacts':>9}{'ms per impact':>15}"],
    )
    for label, run in runs.items():
        trajectory = run()
        impacts, milliseconds = len(trajectory.impacts), 1e3 * seconds[label]
        each = f"{milliseconds / impacts:.2f}" if impacts else "–"
        evaluations = trajectory.statistics["evaluations"]
        lines.append(f"{label:<38}{milliseconds:>9.1f}{evaluations:>13}{impacts:>9}{each:>15}")
        rows.append(
            {"rung": label, "seconds": seconds[label], "impacts": impacts, **trajectory.statistics},
        )
    keep("scene_ladder", "\n".join(lines) + "\n", {"rtol": RTOL, "rungs": rows})


if __name__ == "__main__":
    main()
