"""Ensembles: many runs of a scene, or many impacts, with parameters drawn from distributions."""

from __future__ import annotations

import math
import os
import pickle
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from copy import deepcopy
from dataclasses import dataclass, replace
from inspect import signature
from itertools import chain
from multiprocessing import get_context, parent_process
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import Array
from ..checks import choice, counted, function, in_short, whole_number
from ..errors import InputError, PinimpactError, SimulationError
from ..robot.batch import Hits, impacts
from ..scene.options import Options, check_numbers
from ..scene.scene import Scene
from ..scene.simulation import INTERRUPTED, SCHEMES, simulate
from ..scene.trajectory import Trajectory
from .ensemble_result import Ensemble
from .sampling import Sampling
from .study_folder import Columns, StudyFolder, joined, of_one_kind

CHUNK_SECONDS = 2.0
"""Target processor time of a chunk: long relative to the overhead of a task, short if it is lost."""

LARGEST_CHUNK = 100_000

GROWTH = 8
"""Largest ratio of the size of a chunk to that of the last one that was timed."""

IN_FLIGHT = 4
"""Number of chunks per processor that are submitted at first; it bounds the memory of their results."""

REMAKES = 2
"""Number of times that a broken pool of processes is replaced without a finished chunk in between."""

Reduce = Callable[[Trajectory], Mapping[str, Any]]


@dataclass(frozen=True)
class _Task:
    """Runs samples of a study in a worker."""

    sampling: Sampling
    duration: float | None
    options: dict[str, Any]
    reduce: Reduce
    keep: Path | None

    def __call__(self, first: int, count: int) -> tuple[Columns, float]:
        """Return the columns of samples, in order, and the processor time [s]."""
        began = time.thread_time()
        drawn = self.sampling.draw(first, count)
        if self.duration is None:
            found = self._impacts(drawn)
        else:
            found = _columns([self._row(first + i, numbers) for i, numbers in enumerate(drawn)])
        columns = {"sample": np.arange(first, first + count)}
        # they precede results, which may have some of their names
        columns |= dict(zip(self.sampling.names, drawn.T.copy(), strict=True))
        return columns | found | columns, time.thread_time() - began

    def trajectory(self, numbers: Array) -> Trajectory:
        """Return the run of a sample; errors as in `simulate`."""
        scene, q, v = self.sampling.apply(numbers)
        if scene.period is not None:  # such a control may have a state
            scene = replace(scene, control=deepcopy(scene.control))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # else thousands of samples repeat them
            return simulate(scene, q, v, self.duration or 0.0, **self.options)

    def _row(self, index: int, numbers: Array) -> dict[str, Any]:
        """Return the row of a sample; an error is reported in its status and message."""
        try:
            trajectory = self.trajectory(numbers)
            if trajectory.termination == INTERRUPTED:
                raise KeyboardInterrupt
            if self.keep is not None:
                trajectory.save(self.keep / f"trajectory-{index:09d}.npz")
            row = _checked_row(self.reduce(trajectory), ("sample", "status", "message", *self.sampling.names))
        except Exception as error:
            return {"status": type(error).__name__, "message": str(error)}
        return {"status": "OK", "message": "", **row}

    def _impacts(self, drawn: Array) -> Columns:
        """Return the columns of single impacts, which are solved in one call."""
        scene = self.sampling.scene
        q, v = self.sampling.states(drawn)
        contact = scene.contacts[0]
        mu, e = (self.sampling.coefficient(drawn, name) for name in ("friction", "restitution"))
        model = scene.model
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            hits = impacts(model, model.createData(), q, v, contact, mu, e, scene.held, scene.locked)
            columns = hits.columns()
            unsolved = np.flatnonzero(~np.isfinite(hits.v).all(axis=1)).tolist()
            messages = {row: _message(hits, row) for row in unsolved}
        message = np.array([messages.get(row, "") for row in range(len(v))], dtype=object)
        return {"status": columns.pop("status"), "message": message, **columns}


def _message(hits: Hits, row: int) -> str:
    """Return the message of the error of an impact without a solution."""
    try:
        hits[row]
    except PinimpactError as error:
        return str(error)
    return ""


def _checked_row(row: Any, taken: tuple[str, ...]) -> dict[str, Any]:
    """Return a row of numbers and texts by names that are not taken, or raise `InputError`."""
    if not isinstance(row, Mapping):
        raise InputError(f"reduce: {in_short(row)} returned, a row by name expected")
    for name, value in row.items():
        if not isinstance(name, str) or name in taken:
            raise InputError(
                f"reduce: a column {name!r} returned; other names than {', '.join(taken)} expected",
                value=name,
            )
        if not isinstance(value, str) and (np.ndim(value) > 0 or not np.isrealobj(value) or value is None):
            raise InputError(
                f"reduce: {name!r} is {in_short(value)}; a number or a text expected", value=value
            )
    return dict(row)


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
        samples: Number of samples; "saltelli" rounds it up to 2, 4, 8, … times d + 2, for d parameters.
        seed: Seed of all draws.
        design: "random"; "sobol" or "halton", low-discrepancy sequences of `scipy.stats.qmc`; "saltelli", for
            `Ensemble.sobol_indices`. All but the first need distributions with ``ppf``, of independent
            numbers.
        executor: None: this process; a number of worker processes, replaced where they die; or any
            `concurrent.futures.Executor`, such as that of a Dask client. A script that starts processes has
            its calls below ``if __name__ == "__main__":``.
        out: Folder for study.json and Parquet files, written chunk by chunk.
        resume: Whether to continue the study in `out`, after a check that it is the same.
        reduce: Function of a `Trajectory` that returns a row, numbers and text by name; of runs only.
        keep: Whether workers save trajectories in `out`, a folder that they can all reach; of runs only.
        progress: Called with the number of finished samples and of all.
        **options: Further arguments of `simulate`: rtol, scheme, dt and others; of runs only.

    Returns:
        An `Ensemble`, with columns for the parameters and the rows of `reduce`.

    Raises:
        InputError: Invalid numbers or distributions; a scene that cannot be pickled; another study in `out`;
            a `reduce` that returns text by a name in some rows and numbers in others.
        UnknownNameError: A parameter that does not exist.
        SimulationError: Worker processes died again and again, or the executor failed; the message names the
            samples in question.
    """
    sampling = Sampling(scene, q0, v0, over, samples, seed, design)
    _check(sampling, duration, executor, reduce, keep, out, options)
    task = _Task(
        sampling, duration, options, reduce, Path(out).absolute() if keep and out is not None else None
    )
    if executor is not None:
        _check_pickles(task)
    folder, known, found, done = None, {}, {}, 0
    if out is not None:
        settings = {"duration": duration, "options": options, "reduce": reduce}
        folder = StudyFolder(out, sampling, settings, resume)
        known = folder.read()
    pieces = _Pieces({first: len(columns["sample"]) for first, columns in known.items()}, sampling.samples)
    for first, columns in of_one_kind(chain(known.items(), _finished(task, pieces, executor))):
        if folder is not None and first not in known:
            folder.write(first, columns)
        found[first] = columns
        done += len(columns["sample"])
        if progress is not None:
            progress(done, sampling.samples)
    rows = joined([columns for _, columns in sorted(found.items(), key=lambda item: item[0])])
    return Ensemble(rows, sampling.names, sampling.design, None if duration is None else task.trajectory)


def _check(
    sampling: Sampling,
    duration: Any,
    executor: Any,
    reduce: Any,
    keep: Any,
    out: Any,
    options: Mapping[str, Any],
) -> None:
    """Check the arguments of `ensemble`."""
    if duration is None:
        _check_impact(sampling, reduce, keep, options)
    else:
        given = signature(simulate).bind(sampling.scene, None, None, duration, **options)
        given.apply_defaults()
        numbers = {name: given.arguments[name] for name in Options._fields}
        check_numbers(duration=duration)
        choice("scheme", given.arguments["scheme"], SCHEMES, "a scheme")
        Options(**numbers).checked()
    if keep and out is None:
        raise InputError("keep: True given without out=, a folder for trajectories", value=keep)
    function("reduce", reduce, "a function of a trajectory")
    if isinstance(executor, int):
        whole_number("executor", executor, 1)
    elif executor is not None and not isinstance(executor, Executor):
        raise InputError(
            f"executor: {in_short(executor)} given; None, a number of processes or a concurrent.futures."
            "Executor expected",
            value=executor,
        )


def _check_impact(sampling: Sampling, reduce: Any, keep: Any, options: Mapping[str, Any]) -> None:
    """Check that arguments apply to single impacts."""
    scene = sampling.scene
    if len(scene.contacts) != 1:
        raise InputError(
            f"duration: None given for a scene with {counted(len(scene.contacts), 'contact')}; one expected"
        )
    unused = [name for name, on in (("reduce", reduce is not final_state), ("keep", keep)) if on]
    unused += [*options, *(["scene.without"] if scene.without else [])]
    if unused:
        raise InputError(f"{unused[0]}: given with duration=None; an impact does not use it")
    for name in sampling.names:
        if name.partition(":")[0] in ("sliding_friction", "stiffness"):
            raise InputError(
                f"over: {name!r} given with duration=None; it does not change a single impact", value=name
            )


class _Pieces:
    """Divides missing samples into chunks of about `CHUNK_SECONDS`, from the time of the last chunk.

    `known` maps the first sample of each finished chunk to its number of samples.
    """

    def __init__(self, known: Mapping[int, int], samples: int) -> None:
        ends = [0, *(first + known[first] for first in sorted(known))]
        self.gaps = [(a, b - a) for a, b in zip(ends, [*sorted(known), samples], strict=True) if b > a]
        self.gaps.reverse()
        self.size = 1
        self.lost: list[tuple[int, int]] = []

    def take(self, parts: int = 1) -> tuple[int, int] | None:
        """Return the first sample and the number of samples of the next chunk, or None.

        It has at most the fraction 1/`parts` of the remaining samples, so that many workers finish together.
        """
        if not self.gaps:
            return None
        left = sum(count for _, count in self.gaps)
        first, count = self.gaps.pop()
        size = min(count, self.size, -(-left // parts))
        if size < count:
            self.gaps.append((first + size, count - size))
        return first, size

    def give_back(self, chunks: list[tuple[int, int]]) -> None:
        """Return unfinished chunks, which are divided again, into small chunks at first."""
        self.gaps = sorted([*self.gaps, *chunks], reverse=True)
        self.size, self.lost = 1, chunks

    def timed(self, count: int, seconds: float) -> None:
        """Set the size of the next chunks from the processor time of one [s]."""
        wanted = LARGEST_CHUNK if seconds <= 0.0 else int(count * min(CHUNK_SECONDS / seconds, GROWTH))
        self.size = min(max(wanted, 1), LARGEST_CHUNK)


def _finished(task: _Task, pieces: _Pieces, executor: Executor | int | None) -> Iterator[tuple[int, Columns]]:
    """Yield the first sample and the columns of each chunk as it finishes."""
    if executor is None:
        while (piece := pieces.take()) is not None:
            columns, seconds = task(*piece)
            pieces.timed(piece[1], seconds)
            yield piece[0], columns
    elif isinstance(executor, Executor):
        try:
            yield from _by_executor(task, pieces, executor, os.cpu_count() or 1)
        except PinimpactError:
            raise
        except Exception as error:
            raise _failed(f"failed ({type(error).__name__}: {error})", pieces, executor) from error
    else:
        yield from _by_processes(task, pieces, executor)


def _failed(what: str, pieces: _Pieces, executor: Executor | int) -> SimulationError:
    """Return an error that names the samples in flight."""
    first, last = min(a for a, _ in pieces.lost), max(a + count for a, count in pieces.lost) - 1
    return SimulationError(
        f"executor: {what} in samples {first} to {last}; with out=, finished samples are saved, and "
        "resume=True continues",
        value=executor,
    )


def _check_pickles(task: _Task) -> None:
    try:
        pickle.dumps(task)
    except Exception as error:
        raise InputError(
            f"scene: cannot be sent to other processes ({error}); use functions that are defined in a "
            "module, or executor=None",
            value=task.sampling.scene,
        ) from error


def _by_executor(
    task: _Task, pieces: _Pieces, executor: Executor, workers: int
) -> Iterator[tuple[int, Columns]]:
    """Yield the first sample and the columns of each chunk as it finishes, with a bounded number in flight.

    A chunk that has not waited indicates more workers than expected; the bound is then increased.
    """
    flying: dict[Future[tuple[Columns, float]], tuple[tuple[int, int], float]] = {}
    most = IN_FLIGHT * workers
    try:
        while True:
            while len(flying) < most and (piece := pieces.take(2 * most // IN_FLIGHT)) is not None:
                flying[executor.submit(task, *piece)] = piece, time.monotonic()
            if not flying:
                return
            done = wait(flying, return_when=FIRST_COMPLETED).done
            for future in sorted(done, key=lambda one: one.cancelled() or one.exception() is not None):
                columns, seconds = future.result()
                (first, count), submitted = flying.pop(future)
                pieces.timed(count, seconds)
                most += time.monotonic() - submitted < 2.0 * seconds
                yield first, columns
    finally:
        for future in flying:
            future.cancel()
        pieces.give_back([piece for piece, _ in flying.values()])


def _by_processes(task: _Task, pieces: _Pieces, workers: int) -> Iterator[tuple[int, Columns]]:
    """Yield chunks computed by processes; if one dies, the pool is replaced.

    After `REMAKES` replacements without a finished chunk, an error reports the samples.
    """
    died = 0
    while True:
        with ProcessPoolExecutor(workers, get_context("spawn"), _begin_worker) as pool:
            try:
                for first, columns in _by_executor(task, pieces, pool, workers):
                    died = 0
                    yield first, columns
                return
            except BrokenProcessPool as error:
                died += 1
                if died > REMAKES:
                    what = f"worker processes died {died} times (lack of memory, or of a function),"
                    raise _failed(what, pieces, workers) from error


def _begin_worker() -> None:
    """Make a worker process exit when its parent does, even if that is killed, and ignore Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()

    def follow() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=follow, daemon=True).start()


def _columns(rows: list[dict[str, Any]]) -> Columns:
    """Return rows as arrays by name; missing numbers are NaN, missing texts empty."""
    names = dict.fromkeys(name for row in rows for name in row)
    text = {name: any(isinstance(row.get(name), str) for row in rows) for name in names}
    columns = {name: [row.get(name, "" if text[name] else math.nan) for row in rows] for name in names}
    return {name: np.array(x, dtype=object if text[name] else float) for name, x in columns.items()}
