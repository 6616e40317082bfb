"""Draw figures 3, 4, 6, 7 and 9 of Zhao and Liu's paper from the models that come with pinimpact.

python examples/paper_figures.py [folder]
"""

import math
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import pinimpact

THETA = 0.46
COLORS = ("#1f6fb2", "#c0392b", "#16a085", "#8e44ad", "#e67e22", "#555555")
FAMILY = (0.1, 0.2, 0.5, 1.0)  # friction in figures 3 and 4, which the paper does not state


def ellipsoid(speed, friction):
    return strike("ellipsoid", None, [speed, speed, -1, 0, 0, 0], friction, 0.5)


def rod(side, friction):
    v = [0.2 * side, 0.2 * math.sqrt(3), -2, 0, 0]
    return strike("rod", [0, 0, 0, 0, THETA], v, friction, 0.8)


def strike(name, q, v, friction, restitution):
    robot = pinimpact.load_robot(name)
    tip = pinimpact.Contact("tip", pinimpact.Plane(), friction, restitution)
    q = robot.q0 if q is None else q
    return pinimpact.impact(robot.model, robot.data, q, v, tip, record=True).solution


def figure_3(axes):
    start = 5 / math.sqrt(2)
    for friction in FAMILY:
        hodograph(axes, ellipsoid(start, friction), f"μ = {friction:g}")
    v1 = np.linspace(0, start, 15)
    axes.plot(v1, start * (v1 / start) ** 1.75, "k.", label="closed form (32)")
    axes.set_title("Fig. 3: ellipsoid, slip to the end or to rest")


def figure_4(axes):
    for friction in FAMILY:
        path = ellipsoid(0.5, friction).path
        (line,) = axes.plot(path.normal_impulse, path.velocity[:, 0], label=f"v₁, μ = {friction:g}")
        axes.plot(path.normal_impulse, path.velocity[:, 1], "--", color=line.get_color(), label="v₂")
        axes.plot(path.normal_impulse, path.impulse[:, 0], ":", color=line.get_color(), label="P₁")
    axes.set(xlabel="P₃ [N s]", ylabel="[m/s], [N s]", title="Fig. 4: ellipsoid, slip comes to stick")


def figure_6(axes):
    critical = math.tan(THETA) / math.sin(math.pi / 3)
    for side in (1, -1):
        for ratio, color in zip((0, 0.5, 1, 2), COLORS, strict=False):
            hodograph(axes, rod(side, ratio * critical), f"μ/μ_c = {ratio:g}" if side > 0 else None, color)
    axes.set_title("Fig. 6: rod, modes of slip")


def figure_7(axes):
    for side, color in ((1, COLORS[0]), (-1, COLORS[1])):
        hodograph(axes, rod(side, 0.7), f"v₁ᵒ = {0.2 * side:g} m/s", color)
    axes.set_title("Fig. 7: rod, slip resumes (μ = 0.7)")


def figure_9(axes):
    for side in (1, -1):
        for friction, color in zip((0, 0.5, 0.9, 1.2, math.sqrt(2), 2), COLORS, strict=False):
            solution = strike("spherical_pendulum", [0, math.pi / 4], [side, 1], friction, 0.8)
            hodograph(axes, solution, f"μ = {friction:.3g}" if side > 0 else None, color)
    axes.set_title("Fig. 9: spherical pendulum")


def hodograph(axes, solution, label, color=None):
    velocity = solution.path.velocity
    axes.plot(velocity[:, 0], velocity[:, 1], label=label, color=color)
    axes.plot(velocity[0, 0], velocity[0, 1], "ko", ms=4)
    axes.set(xlabel="v₁ [m/s]", ylabel="v₂ [m/s]")


FIGURES = {3: figure_3, 4: figure_4, 6: figure_6, 7: figure_7, 9: figure_9}


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for number, draw in FIGURES.items():
        figure = Figure(figsize=(6, 5), layout="constrained")
        draw(axes := figure.add_subplot())
        axes.legend(fontsize="small")
        figure.savefig(path := folder / f"figure_{number}.png", dpi=120)
        print(path)


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "out"))
