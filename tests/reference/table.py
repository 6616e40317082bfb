"""Table of reference solutions: inputs as doubles, outputs as sums of three doubles (48 digits)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mpmath import mp, mpf

from .problems import CATEGORIES, Problem
from .reference import LAWS, ReferenceSolution

PATH = Path(__file__).with_name("table.npz")
STATUSES = ("SEPARATED", "ENDED_AT_REST", "NO_IMPACT", "LOCKED")
FLAGS = (
    "JAM",
    "IMPACT_WITHOUT_COLLISION",
    "SECOND_COMPRESSION",
    "STICK",
    "SLIP_RESUMED",
    "LOCKED",
    "ENERGY_CREATED",
    "SINGULAR_DELASSUS",
)


def outputs(solution: ReferenceSolution) -> list[mpf]:
    """Return the ten stored numbers: v⁺, P, impulses of compression and restitution, and their work."""
    return [
        *solution.velocity,
        *solution.impulse,
        solution.compression_impulse,
        solution.restitution_impulse,
        solution.compression_work,
        solution.restitution_work,
    ]


def split(x: mpf) -> tuple[float, float, float]:
    """Return three doubles whose sum is x to 48 digits, unless they underflow."""
    parts = []
    with mp.workdps(120):
        for _ in range(3):
            parts.append(float(x))
            x = x - mpf(parts[-1])
    return tuple(parts)


@dataclass
class Table:
    """Columns of a table of N rows.

    Attributes:
        delassus: (N, 3, 3) W.
        velocity: (N, 3) v⁻.
        friction: (N,) μ.
        restitution: (N,) e.
        law: (N,) index into `LAWS`.
        category: (N,) index into `CATEGORIES`.
        status: (N,) index into `STATUSES`.
        flags: (N,) bits in the order of `FLAGS`.
        answer: (N, 10, 3) the numbers of `outputs`, each the sum of three doubles.
        sensitivity: (N, 2) norms of the changes of v⁺ and P due to a rounding error of all inputs.
    """

    delassus: np.ndarray
    velocity: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    law: np.ndarray
    category: np.ndarray
    status: np.ndarray
    flags: np.ndarray
    answer: np.ndarray
    sensitivity: np.ndarray

    def __len__(self) -> int:
        return len(self.friction)

    def problem(self, row: int) -> Problem:
        """Return the problem of a row."""
        return Problem(
            self.delassus[row],
            self.velocity[row],
            float(self.friction[row]),
            float(self.restitution[row]),
            LAWS[self.law[row]],
            CATEGORIES[self.category[row]],
        )

    def exact(self, row: int) -> list[mpf]:
        """Return the ten outputs of a row in the working precision."""
        return [sum((mpf(float(x)) for x in parts), mpf(0)) for parts in self.answer[row]]

    def rows(self, law: str) -> np.ndarray:
        """Return the indices of the rows of a law."""
        return np.flatnonzero(self.law == LAWS.index(law))


def columns(
    rows: list[tuple[Problem, ReferenceSolution, tuple[float, float]]],
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the columns of a table, by name, from its rows."""
    problems = [p for p, _, _ in rows]
    solutions = [s for _, s, _ in rows]
    yield "delassus", np.array([p.delassus for p in problems])
    yield "velocity", np.array([p.velocity for p in problems])
    yield "friction", np.array([p.friction for p in problems])
    yield "restitution", np.array([p.restitution for p in problems])
    yield "law", np.array([LAWS.index(p.law) for p in problems], dtype=np.int8)
    yield "category", np.array([CATEGORIES.index(p.category) for p in problems], dtype=np.int8)
    yield "status", np.array([STATUSES.index(s.status) for s in solutions], dtype=np.int8)
    yield (
        "flags",
        np.array(
            [sum(1 << k for k, name in enumerate(FLAGS) if name in s.flags) for s in solutions],
            dtype=np.int16,
        ),
    )
    yield "answer", np.array([[split(x) for x in outputs(s)] for s in solutions])
    yield "sensitivity", np.array([x for _, _, x in rows])


def save(path: Path, rows: list[tuple[Problem, ReferenceSolution, tuple[float, float]]]) -> None:
    """Write a table."""
    np.savez_compressed(path, **dict(columns(rows)))


def load(path: Path = PATH) -> Table:
    """Read a table."""
    with np.load(path) as data:
        return Table(**{name: data[name] for name in data.files})
