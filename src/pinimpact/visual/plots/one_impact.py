"""Plots of one impact: hodograph, velocities and impulses over P₃, energy by cause."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from ...checks import in_short
from ...contact_space.many_solution import ManySolution
from ...contact_space.problem import ImpactProblem
from ...contact_space.solution import CAUSES, Path, Segment, Solution, Work
from ...contact_space.solve import solve_impact
from ...errors import InputError
from ...robot.many_impact import ManyHit
from ..impact_marks import OneImpact
from ..smooth_path import Solved, invariant_directions, parts_at, smooth_path
from .style import BLACK, COMPRESSION, FLOW, GREEN, RESTITUTION, RESUMED, STICK, axes_for, legend

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Impact: TypeAlias = OneImpact | ManyHit | ImpactProblem
"""Impacts that can be drawn: at one contact or at many."""


def solved(impact: Impact, contact: int | None = None) -> OneImpact:
    """Return the impact to draw, at the contact with an index if there are many; a problem is solved first.

    Raises:
        InputError: Not an impact; an index out of range; many contacts and a policy without a path.
    """
    if isinstance(impact, ImpactProblem):
        impact = Solved(impact, solve_impact(impact, record=True))
    solution = getattr(impact, "solution", None)
    if isinstance(solution, ManySolution):
        return _part(impact.problem, solution, contact)
    if not isinstance(solution, Solution):
        raise InputError(
            f"impact: {in_short(impact)} given; a Hit, a ManyHit, an impact of a trajectory or an "
            "ImpactProblem expected",
            value=impact,
        )
    if contact not in (None, 0):
        raise InputError(
            f"contact: {in_short(contact)} given, but the impact is at one contact", value=contact
        )
    if solution.part_of is not None and solution.path is None:
        raise _pathless(solution.part_of)
    return Solved(impact.problem, solution)


def _part(problem: ImpactProblem, solution: ManySolution, contact: int | None) -> OneImpact:
    """Return the part of one contact of an impact at many contacts."""
    count = len(solution.velocity)
    if not isinstance(contact, (int, np.integer)) or not 0 <= contact < count:
        raise InputError(
            f"contact: {in_short(contact)} given; the impact has {count} contacts, an index from 0 to "
            f"{count - 1} is expected",
            value=contact,
        )
    part = parts_at(problem, solution)[contact]
    if part.solution.path is None:
        raise _pathless(solution)
    return part


def _pathless(solution: ManySolution) -> InputError:
    return InputError(
        f'impact: the solution by {solution.simultaneous!r} has no path to draw; solve it with "propagate", '
        "and with record=True if you set further options",
        value=solution,
    )


def check_alone(impact: Impact, what: str) -> None:
    """Raise an error for an impact at many contacts."""
    solution = getattr(impact, "solution", None)
    many = isinstance(impact, ImpactProblem) and np.ndim(impact.velocity) == 2
    if many or isinstance(solution, ManySolution) or getattr(solution, "part_of", None) is not None:
        raise InputError(
            f"impact: {what} needs a single contact; for several contacts use hodograph, "
            "velocities, impulses or energy_ledger",
            value=impact,
        )


def hodograph(impact: Impact, *, contact: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw the path of the sliding velocity vₜ in the tangential plane.

    The background shows the flow of slip dvₜ/dP₃ = b − μ A vₜ/|vₜ|, the invariant directions, along which
    slip does not turn (solid if attracting, dashed if repelling), and, shaded, the directions with a negative
    normal acceleration, dv₃/dP₃ < 0 (jam). For an impact at many contacts there is no background; thin lines
    show changes of velocity by impulses at other contacts.

    Args:
        impact: A `Hit`, an impact of a trajectory, or an `ImpactProblem`, which is solved; a `ManyHit` or a
            problem of many contacts.
        contact: Index of the contact to draw, from 0, for many contacts.
        ax: Axes to draw into.

    Raises:
        InputError: Not an impact; an index out of range; many contacts and a policy without a path.
    """
    impact = solved(impact, contact)
    ax = axes_for(ax, (5.6, 6.4))
    path = smooth_path(impact.problem, impact.solution)
    radius = 1.15 * float(np.abs(path.velocity[:, :2]).max()) or 1.0
    if impact.solution.part_of is None:
        _draw_flow(ax, impact.problem, radius)
        _draw_directions(ax, impact.problem, radius)
    else:
        ax.plot(*path.velocity[:, :2].T, color=FLOW, lw=1.0, label="others push")
    for segment, part in parts(path, impact.solution.segments):
        v = path.velocity[part]
        resumed = segment.mode == "slip" and not v[0, :2].any() and segment.start > 0.0
        if segment.mode == "slip":
            color = COMPRESSION if segment.phase == "compression" else RESTITUTION
            ax.plot(v[:, 0], v[:, 1], color=color, lw=2.2, label=f"slip in {segment.phase}")
            if resumed:
                ax.plot(0.0, 0.0, "^", color=RESUMED, mec=BLACK, ms=9, zorder=4, label="slip resumes")
        else:
            ax.plot(0.0, 0.0, "D", color=STICK, mec=BLACK, ms=9, zorder=4, label="stick")
    (first, last) = path.velocity[[0, -1], :2]
    ax.plot(*first, "o", color="white", mec=COMPRESSION, mew=2, ms=7, zorder=5, label="first touch")
    ax.plot(*last, "s", color="white", mec=RESTITUTION, mew=2, ms=6, zorder=5, label="separation")
    ax.axhline(0.0, color=FLOW, lw=0.7, zorder=0)
    ax.axvline(0.0, color=FLOW, lw=0.7, zorder=0)
    ax.set(xlim=(-radius, radius), ylim=(-radius, radius), xlabel="v₁ [m/s]", ylabel="v₂ [m/s]")
    ax.set_title("Sliding velocity (hodograph)")
    ax.set_aspect("equal", anchor="N")
    legend(ax, below=True)
    return ax


def velocities(impact: Impact, *, contact: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw the contact velocity over the normal impulse (ZL, figs. 4 and 7).

    Stick is shaded, and the end of compression marked. Arguments and errors as in `hodograph`.
    """
    impact = solved(impact, contact)
    path, ax = smooth_path(impact.problem, impact.solution), axes_for(ax)
    curves = (("v₁", GREEN, "-"), ("v₂", RESUMED, "--"), ("v₃ (normal)", BLACK, "-"))
    for values, (name, color, dash) in zip(path.velocity.T, curves, strict=True):
        ax.plot(path.normal_impulse, values, dash, color=color, label=name)
    return _mark_segments(ax, impact.solution, "Contact velocity", "[m/s]")


def impulses(impact: Impact, *, contact: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw the tangential impulse over the normal impulse (ZL, fig. 4), within the cone |Pₜ| ≤ μP₃.

    Stick is shaded, and the end of compression marked. Arguments and errors as in `hodograph`.
    """
    impact = solved(impact, contact)
    path, ax = smooth_path(impact.problem, impact.solution), axes_for(ax)
    p3, mu = path.normal_impulse, float(impact.problem.friction)
    ax.plot(p3, path.impulse[:, 0], "-", color=GREEN, label="P₁")
    ax.plot(p3, path.impulse[:, 1], "--", color=RESUMED, label="P₂")
    ax.plot(p3, np.hypot(path.impulse[:, 0], path.impulse[:, 1]), color=BLACK, label="|Pₜ|")
    for sign in (1.0, -1.0):
        ax.plot(p3[[0, -1]], sign * mu * p3[[0, -1]], ":", color=COMPRESSION, label="± μP₃")
    return _mark_segments(ax, impact.solution, "Tangential impulse", "[N s]")


def energy_ledger(impact: Impact, *, contact: int | None = None, ax: Axes | None = None) -> Axes:
    """Draw the change of kinetic energy by each cause, one after another, and the total change [J].

    For an impact at many contacts it is the sum over all, or that of one contact. Arguments and errors as in
    `hodograph`.
    """
    if isinstance(impact, ImpactProblem):
        impact = Solved(impact, solve_impact(impact))
    if isinstance(solution := getattr(impact, "solution", None), ManySolution) and contact is None:
        parts_of = solution.work
        work = Work(*(float(np.sum(getattr(parts_of, name))) for name in CAUSES))
    else:
        work = solved(impact, contact).solution.work
    ax = axes_for(ax, (6.4, 2.6))
    causes = [name for name in CAUSES if name != "surface" or work.surface != 0.0]
    bars = [(name, float(getattr(work, name))) for name in causes]
    colors = dict(zip(CAUSES, (COMPRESSION, RESTITUTION, RESUMED, GREEN), strict=True))
    reached = 0.0
    for row, (name, value) in enumerate(bars):
        ax.barh(row, value, left=reached, color=colors[name])
        _number(ax, reached, value, row)
        reached += value
        ax.plot([reached, reached], [row - 0.4, row + 1.4], color=BLACK, lw=0.6)
    ax.barh(len(bars), reached, color=BLACK)
    _number(ax, 0.0, reached, len(bars))
    ax.set_yticks(range(len(bars) + 1), [*(name for name, _ in bars), "total"])
    ax.invert_yaxis()
    ax.use_sticky_edges = False
    ax.margins(x=0.16)
    ax.locator_params(axis="x", nbins=6)
    ax.axvline(0.0, color=BLACK, lw=0.5)
    ax.set(xlabel="[J]", title="Change of kinetic energy")
    return ax


def parts(path: Path, segments: tuple[Segment, ...]) -> list[tuple[Segment, slice]]:
    """Return the points of a path in each segment; adjacent segments share a point.

    Ends of segments and points of the path differ by rounding, so the closest point is chosen.
    """
    p3 = path.normal_impulse
    found, start = [], 0
    for segment in segments:
        end = start + int(np.abs(p3[start:] - segment.end).argmin())
        found.append((segment, slice(start, end + 1)))
        start = end
    return found


def _mark_segments(ax: Axes, solution: Solution, title: str, unit: str) -> Axes:
    """Mark stick and the end of compression, and label axes over the normal impulse."""
    compressed = [segment.end for segment in solution.segments if segment.phase == "compression"]
    for segment in solution.segments:
        if segment.mode == "stick":
            ax.axvspan(segment.start, segment.end, color=STICK, alpha=0.3, lw=0.0, label="stick")
    if compressed:
        ax.axvline(compressed[-1], color=COMPRESSION, ls="-.", lw=1.0, label="compression ends")
    ax.axhline(0.0, color=BLACK, lw=0.5)
    ax.set(xlabel="normal impulse P₃ [N s]", ylabel=unit, title=title)
    legend(ax)
    return ax


def _number(ax: Axes, start: float, value: float, row: int) -> None:
    """Write a bar's value beyond its end."""
    side = "left" if value >= 0.0 else "right"
    text = f" {value:.3g} ".replace("-", "−")  # as the axes write it
    ax.annotate(text, (start + value, row), ha=side, va="center", size=8)


def _draw_flow(ax: Axes, problem: ImpactProblem, radius: float) -> None:
    """Draw the streamlines of dvₜ/dP₃ = b − μ A vₜ/|vₜ|."""
    w = np.asarray(problem.delassus, dtype=float)
    ticks = np.linspace(-radius, radius, 40)
    slip = np.array(np.meshgrid(ticks, ticks))
    direction = slip / np.hypot(*slip)
    rate = w[:2, 2, None, None] - problem.friction * np.einsum("ij,jkl->ikl", w[:2, :2], direction)
    if np.any(rate):
        ax.streamplot(ticks, ticks, rate[0], rate[1], color=FLOW, linewidth=0.7, arrowsize=0.7, density=0.9)


def _draw_directions(ax: Axes, problem: ImpactProblem, radius: float) -> None:
    """Draw the invariant directions of slip, and the sector of jam."""
    from matplotlib.patches import Wedge

    w, mu = np.asarray(problem.delassus, dtype=float), float(problem.friction)
    for angle in invariant_directions(problem):
        along = np.array([np.cos(angle), np.sin(angle)])
        across = np.array([-along[1], along[0]])
        slope = -along @ (w[:2, 2] - mu * w[:2, :2] @ along) - mu * across @ w[:2, :2] @ across
        dash, kind = ("-", "attracting") if slope < 0.0 else ("--", "repelling")
        end = 2.0 * radius * along
        label = f"invariant direction, {kind}"
        ax.plot([0.0, end[0]], [0.0, end[1]], dash, color="#333333", lw=1.5, label=label)
    coupling = float(np.hypot(*w[:2, 2]))
    if mu * coupling > w[2, 2]:  # μ bᵀσ > c for the σ within this angle of b
        half = np.degrees(np.arccos(w[2, 2] / (mu * coupling)))
        middle = np.degrees(np.arctan2(w[1, 2], w[0, 2]))
        sector = Wedge((0, 0), 2.0 * radius, middle - half, middle + half, color=RESUMED, alpha=0.18, lw=0.0)
        sector.set_label("jam")
        ax.add_patch(sector)
