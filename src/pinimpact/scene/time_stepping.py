"""Time stepping: Moreau and Jean's scheme for the same scenes as the event-driven one.

All sustained contacts, joint limits and joints with dry friction of a step form one cone complementarity
problem at its midpoint. Contacts that close faster than a step can resolve are impacts, which cut the step
and follow the scene's law. (theory.md, section 16)
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._numeric.augmented_lagrangian import ITERATIONS
from .._numeric.tolerances import HALF_DIGITS
from ..arrays import Array, Integers
from ..errors import IrregularMotionError
from ..robot.placed_robot import PlacedRobot
from ._kernels.falling_asleep import trees_at_rest
from ._kernels.lie_charts import velocity_within
from ._kernels.midpoint_step import midpoint_step, near_rows
from ._kernels.overlap import least_displacement, overlap_at
from ._kernels.step_impulses import USABLE
from ._kernels.step_report import report_step
from ._kernels.step_rows import MeanForces, StepResult, StepRows, StepSystem, widest
from ._kernels.tolerances import STEPS_LONGER, STEPS_SHORTEST, STEPS_SLACK, STEPS_TOGETHER
from ._kernels.workspace import DENSE_TERMS
from .crowds import CROWDED, MOST_IMPACTS, UNLOCATED
from .dense_step import WORKS, DenseStep
from .event_watch import Interruption
from .facing_shapes import FacingShapes
from .forces import StepForces
from .integrator import Integrator
from .joint_charts import displaced
from .located_impacts import LocatedImpacts
from .rest import Rest
from .smooth_steps import Outcome
from .step_energy import StepEnergy
from .step_mass import StepMass, diverged
from .step_taken import Near, Removal, StepTaken
from .step_uniqueness import step_tolerances
from .stiffness import Stiffness

FAILED = 0.1
"""Largest acceptable residual of a contact problem, relative to its velocities."""

WHOLE, CUT, PASSED = range(3)
"""Outcome of a step: accepted to its end; accepted up to an impact or event in it; rejected, as solids may
pass through each other between midpoints or the control is unstable."""

MOST_REMOVALS = 10
"""Largest number of displacements that remove overlap at the end of a step; the rest is left to the next."""

_NO_NUMBERS = np.empty(0, dtype=np.int64)


class TimeStepping(Integrator):
    """A motion integrated by steps of length `dt`; see `Integrator`."""

    _prepared = _left = False
    _unlocated = False  # whether a contact has closed without its restitution
    _restitution: Array  # of the impacts left to the next step
    _rest: Rest
    _energy: StepEnergy
    _faces: FacingShapes

    def _prepare(self) -> None:
        self._dt = self.options.dt
        self.shapes.clear()  # the contacts reserved for pairs of shapes hold patches instead
        self._prepare_steps()
        self.work.sliding_friction[:] = 0.0

    def _prepare_steps(self) -> None:
        """Initialize the data of time steps, or reset them if they exist."""
        scene, model, work, state = self.scene, self.model, self.work, self.state
        if state.warm_start is None:
            state.warm_start = state.pushed = np.zeros(model.nv)
        if self._prepared:
            self._left, self._restitution[:] = False, 0.0
            self._rest.restart()
            self._faces.clear()
            return
        self._prepared, (self._touching, self._still) = True, step_tolerances(work, self.extent)
        self._rest, self._widest = Rest(model, work, state), widest(work.velocity_parent)
        self._tree, self._trees = self._rest.tree, int(self._rest.tree.max()) + 1
        self._start = np.unique(self._tree, return_index=True)[1][self._tree]
        of_scene = model, self.dynamics, scene.layout(), self.shapes
        self._faces = FacingShapes(*of_scene, self._rest.joints, self._touching)
        self._mass = StepMass(model, self.data, work, self._tree)
        self._energy = StepEnergy(model, self.data, work.resting_speed)
        self._no_change, self._gravity = np.zeros(model.nv), float(np.linalg.norm(model.gravity.linear))
        self._impacts = LocatedImpacts(scene, self.dynamics, self._rest, self._faces.ties)
        self._restitution, self._stiffness = np.zeros(len(self._impacts.now)), Stiffness()
        self._compliances = np.array([1.0 / c.stiffness for c in self.dynamics.contacts])
        self._held, self._dry = np.flatnonzero(work.bilateral), np.flatnonzero(work.dry_friction)
        self._near = np.empty(work.contacts + work.limits, dtype=np.int64)

    def begin(self, tau: Array | None = None) -> None:
        """Process the impacts and events at the start; see `Integrator.begin`."""
        if self.sampled is not None:
            tau = self.sampled.at(self.state.t, self.state.q, self.state.v)
        if tau is not None:
            self.work.control_force[:] = tau
        if self.rims:
            self.rims.choose(self.state.q, self.state.v, self._dt, self._touching)
        self._collide()
        self._trigger_events()
        self.state.length = self._dt

    def hold_force(self, tau: Array, left: float) -> Outcome | None:
        """Replace the constant generalized force; see `Integrator.hold_force`."""
        if not np.array_equal(tau, self.work.control_force):
            self._rest.wake_all()
        self.work.control_force[:] = tau
        return None

    def _settle_contacts(self, arriving: Any = None) -> None:
        self._rest.wake_all()
        self._collide()

    def _settle_and_begin(self, arriving: Any = None) -> None:
        TimeStepping._settle_contacts(self)
        self._trigger_events()

    def _restart_after(self, interruption: Interruption) -> None:
        """Apply the velocity of a user event, with the impulses of held contacts that it violates."""
        Integrator._restart_after(self, interruption)
        state, held = self.state, np.flatnonzero(self.work.bilateral).tolist()
        if interruption.velocity is None or not held:
            return
        motion = self.dynamics.free_motion_at(state.t, state.q, state.v, held)
        rows = motion.jacobian.reshape(-1, len(state.v))
        response = np.linalg.solve(PlacedRobot(self.model, self.data, state.q).mass_matrix(), rows.T)
        impulse = np.linalg.lstsq(rows @ response, -motion.velocity.ravel(), rcond=HALF_DIGITS)[0]
        self.instant.change_velocity(state.v + response @ impulse)

    def _step(self, h: float, stop: float, scale: float, begun: Outcome | None = None) -> float:
        """Take one step, with the impacts in it; return the size of the next [s]."""
        state = self.state
        if self.record.keeps_steps:  # derivatives need the steps of bodies at rest too
            self._rest.wake_all()
        longest = math.inf if self._rest.complete and not self.events else self._dt  # if all is at rest
        left, struck = min(longest, stop - state.t), 0
        negligible = HALF_DIGITS * min(left, self._dt)
        if stop - state.t - left < negligible:
            left = stop - state.t
        self._stiffness.restart()
        begin, end = state.t, state.t + left
        ends = [end]
        while ends and self.state.ended_by is None:
            if ends[-1] - state.t <= negligible:
                begin = ends.pop()
                continue
            outcome = self._take_step(ends[-1] - state.t, struck < MOST_IMPACTS and not self._left)
            struck += outcome == CUT
            if outcome == PASSED:  # bisect the original step: its times do not depend on the motion
                while (middle := 0.5 * (begin + ends[-1])) <= state.t:
                    begin = middle
                ends.append(middle)
        if self.state.ended_by is None:
            state.t = self.record.dense_steps[-1].end = stop if end == stop else end
        state.steps += 1
        self._sample()
        return self._dt

    # ---- one step

    def _take_step(self, h: float, strikes: bool) -> int:
        """Take a step up to its end or to the first impact or event in it.

        Args:
            h: Step size [s].
            strikes: Whether contacts that close fast are impacts; else they close without restitution.

        Returns:
            `WHOLE` or `CUT` if the step is accepted, `PASSED` if it is rejected.
        """
        state, before = self.state, (self.state.pushed, self.state.step_before)
        middle, v = displaced(self.work.joint_charts, state.q, state.v, 0.5 * h * state.v)
        may_be_halved = h > max(STEPS_SHORTEST * self._dt, 4.0 * math.ulp(state.t))
        if may_be_halved and self._faces.may_pass(middle, v, h):
            return PASSED
        if h > STEPS_LONGER * state.step_before:
            state.pushed = self._no_change
        state.step_before = h
        t, pushed = state.t, state.pushed
        self._faces.place(middle, v, h)
        if self.rims:
            self.rims.choose(middle, v, h, self._touching)
        if self.dynamics.driven:
            self.dynamics.set_saturation(middle, v)
        rows, system, found, (share, lost, overlap) = self._solve(t, h, (middle, v), strikes)
        if may_be_halved and self._stiffness.rejects(float(found.stiffness[0]), h):
            state.pushed, state.step_before = before
            return PASSED
        step, axes = self._dense_step(t, h, v, (system, rows, found))
        step.end = t + share * h
        if may_be_halved and self._energy.is_gained(step, lost):
            state.pushed, state.step_before = before
            return PASSED
        if self.record.keeps_steps:
            step.taken = self._step_data(h, (middle, v), (system.softened, pushed), axes, rows, found)
        near = rows.near(self.work.contacts)
        stops = found.fast & self._impacts.now[near] & (found.impulse[rows.normals] > 0.0)
        if stops.any() and not (strikes or self._left):
            self._unlocated = True
            self.record.note_once(t, UNLOCATED)
        closing = strikes & found.arrives & (found.gap_end < 0.0) & self._impacts.now[near]
        if closing.any():
            rates = -(found.u_start + share * (found.u_end - found.u_start))[rows.normals]
            slowest, fastest = 0.5 * float(rates[closing].min()), float(rates[closing].max())
            soon = STEPS_TOGETHER * h
        self.record.modes.update(t, self.work.modes, self.work.drive_side)
        self.record.dense_steps.append(step)
        if self.events:
            interruption = self.events.within(step, step.end)
            if interruption is not None:
                self._interrupt(step, interruption)
                return CUT
        state.works, state.impact_energy = step.work_at(step.end), state.impact_energy + lost
        state.t, (state.q, _), v_end = step.end, step.at(step.end), np.empty(len(v))
        velocity_within(self.work.joint_charts, h, share, state.v, found.v_end, v_end)
        state.v = v_end
        if closing.any():
            self._sample()
            if step.taken is not None:
                gaps = found.gaps_at(share, h, rows)
                touches = closing & (gaps <= np.maximum(self._touching, soon * rates))
                step.taken.arriving = tuple(np.flatnonzero(touches).tolist())
            pressed = np.zeros(len(self._near), dtype=bool)
            pressed[near] = found.impulse[rows.normals] > 0.0
            self._collide(slowest, soon, fastest, step.taken, pressed)
            return CUT
        active, moved, self._left, self._restitution[:] = ~found.arrives, self._no_change, False, 0.0
        if overlap > max(self._touching, self._closable_overlap(h, found)):
            moved = self._remove_overlap(step, h, overlap, system)
        if self._continuous is None and step.taken is None:
            self._set_resting(step, rows, active, (v, v_end, moved / h))
        return WHOLE

    def _solve(
        self, t: float, h: float, middle: tuple[Array, Array], strikes: bool
    ) -> tuple[StepRows, StepSystem, StepResult, tuple[float, float, float]]:
        """Solve the equations of a step. (16.1), (16.2)

        Contacts that the forces and impulses of the step drive together are added until none is missing.

        Args:
            t: Start of the step [s].
            h: Step size [s].
            middle: (nq,) configuration at the midpoint, and (nv,) velocity at the start, in the axes of the
                midpoint.
            strikes: See `_take_step`.

        Returns:
            The rows, matrices and result of the step, and what `close_gaps` returns.
        """
        state, (q, v), slack = self.state, middle, STEPS_SLACK * h * h * self._gravity
        terms, pushed = self._mass.compute(t, q, h), state.pushed
        self._impacts.restart()
        system = StepSystem(
            *(self._mass.matrix, self._mass.inverse, *terms, self._tree, self._start),
            *(self._rest.joints, self._impacts.now, self._restitution, self._compliances, self._gravity),
        )
        state.warm_start = np.array(state.warm_start)
        rows, room = self._rows(q, v, h, slack, self._faces.boxes), ITERATIONS * self.record.keeps_steps
        while True:
            found, state.pushed = rows.room(len(v), room), np.array(pushed)
            residual, *ends = midpoint_step(
                *(self.work, t + 0.5 * h, h, q, v, strikes),
                *(system, rows, state.warm_start, state.pushed, found),
            )
            self.dynamics.check()
            self._check_result(t, residual, found)
            driven = self._near_numbers(q, found.v_end, 2.0 * h, -self._touching, False)
            known = rows.near(self.work.contacts)
            joined = np.zeros(len(self._near), dtype=bool)
            joined[known] = True
            if not joined[driven].all():
                rows = self._rows(q, v, h, slack, False, np.union1d(known, driven))
            elif not (strikes and self._impacts.join(known, rows, found)):
                break
        if residual > max(USABLE, state.unsolved):
            if state.unsolved == 0.0:
                self.instant.note(f"A contact problem was solved only to {residual:.2g} of its velocities.")
            state.unsolved = residual
        return rows, system, found, (ends[0], ends[1], ends[2])

    def _check_result(self, t: float, residual: float, found: StepResult) -> None:
        """Raise an error if the velocities are not finite or the contact problem is not solved."""
        if not np.isfinite(found.v_end).all():
            raise diverged(t)
        if residual > FAILED:
            raise IrregularMotionError(
                f"scene: the contact problem of the time step at t = {t:.6g} s is not solved: the "
                f"impulses violate Coulomb's law by {residual:.2g} of its velocities; another dt may help"
            )

    def _set_resting(
        self,
        step: DenseStep,
        rows: StepRows,
        active: NDArray[np.bool_],
        velocities: tuple[Array, Array, Array],
    ) -> None:
        """Set the islands at rest that have come to rest in a step.

        Args:
            step: The step.
            rows: Its rows.
            active: (nc + nl,) whether each contact and limit took part in it.
            velocities: (nv,) velocity at its start, at its end, and of the removal of overlap.
        """
        nc, every, pushed = len(rows.contacts), len(rows.surface), self.state.pushed
        assert pushed is not None
        items = np.ones(len(rows.counts) - 2 * nc, dtype=bool)
        items[:nc] = active[:nc]
        items[3 * every - 2 * nc :][: len(rows.limits)] = active[nc:]
        islands = np.empty(self._trees, dtype=np.int64)
        trees_at_rest(
            *(*velocities, step.h * pushed, self.work.joint_metres, self._still, self._tree),
            *(rows.columns, rows.counts),
            *(nc, items, rows.surface, islands),
        )
        if step.closed is not None and self._rest.begin(islands, step.closed):
            velocities[1][islands[self._tree] >= 0] = 0.0

    def _near_numbers(self, q: Array, v: Array, h: float, slack: float, placed: bool) -> Integers:
        """Return the numbers of the contacts and limits that may close within a step.

        Args:
            q: (nq,) configuration at the midpoint.
            v: (nv,) velocity.
            h: Step size [s].
            slack: Distance by which gaps may close in addition to their rates [m].
            placed: Whether the kinematics are those of this state already.
        """
        near, joints = self._near, self._rest.joints
        return near[: near_rows(self.work, q, v, h, slack, joints, placed, near)]

    def _rows(
        self, q: Array, v: Array, h: float, slack: float, placed: bool, others: Integers = _NO_NUMBERS
    ) -> StepRows:
        """Return the rows of the contacts and limits that may close within a step, with uninitialized values.

        Islands at rest that a moving body may touch are woken. The arguments are those of `_near_numbers` and
        the numbers of other contacts and limits to include.
        """
        work, held, dry, rest = self.work, self._held, self._dry, self._rest
        while True:
            near = self._near_numbers(q, v, h, slack, placed)
            near = np.union1d(near, others) if len(others) else near
            first = int(np.searchsorted(near, work.contacts))
            contacts, limits = near[:first].copy(), near[first:] - work.contacts
            if not rest:
                break
            ends = work.contact_joints[contacts].ravel()
            met = ends[(ends > 0) & rest.joints[ends]]
            if not met.size:
                held = held[~rest.joints[work.contact_joints[held]].all(axis=1)]
                dry = dry[~rest.joints[work.velocity_joint[dry]]]
                break
            rest.wake(met)
        every = len(contacts) + len(held)
        shape = 3 * every + len(limits) + len(dry), self._widest
        return StepRows(
            *(contacts, held, limits, dry),
            *(np.empty(shape), np.empty(shape, dtype=np.int64), np.empty(shape[0], dtype=np.int64)),
            *(np.empty((every, 3)), np.empty(every + len(limits))),
        )

    def _dense_step(
        self, t: float, h: float, v: Array, solved: tuple[StepSystem, StepRows, StepResult]
    ) -> tuple[DenseStep, Array]:
        """Return a step with dense output and forces, and the axes of its contacts; set the contact modes."""
        work, state, (system, rows, found) = self.work, self.state, solved
        coefficients = np.zeros((DENSE_TERMS, 2 * work.nv + WORKS))
        contacts = np.concatenate([rows.contacts, rows.held])
        world, points = np.zeros((2, len(contacts), 3))
        mean = MeanForces(world, points, np.empty((len(contacts), 3, 3)), np.zeros(work.nv))
        acts = report_step(work, h, self._still, state.v, v, system, rows, found, coefficients, mean)
        step = DenseStep(t, h, state.q, state.v, state.works, coefficients, work.joint_charts)
        resting = self._rest.forces
        if acts or resting is not None:
            step.closed = StepForces.of(work, rows, found, mean, resting)
        return step, mean.axes

    def _step_data(
        self,
        h: float,
        middle: tuple[Array, Array],
        velocities: tuple[Array, Array | None],
        axes: Array,
        rows: StepRows,
        found: StepResult,
    ) -> StepTaken:
        """Return the data of a step from which its derivatives are computed."""
        work, (softened, pushed) = self.work, velocities
        assert pushed is not None
        follows = np.zeros(len(softened), dtype=bool)
        follows[work.drive_velocity] = work.drive_side[work.drive_velocity] == 0
        given = h, *middle, softened, pushed, follows, self._near_of(rows), axes
        rest = self._impacts.now[rows.near(work.contacts)], self._touching, self._closable_overlap(h, found)
        return StepTaken(*given, rows, found.kept(), *rest)

    def _closable_overlap(self, h: float, found: StepResult) -> float:
        """Return the largest overlap [m] that the velocities of the next step close."""
        return h * self.work.resting_speed if found.bent[0] else 0.0

    def _near_of(self, rows: StepRows) -> Near:
        """Return the contacts of some rows, with the corners that represent contacts of two shapes now."""
        every = self._faces.corners()
        contacts = tuple(self.dynamics.contacts[i] for i in (*rows.contacts, *rows.held))
        return Near(contacts, {k: every[i] for k, i in enumerate(rows.contacts.tolist()) if i in every})

    def _remove_overlap(self, step: DenseStep, h: float, depth: float, system: StepSystem) -> Array:
        """Remove the overlap at the end of a step; return the displacement (nv,).

        It is the least displacement in the metric of M for linearized gaps, and is repeated: it may bring
        other points into contact, and gaps are not linear. The linear velocities of free bodies are kept in
        world axes. (theory.md, 16)

        Args:
            step: The step, whose end is displaced.
            h: Step size [s].
            depth: The largest overlap [m].
            system: Matrices of the step.
        """
        state, nv, v = self.state, self.model.nv, self.state.v
        moved, still, start = np.zeros(nv), np.zeros(nv), (state.q, v)
        for _ in range(MOST_REMOVALS):
            self._faces.place(state.q, state.v, h)
            rows = self._rows(state.q, still, h, depth, False)
            depth = overlap_at(self.work, state.q, state.v, rows)
            if depth <= self._touching:
                break
            self._mass.invert(state.t, state.q, self._no_change)
            correction, pushes = np.empty(nv), np.empty(len(rows.gap) + 2 * len(rows.held))
            least_displacement(system, rows, correction, pushes)
            if step.taken is not None:
                near = self._near_of(rows)
                step.taken.removals.append(Removal(correction, pushes, state.q, state.v, rows, near))
            state.q, state.v = displaced(self.work.joint_charts, state.q, state.v, correction)
            moved += correction
        energy = self._energy
        state.impact_energy += energy.kinetic(state.q, state.v) - energy.kinetic(*start)
        state.impact_energy += energy.potential(state.q) - energy.potential(start[0])
        step.coefficients[0, : 2 * nv] += np.concatenate([moved, state.v - v])
        return moved

    # ---- impacts

    def _collide(
        self,
        slowest: float = 0.0,
        soon: float = 0.0,
        fastest: float = 0.0,
        taken: StepTaken | None = None,
        pressed: NDArray[np.bool_] | bool = False,
    ) -> None:
        """Resolve the impacts of this instant.

        Args:
            slowest: Speed of approach above which a contact collides [m/s], at least the resting speed.
            soon: Time within which contacts that touch close [s].
            fastest: Their largest speed of approach [m/s].
            taken: Data of the step that ends here, if it is to be differentiated.
            pressed: See `Instant.collide`.
        """
        state, before = self.state, len(self.record.impacts)
        self._faces.place(state.q, state.v, 0.0, touching=max(self._touching, soon * fastest))
        if taken is not None:
            taken.struck = self._faces.corners()
        left = self.instant.collide(self._touching, soon, slowest, self._dt * self._gravity, pressed)
        if left:
            self._left, self._restitution[list(left)] = True, list(left.values())
            self.record.note_once(self.state.t, CROWDED)
        if len(self.record.impacts) > before:
            self._rest.wake_moving(state.v)
            self.progress.count_impacts(before)
            self._sample()
