"""The ladder: one scene, effects added one by one; what each costs per simulated second and per impact.

python benchmarks/scene_ladder.py
"""

from __future__ import annotations

import numpy as np

from pinimpact import Scene, simulate
from scene_bench import PANDA_START, best, panda, save

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
    rows = []
    left_out = [name for _, names in RUNGS for name in names]
    for label, names in RUNGS:
        left_out = [name for name in left_out if name not in names]
        scene: Scene = panda(control=control, record=True, without=tuple(left_out))

        def run(scene: Scene = scene):
            return simulate(scene, PANDA_START, np.zeros(9), 1.0, rtol=1e-6, atol=1e-8)

        seconds = best(run)
        trajectory = run()
        impacts = len(trajectory.impacts)
        rows.append(
            {
                "rung": label,
                "milliseconds_per_simulated_second": 1e3 * seconds,
                "impacts": impacts,
                "milliseconds_per_impact": 1e3 * seconds / impacts if impacts else None,
                **trajectory.statistics,
            }
        )
        per_impact = f"{1e3 * seconds / impacts:8.3f}" if impacts else "       —"
        print(f"{label:38s} {1e3 * seconds:8.2f} ms/s {impacts:4d} impacts {per_impact} ms each")
    print(save("scene_ladder", {"rtol": 1e-6, "rungs": rows}))


if __name__ == "__main__":
    main()
