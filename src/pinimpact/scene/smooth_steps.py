"""Steps of smooth motion: choice of the method and of the step size. (theory.md, 9)"""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from ..arrays import Array
from ..errors import IrregularMotionError
from ._kernels import smooth_motion, step_dop853, step_radau, stiff_drives
from ._kernels.smooth_motion import BEYOND
from .dense_step import DenseStep
from .hybrid_state import HybridState
from .instant import Instant
from .step_memory import StepArrays

Outcome = tuple[DenseStep, float, float, Array, Array]
"""A step, the step size to try next if an event cuts it [s], the time of its first event [s] or ∞, and the
configuration (nq,) and velocity (nv,) where the next step starts if there is no event."""

HIGH_ORDER = 10
"""Number of steps before a lower order is tried again after its error was too large."""

LARGEST = 1.0, 1.0, 1.0, 0.1
"""Largest errors relative to the tolerance, by number of the explicit method. Those of the lowest order add
up, since steps that are cut short are many."""

UNCHANGED = 0.1
"""Ratio of the errors of two successive trial steps above which the error has not decreased with the step
size: by the order of the methods, halving the step reduces it further."""


class SmoothSteps:
    """Computes steps within the tolerances of the workspace.

    Args:
        instant: Holds the state, the dynamics and the rims.
        longest: Largest step size [s].
        jumps: Whether there is a control that may be discontinuous.
    """

    def __init__(self, instant: Instant, longest: float, jumps: bool) -> None:
        self._dynamics, self._rims = instant.dynamics, instant.rims
        self._charts = self._dynamics.work.joint_charts
        self._state: HybridState = instant.state
        self._longest, self._jumps = longest, jumps

    def replace_force(self, tau: Array, left: float) -> tuple[bool, Outcome | None]:
        """Replace the constant generalized force, and compute the next step where it is of low order.

        Args:
            tau: (nv,) the force from the present time on.
            left: Length of the step [s].

        Returns:
            Whether the motion continues; otherwise it has to be restarted. The step, or None.
        """
        state, work, error, time = self._state, self._dynamics.work, math.inf, -math.inf
        order, directions = 0, self._directions()
        if not self._rims and 0.9 * left < min(state.length, self._longest):
            order = self._low_order()
        if order > 0:
            work.method = order
            error, time = smooth_motion.step_under(work, tau, state.t, left, LARGEST[order])
        elif not smooth_motion.replace_force(work, tau):
            error = math.nan
        if math.isnan(error):
            return False, None
        state.bounce, memory = math.inf, self._dynamics.step_memory.copy(order)
        state.closed = state.closed and state.closed.under(memory.control_force, work.direction_speed)
        if LARGEST[order] < error < math.inf:
            self._postpone(order)
        if error > LARGEST[order] or time < state.t:
            return True, None
        return True, self._outcome((error, time, directions), left, state.length, memory)

    def compute(self, h: float, left: float) -> Outcome | IrregularMotionError:
        """Compute a step from the present state whose error is within the tolerances.

        Args:
            h: Step size to try [s].
            left: Largest step size [s].

        Returns:
            The step, the step size to try next if an event cuts it, and the time of the first event in it
            [s], infinite if there is none; or the error to raise if no step size is small enough.
        """
        state, work, t = self._state, self._dynamics.work, self._state.t
        # rejected steps show where a continuous control jumps, so the end of slip does not limit them
        ends = math.inf if self._jumps else BEYOND * work.slip_ends
        natural, h, previous_error = h, min(h, self._longest, BEYOND * state.bounce, ends), math.inf
        while True:
            trial = left if h > 0.9 * left else h
            if t + trial <= t:
                return IrregularMotionError(
                    f"rtol: the step size fell to {trial:.3g} s at t = {t:.6g} s; the motion is not "
                    "smooth (a discontinuous control, forces beyond bounds?), or the tolerance is too small",
                    value=work.rtol,
                )
            implicit = trial > work.stiff_length
            order = self._low_order() if trial == left and not implicit else 0
            work.method = step_dop853.IMPLICIT if implicit else order
            found = error, time, _ = self._attempt(t, trial, LARGEST[order])
            if error > LARGEST[order]:
                self._dynamics.check()
                state.rejected += 1
                if order > 0:
                    self._postpone(order)
                else:
                    natural = h = trial * (0.2 if math.isinf(error) else max(0.2, 0.9 * error**-0.125))
                    # a transient of the drives that decays within the step leaves the same error in slightly
                    # shorter steps: go to the step size at which the explicit method resolves it
                    if error > UNCHANGED * previous_error and work.drive_rate > 0.0:
                        natural = h = min(h, stiff_drives.STIFF / work.drive_rate)
                    previous_error = error
            elif time >= t:
                memory = self._dynamics.step_memory.copy(work.method)
                return self._outcome(found, trial, natural, memory)
            else:
                state.rejected += 1
                part = self._rims.turn() if self._rims else 1.0
                h = trial * (part if part < 1.0 else 0.5)

    def _low_order(self) -> int:
        """Return the number of the method to try for a step that ends at a given time."""
        state = self._state
        return bisect_right(state.low_orders_from, state.steps) if state.cut_short else 0

    def _postpone(self, order: int) -> None:
        """Postpone the use of a method of low order, and of the lower ones, after its error was too large."""
        higher, later = self._state.low_orders_from[: order - 1], self._state.steps + HIGH_ORDER
        self._state.low_orders_from = (*higher, later, later, later)[:3]

    def _outcome(
        self, found: tuple[float, float, Array | None], h: float, natural: float, memory: StepArrays
    ) -> Outcome:
        """Return a completed step of size h [s], from the results of `_attempt`."""
        state, work, (_, time, directions) = self._state, self._dynamics.work, found
        if not work.regular:
            self._dynamics.check()
        start = state.t, h, state.q, state.v, state.works, memory.dense_coefficients
        step = DenseStep(*start, self._charts, state.closed, directions)
        return step, natural, time, memory.q0, memory.v0

    def _directions(self) -> Array | None:
        """Return the directions of slip of an explicit step, see `DenseStep`."""
        work, slips = self._dynamics.work, self._state.closed is not None and self._state.closed.slips
        return np.array([work.start_directions, work.start_directions]) if slips else None

    def _attempt(self, t: float, h: float, largest: float) -> tuple[float, float, Array | None]:
        """Attempt a step of size h [s] by `work.method`, and complete it if its error is at most `largest`.

        Returns:
            The error relative to the tolerance; the time of the first event in the step [s], infinite if
            there is none, −∞ if the step has to be repeated; the directions of slip, see `DenseStep`.
        """
        work, directions = self._dynamics.work, self._directions()
        implicit = work.method == step_dop853.IMPLICIT
        if not (implicit or self._rims):  # in one call
            return *smooth_motion.explicit_step(work, t, h, largest), directions
        method = step_radau if implicit else step_dop853
        error, time = method.attempt(work, t, h, work.rtol, work.atol), -math.inf
        if directions is not None:
            directions[1] = work.end_directions
        if not error > largest and not (self._rims and self._rims.turn() < 1.0):
            time = smooth_motion.finish(work, t, h, error)
        return error, time, directions
