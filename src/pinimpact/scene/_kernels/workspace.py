"""The arrays of a scene by their addresses: one table crosses from Python, and from kernel to kernel.

Some fifty arrays would cost every call more than most calls do. A row of the table m (k, 4) is the address of
an array and its shape; whoever makes the table keeps the arrays alive, C-contiguous (`COLUMNS`:
Fortran-contiguous) and of float64, or of int64 where `i1` and `i2` read them.

The step under way (see `step`): `JOINTS` (k, 4) the table of `charts`; `Q0`, `V0` the state at its start;
`Q1`, `V1` at its end; `RATES` (16, 2 nv + 4) at its stages; `XI`, `SIZES` (nv,) scratch; `PEAK` (4, nv) see
`stages.largest`; `COEFFICIENTS` (7, 2 nv + 4) see `stages.interpolate`.

Pinocchio's side (see `motion`): `CALLS` (10,) addresses of functions and their arguments; `Q`, `V`, `TAU`
the buffers that these read; `GIVEN` (nv,) and `CLOCK` (1,) what the control returns and when it is asked;
`ACCELERATION`, `MINVERSE`, `PLACEMENT` (nj, 12), `LOCAL`, `SPATIAL`, `GAINED` (nj, 6), `COLUMNS` (6, nv)
where Pinocchio leaves v̇, M⁻¹, oMi, v, ov, oa_gf and J. `DAMPING`, `DRY` (nv,) friction of the joints, and
`SLIDING` (nv,) the dry one with its sign where a joint slides.

All contacts (see `touch`): `CONSTANTS` (n, 24); `ENDS` (n, 2) the joints of tip and plane; `WEIGHTS` (n, nv);
`GROUP` (nv,) the joint that each velocity belongs to; `FRICTION` (n,); `KEPT` (n,) the gap that each keeps
when closed; `BILATERAL` (n,) 1 for a held one. Joint limits: `INDEX_Q`, `INDEX_V`, `SIGN`, `BOUND` (nl,).

`STANDING` (n + nl + nv,) the mode of each contact, then 1 for each limit that is closed, then 1 for each
joint that its dry friction holds. From it `closing.lay_out` takes what is closed (see `sustained`): `WHICH`
(nc,) contact, `MODES`, `MU`, `REST` (nc,), `REFERENCE` (nc, 2), `SCALARS` (ns,) velocity indices, `LOWER`,
`UPPER` (ns,); and room for what an evaluation leaves: `ROWS` (nc, 3, nv), `VELOCITY`, `FREE_ACCELERATION`,
`SURFACE` (nc, 3), `GAP` (nc,), `DIRECTIONS` (nc, 2), `EQUATIONS`, `RESPONSE` (m, nv), `SYSTEM` (m, m),
`TARGET`, `SOLUTION` (m,), `FORCE` (nc, 3), `SCALAR_FORCE` (ns,). These have the size of everything that could
be closed; the table says how much of it counts.

`STATE` (11,) see `motion.STILL` and its neighbours.
"""

from __future__ import annotations

import numpy as np
from numba import carray, farray, types
from numba.extending import intrinsic

from ..._numeric.jit import inner

# as NumPy's integers, for literals would be compiled one by one
JOINTS, Q0, V0, Q1, V1, RATES, XI, SIZES, PEAK, COEFFICIENTS = np.arange(0, 10)
CALLS, Q, V, TAU, GIVEN, CLOCK, ACCELERATION, MINVERSE = np.arange(10, 18)
PLACEMENT, LOCAL, SPATIAL, GAINED, COLUMNS, DAMPING, DRY, SLIDING = np.arange(18, 26)
CONSTANTS, ENDS, WEIGHTS, GROUP, FRICTION, KEPT, BILATERAL = np.arange(26, 33)
INDEX_Q, INDEX_V, SIGN, BOUND, STATE, STANDING = np.arange(33, 39)
WHICH, MODES, MU, REFERENCE, REST, SCALARS, LOWER, UPPER = np.arange(39, 47)
ROWS, VELOCITY, FREE_ACCELERATION, SURFACE, GAP, DIRECTIONS = np.arange(47, 53)
EQUATIONS, RESPONSE, SYSTEM, TARGET, SOLUTION, FORCE, SCALAR_FORCE = np.arange(53, 60)


def _pointer_to(element):
    @intrinsic
    def pointer(typing_context, address):
        def generate(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

        return types.CPointer(element)(types.intp), generate

    return pointer


_doubles = _pointer_to(types.float64)
_integers = _pointer_to(types.int64)


# slices assigned at once and NumPy's searches take numba a second each to compile; these loops do not


@inner
def put(to, values):
    """Copy values (n,) into an array."""
    for i in range(len(to)):
        to[i] = values[i]


@inner
def positions(marks):
    """Return where an array (n,) of integers is not zero."""
    count = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            count += 1
    found = np.empty(count, dtype=np.int64)
    count = 0
    for i in range(len(marks)):
        if marks[i] != 0:
            found[count] = i
            count += 1
    return found


@inner
def d1(m, k):
    return carray(_doubles(m[k, 0]), (m[k, 1],))


@inner
def d2(m, k):
    return carray(_doubles(m[k, 0]), (m[k, 1], m[k, 2]))


@inner
def d3(m, k):
    return carray(_doubles(m[k, 0]), (m[k, 1], m[k, 2], m[k, 3]))


@inner
def f2(m, k):
    return farray(_doubles(m[k, 0]), (m[k, 1], m[k, 2]))


@inner
def i1(m, k):
    return carray(_integers(m[k, 0]), (m[k, 1],))


@inner
def i2(m, k):
    return carray(_integers(m[k, 0]), (m[k, 1], m[k, 2]))
