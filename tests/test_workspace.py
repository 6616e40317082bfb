"""Workspaces: declared fields in Python and in compiled code."""

from __future__ import annotations

import copy
import gc
import os
import pickle
import subprocess
import sys
import weakref

import numba
import numpy as np
import pytest

from pinimpact._compile.workspace import Workspace, count, flag, integer, integers, real, reals, size


class Sample(Workspace):
    """A workspace with one field of each kind."""

    rows = size("rows")
    columns = size("columns")
    active = count("rows", "rows in use")
    total = integer("an integer")
    factor = real("a number")
    ready = flag("a truth value")
    table = reals("rows", "columns", meaning="by rows")
    turned = reals("rows", "columns", order="F", given=True, meaning="by columns")
    front = reals("active", meaning="what is in use")
    square = reals("active", "active", meaning="a matrix of what is in use")
    blocks = reals("active", 3, "columns", meaning="three dimensions")
    marks = integers("rows", meaning="integers")


def sample(rows=4, columns=3, **arrays):
    turned = np.asfortranarray(np.zeros((rows, columns)))
    return Sample({"rows": rows, "columns": columns}, {"turned": turned, **arrays})


@numba.njit
def write(work, active):
    """Set each entry of all fields to a number that depends on its indices."""
    work.active = active
    work.factor = 2
    work.total += 3
    work.ready = work.factor == 2.0
    for i in range(work.rows):
        work.marks[i] = i
        for j in range(work.columns):
            work.table[i, j] = 10 * i + j
            work.turned[i, j] = -(10 * i + j)
    for a in range(len(work.front)):
        work.front[a] = a + 0.5
        for b in range(work.square.shape[1]):
            work.square[a, b] = 10 * a + b
        for k in range(3):
            for j in range(work.blocks.shape[2]):
                work.blocks[a, k, j] = 100 * a + 10 * k + j


@pytest.mark.parametrize("function", [write, write.py_func], ids=["compiled", "Python"])
def test_values_written_by_kernels_are_read_in_python(function):
    work = sample()
    function(work, 2)
    function(work, 2)
    assert (work.active, work.total, work.factor, work.ready) == (2, 6, 2.0, True)
    places = np.add.outer(10.0 * np.arange(4), np.arange(3))
    assert np.array_equal(work.table, places)
    assert np.array_equal(work.turned, -places)
    assert work.turned.flags.f_contiguous
    assert np.array_equal(work.front, [0.5, 1.5])
    assert np.array_equal(work.square, [[0, 1], [10, 11]])
    assert work.blocks.shape == (2, 3, 3)
    assert work.blocks[1, 2, 1] == 121
    assert np.array_equal(work.marks, np.arange(4))


def test_given_arrays_are_used_in_place():
    table = np.zeros((4, 3))
    work = sample(table=table)
    write(work, 1)
    assert table[3, 2] == 32
    assert work.table is table


@pytest.mark.parametrize("function", [write, write.py_func], ids=["compiled", "Python"])
@pytest.mark.parametrize("active", [5, -1])
def test_count_out_of_range_raises(function, active):
    work = sample()
    with pytest.raises(ValueError, match="active"):
        function(work, active)
    assert work.active == 0


def test_numbers_and_counts_can_be_set_but_not_sizes_and_arrays():
    work = sample()
    work.active, work.factor, work.ready = 4, 0.25, True
    assert (work.active, work.factor, work.ready) == (4, 0.25, True)
    with pytest.raises(ValueError, match="active: 5 given, 0 to rows = 4 expected"):
        work.active = 5
    with pytest.raises(AttributeError, match="rows cannot be set"):
        work.rows = 7
    with pytest.raises(AttributeError, match="table cannot be set"):
        work.table = np.zeros((4, 3))


@pytest.mark.parametrize("name", ["rows", "table"])
def test_kernels_cannot_set_arrays_or_sizes(name):
    source = {"rows": lambda work: work.rows, "table": lambda work: work.table}[name]

    @numba.njit
    def set_again(work):
        work.rows = 3

    @numba.njit
    def move(work):
        work.table = np.zeros((4, 3))

    work = sample()
    before = source(work)
    with pytest.raises(numba.core.errors.NumbaError, match=f"{name} cannot be set"):
        (set_again if name == "rows" else move)(work)
    assert source(work) is before or source(work) == before


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((4, 4)),
        np.zeros((4, 3), dtype=np.float32),
        np.zeros((4, 3), dtype=np.int64),
        np.asfortranarray(np.zeros((4, 3))),
        np.zeros((8, 3))[::2],
    ],
    ids=["shape", "precision", "integers", "order", "strides"],
)
def test_array_unlike_its_declaration_raises(array):
    with pytest.raises(ValueError, match=r"^table: .* expected \(by rows\)"):
        sample(table=array)


def test_missing_or_unknown_fields_raise():
    with pytest.raises(ValueError, match="turned: missing"):
        Sample({"rows": 4, "columns": 3}, {})
    with pytest.raises(ValueError, match=r"sizes: \['rows'\] given"):
        Sample({"rows": 4}, {})
    with pytest.raises(ValueError, match=r"\['tabel'\]"):
        sample(tabel=np.zeros((4, 3)))


def test_workspace_cannot_be_copied_pickled_or_moved():
    work = sample()
    with pytest.raises(TypeError, match="addresses"):
        pickle.dumps(work)
    with pytest.raises(TypeError, match="addresses"):
        copy.copy(work)
    with pytest.raises(BufferError):
        work.append(0)


def test_types_of_workspaces_are_dispatched_without_python(monkeypatch):
    # numba would take two subclasses of bytearray for one type, and call Python for the second at each call
    class Other(Workspace):
        """Another declaration."""

        length = size("of nothing")

    @numba.njit
    def length(work):
        return work.length

    @numba.njit
    def columns(work):
        return work.columns

    one, other = sample(), Other({"length": 7}, {})
    assert (columns(one), length(other)) == (3, 7)
    monkeypatch.setattr(type(columns), "typeof_pyval", None)
    assert (columns(one), length(other)) == (3, 7)


def test_type_depends_on_declaration():
    class Other(Workspace):
        """The same fields in another order."""

        columns = size("columns")
        rows = size("rows")

    class Same(Workspace):
        """The same fields with other meanings."""

        columns = size("how many across")
        rows = size("how many down")

    assert Other.numba_type == Same.numba_type
    assert Other.numba_type != Sample.numba_type


FALL = """
import numpy as np, pinocchio as pin
from pinimpact import Contact, Plane, Scene, simulate
model = pin.Model()
joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
model.addFrame(pin.Frame("center", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
scene = Scene(model, [Contact("center", Plane(), radius=0.1, friction=0.3, restitution=0.0)])
run = simulate(scene, [0, 0, 0.2, 0, 0, 0, 1], [1.0, 0, 0, 0, 0, 0], 0.3)
print(" ".join(repr(float(x)) for x in (*run.q[-1], *run.v[-1], run.impacts[0].time)))
"""


def test_scenes_run_without_compiler():
    """The motion of a ball is the same with compiled kernels and in plain Python."""
    runs = []
    for disabled in ("0", "1"):
        environment = {**os.environ, "NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(
            [sys.executable, "-c", FALL], env=environment, capture_output=True, text=True, check=True
        )
        runs.append([float(x) for x in done.stdout.split()])
    assert runs[1] == pytest.approx(runs[0], abs=1e-12)
    assert runs[1][-1] == pytest.approx(np.sqrt(2 * 0.1 / 9.81), rel=1e-12)


def test_set_values_copies_values_but_not_addresses():
    one, other = sample(), sample()
    write(one, 2)
    turned, addresses = other.turned, other.integers[[Sample.table.slot, Sample.turned.slot]].copy()
    other.set_values(one.values())
    assert other.turned is turned
    assert (other.integers[[Sample.table.slot, Sample.turned.slot]] == addresses).all()
    for name in ("active", "total", "factor", "ready", "table", "front", "square", "blocks", "marks"):
        assert np.array_equal(getattr(other, name), getattr(one, name))
    assert not turned.any()  # given arrays are not copied
    one.table[:] = 7.0
    assert (other.table != 7.0).all()


class Growing(Workspace):
    """A workspace whose size can grow."""

    room = size("room")
    columns = size("columns")
    active = count("room", "in use")
    front = reals("active", meaning="what is in use")
    square = reals("active", "active", meaning="a matrix of what is in use")
    flat = reals(2, "active", "columns", meaning="three dimensions")
    other = reals("columns", meaning="of another size")


@numba.njit
def total_of(work):
    """Return a weighted sum of the entries in use."""
    return work.front.sum() + 100.0 * work.square.sum() + 1e4 * work.flat[1].sum()


def test_enlarge_keeps_entries_in_use():
    work = Growing({"room": 2, "columns": 3}, {})
    work.active = 2
    work.front[:], work.square[:], work.other[:] = [1.0, 2.0], [[3.0, 4.0], [5.0, 6.0]], 9.0
    work.flat[:] = np.arange(12.0).reshape(2, 2, 3)
    before = total_of(work)
    other = work.other
    with pytest.raises(ValueError, match="active: 3 given, 0 to room = 2 expected"):
        work.active = 3
    values = work.values()
    work.enlarge({"room": 5})
    work.active = 5
    work.set_values(values)  # values of the previous size
    assert (work.room, work.active, total_of(work)) == (2, 2, before)
    work.enlarge({"room": 5})
    assert (work.room, work.active, total_of(work)) == (5, 2, before)
    assert np.array_equal(work.flat, np.arange(12.0).reshape(2, 2, 3))
    assert np.array_equal(work.other, other)
    work.enlarge({"room": 3})  # no effect
    work.active = 5
    assert (work.room, work.square.shape) == (5, (5, 5))
    work.square[:] = 1.0
    work.front[:] = work.flat[:] = 0.0
    assert total_of(work) == 2500.0


def test_unreferenced_workspace_is_freed():
    work = sample()
    write(work, 2)
    assert work.front.shape == (2,)
    reference = weakref.ref(work)
    del work
    gc.collect()
    assert reference() is None
