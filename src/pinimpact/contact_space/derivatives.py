"""Derivatives of an impact in contact space. (docs/derivatives.md)"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Integers
from ..errors import InputError
from ..status import Sentences, Status
from .inputs import ENTRY, FACTOR, Array, Inputs
from .one_sided import fill_one_sided_of_problem


class Boundary(Sentences):
    """Where the derivatives of an impact have sides, or end; ``describe()`` gives a sentence for each flag.

    Columns that have no derivative hold NaN. (docs/derivatives.md, 6)
    """

    NONE = 0
    START_AT_REST = 1, "v_t° = 0 and slip begins: v⁺ has slopes along directions of v_t° only."
    STICK_THRESHOLD = 2, "The contact is at the threshold between stick and slip."
    EVENTS_COINCIDE = 4, "Events coincide, such as the end of slip and that of compression."
    JUMP = 8, "v⁺ jumps here, or nearly has a slope without bound."
    GRAZING = 16, "v₃° = 0: there is an impact on one side only."
    BOUND = 32, "μ = 0, e = 0 or e = 1: slopes by it are those into the range."
    RANK = 64, "W is singular, or nearly: derivatives hold for changes that keep its rank and range."
    CLOSED = 128, "Contacts or limits are closed at the start: changes that open them are projected."
    LAST_BOUNCE = 256, "Bounces ended at the resting speed: those that would follow do not count."
    FEATURES_MEET = 512, "Shapes touch where a face ends, or corner on corner: the normal turns abruptly."


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Derivatives:
    """How v⁺ and P change with v°, W, μ and e, in contact axes; of N impacts with a first axis (N,).

    For a symmetric δW the change of v⁺ₖ is Σᵢⱼ ``dv_ddelassus[k, i, j]`` δWᵢⱼ. Of an impact at n contacts
    each (3,) of v and P is (n, 3), W is (3n, 3n), and μ and e are (n,): ``dv_ddelassus`` is (n, 3, 3n, 3n).

    Attributes:
        dv_dv: (3, 3) ∂v⁺/∂v°.
        dv_ddelassus: (3, 3, 3) ∂v⁺/∂W [kg m/s].
        dv_dfriction: (3,) ∂v⁺/∂μ [m/s].
        dv_drestitution: (3,) ∂v⁺/∂e [m/s].
        dP_dv: (3, 3) ∂P/∂v° [kg].
        dP_ddelassus: (3, 3, 3) ∂P/∂W [kg² m/s].
        dP_dfriction: (3,) ∂P/∂μ [N s].
        dP_drestitution: (3,) ∂P/∂e [N s].
        boundary: `Boundary`; of N impacts (N,) its integer values.
    """

    dv_dv: Array
    dv_ddelassus: Array
    dv_dfriction: Array
    dv_drestitution: Array
    dP_dv: Array
    dP_ddelassus: Array
    dP_dfriction: Array
    dP_drestitution: Array
    boundary: Any

    def __repr__(self) -> str:
        return f"Derivatives(dv_dv={self.dv_dv.tolist()}, boundary={self.boundary!r})"


def named_derivatives(slopes: Array, boundary: Any) -> Derivatives:
    """Return the `Derivatives` of slopes (…, 6, 14) by `differentiate_rows`, as views."""
    return Derivatives(*_parts(slopes[..., :3, :]), *_parts(slopes[..., 3:, :]), boundary)


def _parts(rows: Array) -> tuple[Array, Array, Array, Array]:
    by_delassus = rows[..., 3:12].reshape(*rows.shape[:-1], 3, 3)
    return rows[..., :3], by_delassus, rows[..., 12], rows[..., 13]


def empty_results(count: int) -> tuple[Array, Integers, Array, Integers]:
    """Return arrays for v⁺ and P (N, 7), codes (N, 3), slopes (N, 6, 14) and boundaries of N problems."""
    integers = np.empty((count, 3), dtype=np.int64), np.empty(count, dtype=np.int64)
    return np.empty((count, 7)), integers[0], np.empty((count, 6, 14)), integers[1]


def derivatives_of(inputs: Inputs, side: int | None = None) -> Derivatives:
    """Return the derivatives of a problem that has a solution; for `side` see `solve_impact`."""
    values, slopes, boundary, _ = _differentiated(inputs)
    if side is not None:
        fill_one_sided_of_problem(inputs, slopes, values, side, _answered)
    return named_derivatives(slopes, Boundary(boundary))


def _differentiated(inputs: Inputs) -> tuple[Array, Array, int, int]:
    """Return v⁺ and P (6,) of a problem, their slopes (6, 14), `Boundary` and status."""
    from ._kernels.derivatives import differentiate_rows

    mu, e, law, scale, factor = inputs[9:]
    matrix, velocity = np.array([inputs[:6]])[:, ENTRY], np.array([inputs[6:9]])
    mu, e, scale = np.array([[mu], [e], [scale]])
    results = numbers, codes, slopes, boundary = empty_results(1)
    differentiate_rows(matrix, velocity, mu, e, law, scale, factor.reshape(-1, FACTOR), *results)
    return numbers[0, :6], slopes[0], int(boundary[0]), int(codes[0, 0])


def _answered(inputs: Inputs) -> tuple[Array, Array] | None:
    values, slopes, _, status = _differentiated(inputs)
    return (values, slopes) if 0 <= status <= Status.LOCKED else None


def check_derivatives(wanted: bool, method: str) -> None:
    """Raise `InputError` for derivatives by another method than "exact"."""
    if wanted:
        raise InputError(
            f'derivatives: not available for the method {method!r}; use method="exact"', value=wanted
        )
