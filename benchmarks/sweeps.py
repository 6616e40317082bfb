"""Plot impacts along parameters that cross boundaries of regimes, for docs/hard-cases.md.

    python -m benchmarks.sweeps

Run from the root of the repository; writes docs/figures/hard-cases.png. Lines are the exact method at 2,001
points, circles the multiple-precision reference of the tests.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mpmath import mp
from tests.reference.reference import solve_reference
from tests.sweeps import SWEEPS, Sweep


def main() -> None:
    """Plot all families of problems."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    rows = -(-len(SWEEPS) // 3)
    figure, panels = plt.subplots(rows, 3, figsize=(15, 3.7 * rows), layout="constrained")
    for panel in panels.flat[len(SWEEPS) :]:
        panel.axis("off")
    for (name, sweep), panel in zip(SWEEPS.items(), panels.flat, strict=False):
        x = np.linspace(sweep.start, sweep.end, 2001)
        y = np.array([sweep.answer(value) for value in x])
        for part in np.split(np.arange(len(x)), [k + 1 for k in _breaks(sweep, x)]):
            panel.set_prop_cycle(None)
            panel.plot(x[part], y[part][:, :3], lw=1)
            panel.plot(x[part], y[part][:, 3:], lw=1, ls="--")
        for value in x[20::280]:
            p = sweep.problem(float(value))
            W, v = p.delassus, p.velocity
            if sweep.factor is not None:  # in multiple precision, so that W is exactly singular
                F, r = (mp.matrix(x.tolist()) for x in sweep.factor(float(value)))
                with mp.workprec(400):
                    W, v = (F * F.T).tolist(), list(F * r)
            s = solve_reference(W, v, p.friction, p.restitution, p.law, digits=20)
            panel.plot([value] * 6, [float(z) for z in (*s.velocity, *s.impulse)], "ko", ms=4, mfc="none")
        panel.set_title(name)
        panel.set_xlabel(sweep.label)
        panel.locator_params(axis="x", nbins=6)
        panel.grid(alpha=0.3)
    names = ["v₁⁺", "v₂⁺", "v₃⁺", "P₁", "P₂", "P₃"]
    lines = panels.flat[0].lines[:6]
    figure.legend(lines, names, loc="outside lower center", ncols=6)
    figure.savefig(Path(__file__).parents[1] / "docs" / "figures" / "hard-cases.png", dpi=80)


def _breaks(sweep: Sweep, x: np.ndarray) -> list[int]:
    """Return the interval in which the map jumps, where lines are interrupted."""
    if not sweep.jumps:
        return []
    low, _, _ = sweep.close_in(*sweep.steepest(len(x), 1)[0])
    return [int(np.searchsorted(x, low, side="right")) - 1]


if __name__ == "__main__":
    main()
