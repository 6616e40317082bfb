"""Ensembles: many runs of a scene, or many impacts, with parameters drawn from distributions."""

from __future__ import annotations

import math
import pickle
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from os import cpu_count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..checks import function, in_short, whole_number
from ..errors import InputError, SimulationError
from ..robot.batch import impacts
from ..scene.scene import Scene
from ..scene.simulation import simulate
from ..scene.trajectory import Trajectory
from .ensemble_result import Ensemble
from .sampling import Sampling
from .study_folder import Columns, StudyFolder, joined

CHUNK_SECONDS = 2.0
"""Aim for the time of a chunk: long against what a task costs, short against what a kill loses."""

LARGEST_CHUNK = 100_000

IN_FLIGHT = 4
"""Chunks per processor that are submitted at a time, which bounds the memory of their results."""

REMAKES = 2
"""How often a pool of processes that broke is replaced."""

Reduce = Callable[[Trajectory], Mapping[str, Any]]


@dataclass(frozen=True)
class _Task:
    """What a worker needs to run any samples of a study."""

    sampling: Sampling
    duration: float | None
    options: dict[str, Any]
    reduce: Reduce
    keep: Path | None

    def __call__(self, first: int, count: int) -> Columns:
        """Return the rows of samples, in order."""
        drawn = self.sampling.draw(first, count)
        if self.duration is None:
            found = self._impacts(drawn)
        else:
            found = _columns([self._run(first + i, numbers) for i, numbers in enumerate(drawn)])
        index = {"sample": np.arange(first, first + count)}
        return index | dict(zip(self.sampling.names, drawn.T.copy(), strict=True)) | found

    def _run(self, index: int, numbers: NDArray[np.float64]) -> dict[str, Any]:
        """Return the row of a sample; one that raises an error has its name and message."""
        try:
            scene, q, v = self.sampling.apply(numbers)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # one of each sample would be thousands
                trajectory = simulate(scene, q, v, self.duration or 0.0, **self.options)
            if not trajectory.complete:
                raise KeyboardInterrupt
            if self.keep is not None:
                trajectory.save(self.keep / f"trajectory-{index:09d}.npz")
            row = dict(self.reduce(trajectory))
        except Exception as error:
            return {"status": type(error).__name__, "message": str(error)}
        return {"status": "OK", "message": "", **row}

    def _impacts(self, drawn: NDArray[np.float64]) -> Columns:
        """Return the rows of single impacts, which are solved in one call."""
        scene = self.sampling.scene
        q, v = self.sampling.states(drawn)
        contact = scene.contacts[0]
        mu, e = (self.sampling.coefficient(drawn, name) for name in ("friction", "restitution"))
        model = scene.model
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            hits = impacts(model, model.createData(), q, v, contact, mu, e, scene.held, scene.locked)
        columns = hits.columns()
        return {"status": columns.pop("status"), "message": np.full(len(v), "", dtype=object), **columns}


def final_state(trajectory: Trajectory) -> dict[str, Any]:
    """Return the default row of a run.

    It has q and v at the end, by coordinate; the number of impacts, the impulse of the largest [N s] and the
    work of all causes [J]; the mode of each contact at the end; the time in time steps [s].
    """
    energy, end = trajectory.energy, float(trajectory.t[-1])
    largest = max((float(np.linalg.norm(i.impulse_world)) for i in trajectory.impacts), default=0.0)
    row: dict[str, Any] = {}
    for letter, names, values in zip("qv", trajectory.coordinates, (trajectory.q, trajectory.v), strict=True):
        row |= {f"{letter}.{name}": float(x) for name, x in zip(names, values[-1], strict=True)}
    row |= {"impacts": len(trajectory.impacts), "largest_impulse": largest}
    row |= {f"work.{cause}": float(work[-1]) for cause, work in energy.by_cause().items()}
    row |= {f"{c.label}.mode": trajectory.mode_at(c.label, end) for c in trajectory.contacts}
    row["stepped"] = sum(s.end - s.start for s in trajectory.stepped)
    return row


def ensemble(
    scene: Scene,
    q0: ArrayLike,
    v0: ArrayLike,
    duration: float | None,
    *,
    over: Mapping[str | tuple[str, ...], Any],
    samples: int,
    seed: int = 0,
    design: str = "random",
    executor: Executor | int | None = None,
    out: str | Path | None = None,
    resume: bool = False,
    reduce: Reduce = final_state,
    keep: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> Ensemble:
    """Simulate a scene many times, with parameters drawn from distributions. (studies.md)

    Sample i is drawn from the seed and i alone: results depend neither on chunks nor on workers. A sample
    that raises an error is a row with the error's name as its status, and its message.

    Args:
        scene: The scene. Functions in it must be picklable if there are worker processes.
        q0: (nq,) configuration.
        v0: (nv,) velocity.
        duration: Time to simulate [s]; None: one impact at the scene's only contact instead.
        over: Distributions of `scipy.stats`, frozen, by what they are of. "friction", "restitution",
            "sliding_friction" and "stiffness" of all contacts, or of one, "friction:foot". "q0" and "v0":
            what is added to the start, in the tangent space, (nv,) numbers of a multivariate distribution;
            "q0:NAME", "v0:NAME" one of them, by its name in ``trajectory.coordinates[1]``. A tuple of keys
            for several numbers of one distribution.
        samples: Number of samples.
        seed: Seed of all draws.
        design: "random"; "sobol" or "halton", low-discrepancy sequences of `scipy.stats.qmc`; "saltelli", for
            `Ensemble.sobol_indices`. All but the first need distributions of one number, with ``ppf``.
        executor: None: this process; a number of worker processes, replaced where they die; or any
            `concurrent.futures.Executor`, such as that of a Dask client.
        out: Folder for study.json and Parquet files, written chunk by chunk.
        resume: Whether to continue the study in `out`, after a check that it is the same.
        reduce: Function of a `Trajectory` that returns a row, numbers and text by name.
        keep: Whether workers save trajectories in `out`.
        progress: Called with the number of finished samples and of all.
        **options: Further arguments of `simulate`: rtol, scheme, dt and others.

    Returns:
        An `Ensemble`, with columns for the parameters and the rows of `reduce`.

    Raises:
        InputError: Invalid numbers or distributions; a scene that cannot be pickled; another study in `out`.
        UnknownNameError: A parameter that does not exist.
        SimulationError: Worker processes died again and again; the message names the samples in question.
    """
    sampling = Sampling(scene, q0, v0, over, samples, seed, design)
    _check(scene, duration, executor, reduce, keep, out)
    task = _Task(sampling, duration, options, reduce, Path(out) if keep and out is not None else None)
    if executor is not None:
        _check_pickles(task)
    chunk = _chunk(task)
    folder = None
    if out is not None:
        settings = {"duration": duration, "options": sorted(options.items()), "reduce": reduce}
        folder = StudyFolder(out, sampling, settings, chunk, resume)
        chunk = folder.chunk
    pieces = [(first, min(chunk, sampling.samples - first)) for first in range(0, sampling.samples, chunk)]
    found: dict[int, Columns] = {}
    if folder is not None:
        known = ((first, folder.read(first, count)) for first, count in pieces)
        found = {first: columns for first, columns in known if columns is not None}
    done = sum(len(columns["sample"]) for columns in found.values())
    for first, columns in _finished(task, [piece for piece in pieces if piece[0] not in found], executor):
        if folder is not None:
            folder.write(first, columns)
        found[first] = columns
        done += len(columns["sample"])
        if progress is not None:
            progress(done, sampling.samples)
    return Ensemble(joined([found[first] for first, _ in pieces]), sampling.names, sampling.design)


def _check(scene: Scene, duration: Any, executor: Any, reduce: Any, keep: Any, out: Any) -> None:
    """Refuse arguments of `ensemble`."""
    if duration is None and len(scene.contacts) != 1:
        raise InputError(
            f"duration: None given for a scene with {len(scene.contacts)} contacts; one contact expected",
            field="duration",
        )
    if keep and out is None:
        raise InputError("keep: True given without out=, a folder for trajectories", field="keep", value=keep)
    function("reduce", reduce, "a function of a trajectory")
    if isinstance(executor, int):
        whole_number("executor", executor, 1)
    elif executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor: {in_short(executor)} given; None, a number of processes or a concurrent.futures."
            "Executor expected",
            field="executor",
            value=executor,
        )


def _finished(
    task: _Task, todo: list[tuple[int, int]], executor: Executor | int | None
) -> Iterator[tuple[int, Columns]]:
    """Yield first indices and columns of chunks, as they are finished."""
    if executor is None:
        return ((first, task(first, count)) for first, count in todo)
    if isinstance(executor, Executor):
        return _by_executor(task, todo, executor)
    return _by_processes(task, todo, executor)


def _chunk(task: _Task) -> int:
    """Return the number of samples that take about `CHUNK_SECONDS`; kernels are compiled meanwhile."""
    task(0, 1)
    count = 1
    while True:
        began = time.process_time()
        task(0, count)
        taken = time.process_time() - began
        if taken > 0.01 * CHUNK_SECONDS or count >= LARGEST_CHUNK:
            return min(max(int(count * CHUNK_SECONDS / taken), 1), LARGEST_CHUNK)
        count *= 8


def _check_pickles(task: _Task) -> None:
    try:
        pickle.dumps(task)
    except Exception as error:
        raise InputError(
            f"scene: cannot be sent to other processes ({error}); use functions that are defined in a "
            "module, or executor=None",
            field="scene",
            value=task.sampling.scene,
        ) from error


def _by_executor(
    task: _Task, todo: list[tuple[int, int]], executor: Executor
) -> Iterator[tuple[int, Columns]]:
    """Yield first indices and columns of chunks as they finish; few are in flight at a time."""
    flying: dict[Future[Columns], tuple[int, int]] = {}
    waiting = iter(todo)
    most = IN_FLIGHT * max(cpu_count() or 1, getattr(executor, "_max_workers", 0) or 0)
    try:
        while True:
            while len(flying) < most and (piece := next(waiting, None)) is not None:
                flying[executor.submit(task, *piece)] = piece
            if not flying:
                return
            for future in wait(flying, return_when=FIRST_COMPLETED).done:
                yield flying[future][0], future.result()
                del flying[future]
    finally:
        for future in flying:
            future.cancel()


def _by_processes(task: _Task, todo: list[tuple[int, int]], workers: int) -> Iterator[tuple[int, Columns]]:
    """Yield chunks computed by processes; where one dies the pool is replaced, at most `REMAKES` times."""
    left = dict(todo)
    for remade in range(REMAKES + 1):
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            try:
                for first, columns in _by_executor(task, list(left.items()), pool):
                    del left[first]
                    yield first, columns
                return
            except BrokenProcessPool as error:
                if remade < REMAKES:
                    continue
                first = min(left)
                most = sorted(left)[: IN_FLIGHT * max(workers, cpu_count() or 1)]
                last = max(i + left[i] for i in most) - 1
                raise SimulationError(
                    f"executor: worker processes died {REMAKES + 1} times, the last time in samples {first} "
                    f"to {last}; the system may lack memory. What is finished is kept with out=; continue by "
                    "resume=True",
                    field="executor",
                    value=workers,
                ) from error


def _columns(rows: list[dict[str, Any]]) -> Columns:
    """Return rows as arrays by name; numbers that a row lacks are NaN, texts empty."""
    names = dict.fromkeys(name for row in rows for name in row)
    found: Columns = {}
    for name in names:
        values = [row[name] for row in rows if name in row]
        text = any(isinstance(value, str) for value in values)
        missing: Any = "" if text else math.nan
        column = [row.get(name, missing) for row in rows]
        found[name] = np.array(column, dtype=object if text else float)
    return found
