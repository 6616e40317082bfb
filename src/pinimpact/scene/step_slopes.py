"""Derivatives of a time step: propagation of changes through its equations. (derivatives.md, 12)"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .._numeric.tolerances import COMPUTED, ROUNDING, STALLED, TINY
from ..arrays import Array, Integers
from ..contact_space.derivatives import Boundary
from ..robot._kernels.row_slopes import row_slopes
from ..robot.derivatives import check_joints
from ..robot.forest import mass_matrix
from ..robot.many_derivatives import RowSlopes, stacked
from ..robot.placed_robot import PlacedRobot
from ._kernels.contact_forces import FREE, HELD, SLIP, STICK
from ._kernels.lie_charts import PLANAR, RIGID
from ._kernels.step_iterations import Changes, Places, iterate
from ._kernels.tolerances import STEPS_DRIFT
from .control_slopes import change_of_forces
from .dense_step import DenseStep
from .dynamics import SceneDynamics
from .impact_jumps import Parameter
from .joint_charts import turned_axes, turning
from .row_bends import less_turning, row_bends
from .scene import Scene
from .step_sets import StepLaw, dense, limit_of_compliances, limit_of_removal
from .step_taken import StepTaken


class _Rows(NamedTuple):
    """The rows of a step, and their changes.

    Attributes:
        jacobian: (rows, nv) Jacobian.
        slopes: Derivatives of the contacts by q.
        places: Places of the contacts, with rotations from the axes of `slopes` to those of the rows.
        start: (rows, n) changes of the velocities at the start.
        end: (rows, n) changes of the velocities at the end, at constant v⁺.
        gaps: (rows, n) changes of the gaps, in normal rows.
    """

    jacobian: Array
    slopes: RowSlopes
    places: Places
    start: Array
    end: Array
    gaps: Array


class _Moved(NamedTuple):
    """Changes in a step, n columns.

    Attributes:
        middle: (nv, n) changes of the configuration at the midpoint.
        v_end: (nv, n) changes of the velocity at the end.
        pushed: (nv, n) changes of the mean acceleration by impulses.
        u_start, u_end: (rows, n) changes of the velocities of the rows at the start and at the end.
        length: (n,) changes of the step size [s].
        rows: The rows.
        tied: Whether any row is at a tie.
    """

    middle: Array
    v_end: Array
    pushed: Array
    u_start: Array
    u_end: Array
    length: Array
    rows: _Rows
    tied: bool


class StepSlopes:
    """Propagates changes through time steps.

    Changes are (3 nv + 1, n): of q in the tangent space, of v, of `StepTaken.pushed`, and of the time at
    which the state is reached, by which the next step is shorter. The last columns are derivatives by the
    parameters.

    Args:
        dynamics, model: The dynamics and the model.
        parameters: Coefficients by which the motion is differentiated.
        controlled: The scene if its control is a function, else None.

    Attributes:
        boundary: Flags of `Boundary`, set by the steps.
    """

    def __init__(
        self,
        dynamics: SceneDynamics,
        model: pin.Model,
        parameters: Sequence[Parameter],
        controlled: Scene | None,
    ) -> None:
        check_joints(model)
        self._controlled = controlled
        self._work, self._model = dynamics.work, model
        self._data, self._spare, self._aside = (model.createData() for _ in range(3))
        self._compliances = np.array([1.0 / c.stiffness for c in dynamics.contacts])
        # contacts with a separate coefficient for sustained contact do not depend on that of impacts
        own = [contact.sliding_friction is not None for contact in dynamics.contacts]
        alike = [c.restitution == 0.0 and c.friction == c.sustained_friction for c in dynamics.contacts]
        self._alike = np.array(alike, dtype=bool)
        friction = [p.kind == "friction" and not own[p.contact] for p in parameters]
        self._friction = [p.contact if one else -1 for one, p in zip(friction, parameters, strict=True)]
        self._impacts = [-1 if one else p.contact for one, p in zip(friction, parameters, strict=True)]
        self.boundary = Boundary.NONE
        self._frames = [row for row in dynamics.work.joint_charts.tolist() if row[0] in (RIGID, PLANAR)]
        carried = np.zeros(model.nv, dtype=bool)
        # results for the last step
        self._known: tuple[StepTaken, _Rows] | None = None
        self._held: tuple[StepTaken, StepLaw] | None = None
        self._to_middle: tuple[DenseStep, Array] | None = None
        for kind, _, j, _ in self._frames:
            carried[j : j + (3 if kind == RIGID else 2)] = True
        self._phases = [moves for moves in (carried, ~carried) if moves.any()]

    def begin(self, x: Array, step: DenseStep) -> Array:
        """Project changes before the first step onto those that active contacts admit. (`Boundary.CLOSED`)

        Gaps stay closed at the midpoint, and velocities of active contacts stay zero at the start, by
        displacements and impulses at these contacts.
        """
        taken, nv = _taken(step), len(step.v)
        law = self._law(taken)
        kept = law.pinned
        if len(kept) == 0:
            return x
        self.boundary |= Boundary.CLOSED
        inverse, x, n = np.linalg.inv(mass_matrix(self._model, self._data, step.q)), x.copy(), x.shape[1]
        pushed = np.zeros((2 * nv, 2 * len(kept)))
        pushed[:nv, : len(kept)] = inverse @ law.jacobian[kept].T
        pushed[nv:, len(kept) :] = inverse @ law.pushes().T
        maps = self._maps(taken)
        rows = np.vstack([maps.gaps[kept], maps.start[kept]])[:, :-1] @ self._half(step)[:, :-1]
        missed = rows @ np.hstack([x[: 2 * nv], pushed])
        soft = np.tile(law.softness(), 2)
        x[: 2 * nv] -= pushed @ limit_of_compliances(missed[:, n:], missed[:, :n], soft)
        return x

    def _middle(self, step: DenseStep, x: Array, length: Array) -> tuple[Array, Array, Array]:
        """Return changes of the midpoint's q (nv, n) and v (nv, n), and of the step size (n,)."""
        nv = len(step.v)
        moved = self._half(step) @ np.vstack([x[: 2 * nv], length])
        return moved[:nv], moved[nv:], length

    def _half(self, step: DenseStep) -> Array:
        """Return the derivatives (2 nv, 2 nv + 1) of the midpoint's q and v by q, v and the step size."""
        if self._to_middle is None or self._to_middle[0] is not step:
            nv, way = len(step.v), 0.5 * step.h * step.v
            unit = np.eye(2 * nv + 1)
            by_way = 0.5 * step.h * unit[nv:-1] + 0.5 * np.outer(step.v, unit[-1])
            by_q = self._advanced(step.q, way, unit[:nv], by_way)
            self._to_middle = (
                step,
                np.vstack([by_q, turned_axes(self._frames, way, step.v, by_way, unit[nv:-1])[1]]),
            )
        return self._to_middle[1]

    def _advanced(self, q: Array, xi: Array, by_q: Array, by_xi: Array) -> Array:
        """Return changes (nv, n) of q ⊕ ξ in the charts of a step: positions move first, then bodies turn."""
        for moves in self._phases:
            part = np.where(moves, xi, 0.0)
            turn, push = pin.dIntegrate(self._model, q, part)
            by_q, q = turn @ by_q + push[:, moves] @ by_xi[moves], pin.integrate(self._model, q, part)
        return np.asarray(by_q)

    def through(self, x: Array, step: DenseStep, force: Array) -> Array:
        """Return changes x (3 nv + 1, n) after a step, or at the impact that cuts it.

        `force` (nv, n) are the changes of the generalized force.
        """
        taken, nv = _taken(step), self._model.nv
        moved = self._differentiate(x, step, force)
        if len(taken.arriving) > 1:
            self.boundary |= Boundary.EVENTS_COINCIDE
            return np.full_like(x, np.nan)
        if taken.arriving:
            part = (step.end - step.start) / step.h
            shift = self._shift(moved, taken, part, taken.arriving[0])
            reached = x[3 * nv] + step.h * shift + part * moved.length
            return np.vstack([self._within(x, moved, step, part, shift), moved.pushed, reached])
        result = self._within(x, moved, step, 1.0, np.zeros(x.shape[1]))
        result = self._removed(result, taken)
        return np.vstack([result, moved.pushed, np.zeros(x.shape[1])])

    def at(self, x: Array, step: DenseStep, t: float, force: Array) -> Array:
        """Return changes x (3 nv + 1, n) before a step as changes (2 nv, n) at a time [s] within it."""
        taken, nv = _taken(step), len(step.v)
        if t >= step.end and not taken.arriving:
            return self.through(x, step, force)[: 2 * nv]
        moved, part = self._differentiate(x, step, force), (t - step.start) / step.h
        result = self._within(x, moved, step, part, -(x[-1] + part * moved.length) / step.h)
        if taken.removals:  # the dense output distributes them linearly over the step
            end = self._within(x, moved, step, 1.0, np.zeros(x.shape[1]))
            result += part * (self._removed(end, taken) - end)
        return result

    def modes(self, taken: StepTaken) -> Integers:
        """Return the modes (n + nl,) of contacts and limits in a step."""
        work, rows, law = self._work, taken.rows, self._law(taken)
        modes = np.zeros(work.contacts + work.limits, dtype=np.int64)
        modes[rows.held] = HELD
        modes[rows.contacts[law.slips]], modes[rows.contacts[law.sticks]] = SLIP, STICK
        modes[work.contacts + rows.limits] = np.where(law.limits, STICK, FREE)
        return modes

    def _law(self, taken: StepTaken) -> StepLaw:
        if self._held is None or self._held[0] is not taken:
            work = self._work
            self._held = taken, StepLaw(taken, work.friction, work.dry_friction, self._compliances)
        return self._held[1]

    # ---- the equations of a step

    def _differentiate(self, x: Array, step: DenseStep, force: Array) -> _Moved:
        """Return the changes in a step; NaN where they depend on how a tie is decided. (D37)"""
        taken, nv, h = _taken(step), len(step.v), step.h
        found, softened, q, v = taken.found, taken.softened, taken.middle, taken.v
        by_pushed, length = x[2 * nv : 3 * nv], -x[3 * nv]
        at_middle = middle, by_v, _ = self._middle(step, x, length)
        work, follows = self._work, taken.follows  # the drives that follow their laws
        stiffness = np.where(follows, work.drive_stiffness, 0.0)
        damping = work.damping + np.where(follows, work.drive_damping, 0.0)
        softer = softened / h + 0.25 * h * stiffness  # derivative of `softened` by h
        mass = mass_matrix(self._model, self._data, q)
        total = mass + np.diag(softened)
        inverse = np.asarray(np.linalg.inv(total), dtype=float)

        def right(mean: Array, by_mean: Array, change: Array) -> Array:
            """Return h δf − δM `change`, for forces f at a mean velocity."""
            still, by_still = turning(self._frames, mean)
            slopes = pin.computeRNEADerivatives(self._model, self._data, q, mean, change / h - still)
            slopes_v = slopes[1] + np.diag(damping) - mass @ by_still
            by_state = (slopes[0] + np.diag(stiffness)) @ middle + slopes_v @ by_mean
            if self._controlled is not None:
                moved = np.vstack([middle, by_mean, -0.5 * length])
                given = step.start + 0.5 * h, (q, mean), moved
                by_state -= change_of_forces(self._controlled, h, *given)
            return np.asarray(h * (force - by_state))

        first = found.foreseen - v - h * taken.pushed
        predicted = right(v, by_v, first) + _outer(total @ first / h - softer * first, length)
        predicted = inverse @ predicted + by_v + _outer(taken.pushed, length)
        if taken.pushed.any():  # it is zero in the first step
            predicted += h * by_pushed

        def solve(taken: StepTaken, known: Array, predicted: Array) -> _Moved:
            """Return the changes in a step from those of its forces and of the velocity they belong to."""
            found, rows = taken.found, self._rows(taken, at_middle)
            change, expected = found.v_end - v, found.predicted - v
            acting = (total @ change - 0.5 * h * damping * expected - rows.jacobian.T @ found.impulse) / h
            known = known + 0.5 * h * damping[:, None] * (predicted - by_v) + total @ by_v
            known += _outer(acting + 0.5 * damping * expected - softer * change, length)
            given = rows, (total, inverse, softer), (middle, known, length)
            moved = self._solve(taken, False, *given)
            self._refuse_ties(taken, moved, given)
            return moved

        change, mean = found.v_end - v, (0.5 * (v + found.foreseen), 0.5 * (by_v + predicted))
        known = right(*mean, change)
        if found.struck.any():
            earlier = replace(taken, found=found.of_first_problem(dense(taken.rows, nv)))
            tried = solve(earlier, right(*mean, earlier.found.v_end - v), predicted)
            struck = found.struck[:, None]
            predicted = np.where(struck, tried.v_end, predicted)
            sides = right(v, by_v, change) + right(found.predicted, predicted, change)
            known = np.where(struck, 0.5 * sides, known)
        moved = solve(taken, known, predicted)
        moved.pushed[found.struck] = 0.0
        self._refuse_landings(taken, moved)
        self._refuse_touches(taken, moved)
        return moved

    def _refuse_landings(self, taken: StepTaken, moved: _Moved) -> None:
        """Set derivatives by coefficients of impacts to NaN where a contact lands without one, at e = 0."""
        if not self._impacts:
            return
        contacts, found = taken.rows.contacts, taken.found
        lands = found.fast[: len(contacts)] & self._alike[contacts]
        closes = (found.gap_end[: len(contacts)] < 0.0) & (len(taken.arriving) == 0)
        lands &= closes | (found.impulse[2 : 3 * len(contacts) : 3] > 0.0)
        columns = np.isin(self._impacts, contacts[lands])
        if columns.any():
            self.boundary |= Boundary.JUMP
            moved.v_end[:, moved.v_end.shape[1] - len(columns) + np.flatnonzero(columns)] = np.nan

    def _refuse_touches(self, taken: StepTaken, moved: _Moved) -> None:
        """Set changes to NaN that move a gap which vanishes right at the midpoint or at the end of a step.

        A contact that arrives without an impact is stopped in that step or in the next one, and its overlap
        at the end is removed or not, by the sign of these gaps.
        """
        found, rows = taken.found, taken.rows
        if not found.fast.any():
            return
        middle = found.gap_end - 0.5 * taken.h * found.u_end[rows.normals]
        touch = (np.abs(middle) <= taken.touching) | (np.abs(found.gap_end) <= taken.touching)
        if (found.fast & taken.collides & ~found.arrives).any():  # by Newton's law (16.5)
            self.boundary |= Boundary.EVENTS_COINCIDE
            moved.v_end[:] = np.nan
        for i in np.flatnonzero(found.fast & ~taken.collides & touch).tolist():
            row = int(rows.normals[i])
            end = moved.rows.gaps[row] + 0.5 * taken.h * moved.u_end[row]
            size = np.abs(moved.middle).max(axis=0) + taken.h * np.abs(moved.v_end).max(axis=0)
            shifted = np.maximum(np.abs(moved.rows.gaps[row]), np.abs(end)) > STEPS_DRIFT * size
            if shifted.any():
                self.boundary |= Boundary.EVENTS_COINCIDE
                moved.v_end[:, shifted] = np.nan

    def _refuse_ties(self, taken: StepTaken, moved: _Moved, given: tuple[Any, ...]) -> None:
        """Set changes of the velocity to NaN that depend on how a tie is decided."""
        rows, v_end, law = moved.rows, moved.v_end, self._law(taken)
        largest = np.abs(np.concatenate([moved.middle, moved.u_start, v_end])).max(axis=0)
        least = np.nanmax(largest, initial=ROUNDING)
        if self._friction:  # changes by coefficients are of the size of the impulses
            pushed = taken.found.v_end - taken.found.foreseen + taken.h * taken.pushed
            largest[-len(self._friction) :] += np.abs(pushed).max()
        sizes = np.abs(rows.jacobian[law.pinned]).sum(axis=1)
        tied = (np.abs(rows.gaps[law.pinned]) > STEPS_DRIFT * least * sizes[:, None]).any(axis=0)
        if moved.tied:
            other = self._solve(taken, True, *given)
            tied |= (np.abs(v_end - other.v_end) > STALLED * largest + COMPUTED * least).any(axis=0)
        if tied.any():
            self.boundary |= Boundary.EVENTS_COINCIDE
            v_end[:, tied] = np.nan

    def _solve(
        self,
        taken: StepTaken,
        otherwise: bool,
        rows: _Rows,
        matrices: tuple[Array, Array, Array],
        changes: tuple[Array, Array, Array],
    ) -> _Moved:
        """Return the changes in a step from those of the forces at constant velocities and impulses. (D40)

        Ties are decided as in the step, or the opposite way if `otherwise`.
        """
        (total, inverse, softer), (middle, known, length) = matrices, changes
        jacobian, found, h, law = rows.jacobian, taken.found, taken.h, self._law(taken)
        response = np.asarray(inverse @ jacobian.T)
        largest = law.largest(response)
        softened = self._softened(rows, response, largest, (middle, length), softer)
        closing = rows.end + np.where(law.closes, 1.0 / h, 0.0)[:, None] * rows.gaps
        closing -= _outer(law.targets / h, length)
        impulses, by_friction = np.zeros((2, *rows.end.shape))
        for column, contact in enumerate(self._friction, known.shape[1] - len(self._friction)):
            of = taken.rows.contacts == contact
            by_friction[: 3 * len(of), column] = np.repeat(of, 3)
        data = Changes(jacobian, total, softer, middle, length, known, closing, softened, by_friction)
        v_end, forces = inverse @ known, np.zeros_like(total)
        course = law.iterations(response, largest, rows.slopes.of_mass)
        tied = iterate(law.numbers, rows.places, data, course, otherwise, v_end, impulses, forces)
        u_end, change = jacobian @ v_end + rows.end, response @ found.impulse
        after = forces @ middle + jacobian.T @ impulses - rows.slopes.of_mass(change) @ middle
        after -= _outer(softer * change, length)
        mean = np.asarray(inverse @ after / h - _outer(change / h**2, length))
        return _Moved(middle, v_end, mean, rows.start, u_end, length, rows, tied)

    def _softened(
        self,
        rows: _Rows,
        response: Array,
        largest: Integers,
        moved: tuple[Array, Array],
        softer: Array,
    ) -> Array:
        """Return the relative changes (rows, n) of the r of (16.3), with the largest rows of W."""
        middle, length = moved
        out = np.zeros((len(largest), middle.shape[1]))
        for top in set(largest.tolist()):
            y, k = response[:, top], top // 3
            turned = np.zeros(out.shape[1])
            if k < len(rows.slopes.rows):
                slopes = rows.slopes.rows[k].slopes(rows.slopes.tree.motions(y))
                turned = 2.0 * (rows.places.turns[k] @ slopes)[top % 3] @ middle
            turned = turned - y @ rows.slopes.of_mass(y) @ middle - y @ (softer * y) * length
            out[largest == top] = turned / max(rows.jacobian[top] @ y, TINY)
        return out

    def _rows(self, taken: StepTaken, moved: tuple[Array, Array, Array]) -> _Rows:
        """Return the rows of a step with their changes; `moved` is the result of `_middle`."""
        maps, every = self._maps(taken), np.vstack([moved[0], moved[1], moved[2][None]])
        if maps.slopes.features_meet:
            self.boundary |= Boundary.FEATURES_MEET
        return maps._replace(start=maps.start @ every, end=maps.end @ every, gaps=maps.gaps @ every)

    def _maps(self, taken: StepTaken) -> _Rows:
        """Return the rows with derivatives by the configuration, v and the step size: n = 2nv + 1."""
        if self._known is not None and self._known[0] is taken:
            return self._known[1]
        v, h = taken.v, taken.h
        nv = len(v)
        jacobian = self._law(taken).jacobian
        placed = PlacedRobot(self._model, self._data, taken.middle)
        slopes = RowSlopes(placed, *taken.near, self._spare, idle=taken.idle())
        turns = taken.axes @ np.array(slopes.axes).reshape(-1, 3, 3).transpose(0, 2, 1)
        start, end, gaps = np.zeros((3, len(jacobian), 2 * nv + 1))
        gaps[:, :nv] = start[:, nv:-1] = jacobian
        gaps[2 : 3 * len(turns) : 3, :nv] += slopes.slides
        places, moved = (
            Places(stacked(slopes.tree, slopes.rows), taken.axes, turns),
            np.empty((len(turns), 3, nv)),
        )
        for out, velocity in ((start, v), (end, taken.found.v_end)):
            row_slopes(places.rows, velocity, True, moved)
            out[: 3 * len(turns), :nv] = (turns @ moved).reshape(-1, nv)
        if taken.found.bent[0]:
            bends = row_bends(self._model, self._aside, h, slopes, places.rows, taken.middle, v)
            bends = less_turning(bends, places.rows, *turning(self._frames, v))
            every = np.concatenate(
                [0.5 * h * bends.by_q, 0.5 * h * bends.by_v, 0.5 * bends.bends[:, :, None]], 2
            )
            turned = (turns @ every).reshape(-1, 2 * nv + 1)
            start[: len(turned)] -= turned
            end[: len(turned)] += turned
            closed = 3 * np.flatnonzero(~taken.open_at_start(bends.bends[:, 2])) + 2
            gaps[closed] -= 0.25 * h * every[closed // 3, 2]
            gaps[closed, -1] -= 0.125 * h * bends.bends[closed // 3, 2]
        self._known = taken, _Rows(jacobian, slopes, places, start, end, gaps)
        return self._known[1]

    # ---- impacts, dense output and removal of overlap

    def _shift(self, moved: _Moved, taken: StepTaken, part: float, i: int) -> Array:
        """Return the change (n,) of the fraction of a step after which the i-th near gap closes. (D35)"""
        row, h = int(taken.rows.normals[i]), taken.h
        start, end = float(taken.found.u_start[row]), float(taken.found.u_end[row])
        by_start, by_end = moved.u_start[row], moved.u_end[row]
        gap = moved.rows.gaps[row] + h * (part - 0.5) * by_start
        gap = gap + 0.5 * h * part**2 * (by_end - by_start)
        gap += ((part - 0.5) * start + 0.5 * part**2 * (end - start)) * moved.length
        return np.asarray(-gap / (h * (start + part * (end - start))))

    def _within(self, x: Array, moved: _Moved, step: DenseStep, part: float, shift: Array) -> Array:
        """Return changes (2 nv, n) after a fraction of a step, which itself changes by `shift` (n,). (D34)"""
        nv, h, v, by_v, length = len(step.v), step.h, step.v, x[len(step.v) : 2 * len(step.v)], moved.length
        back, by_back = -0.5 * h * v, -0.5 * h * by_v - _outer(0.5 * v, length)
        last, by_last = turned_axes(self._frames, back, _taken(step).found.v_end, by_back, moved.v_end)
        mean, change, bend = 0.5 * (v + last), last - v, 0.5 * part * (1.0 - part)
        by_mean, by_change = 0.5 * (by_v + by_last), by_last - by_v
        xi = part * h * mean - bend * h * change
        by_xi = part * h * by_mean - bend * h * by_change
        by_xi += _outer(part * mean - bend * change, length)
        by_xi += _outer(h * mean - (0.5 - part) * h * change, shift)
        reached = by_v + part * by_change + _outer(change, shift)
        by_q = self._advanced(step.q, xi, x[:nv], by_xi)
        return np.vstack([by_q, turned_axes(self._frames, xi, v + part * change, by_xi, reached)[1]])

    def _removed(self, x: Array, taken: StepTaken) -> Array:
        """Return changes (2 nv, n) after the removal of overlap at the end of a step. (D36)"""
        model, (by_q, by_v) = self._model, np.split(x, 2)
        for xi, pushes, before, v, rows, near in taken.removals:
            placed = PlacedRobot(model, self._data, before)
            slopes = RowSlopes(placed, *near, self._spare)
            jacobian = dense(rows, len(xi))
            of_contacts = 3 * (len(rows.contacts) + len(rows.held))
            every = np.concatenate([rows.normals, rows.held_rows])
            acts = (pushes > 0.0) | (np.arange(len(pushes)) >= len(rows.normals))
            turned, world = np.zeros_like(jacobian), np.zeros((of_contacts // 3, 3))
            motions = slopes.tree.motions(xi)
            for k, row in enumerate(slopes.rows):
                turned[3 * k : 3 * k + 3] = row.slopes(motions)
            turned[2:of_contacts:3] += slopes.slides
            pushing = every < of_contacts
            world[every[pushing] // 3, every[pushing] % 3] = pushes[pushing]
            kept = jacobian[every[acts]]
            gaps = np.arange(len(every)) < len(rows.normals)  # not tangential rows of held contacts
            gaps |= every % 3 == 2
            bent = (slopes.forces(world) - slopes.of_mass(xi)) @ by_q
            mass = mass_matrix(self._model, self._data, before)
            solved = np.linalg.solve(mass, np.column_stack([bent, kept.T]))
            free, response = solved[:, : bent.shape[1]], solved[:, bent.shape[1] :]
            opened = -(kept @ free + (gaps[acts, None] * kept + turned[every[acts]]) @ by_q)
            impulses = limit_of_removal(kept @ response, opened)
            by_xi = free + response @ impulses
            by_q, by_v = (
                self._advanced(before, xi, by_q, by_xi),
                turned_axes(self._frames, xi, v, by_xi, by_v)[1],
            )
        return np.vstack([by_q, by_v])


def _outer(vector: Array, changes: Array) -> Any:
    """Return vector (k,) times changes (n,), (k, n); 0 if nothing changes, as most step sizes."""
    return np.outer(vector, changes) if changes.any() else 0.0


def _taken(step: DenseStep) -> StepTaken:
    """Return the data of a time step."""
    assert step.taken is not None
    return step.taken
