"""The folder of an ensemble: study.json and a Parquet file for each chunk of samples."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import platform
from collections.abc import Mapping
from dataclasses import replace
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..checks import file_path
from ..errors import InputError
from ..scene.events import as_events
from ..tables import write_table
from .sampling import Sampling

Columns = dict[str, NDArray[Any]]

STUDY = "study.json"


def digest(sampling: Sampling, settings: Mapping[str, Any]) -> str:
    """Return a digest of what the rows of a study depend on: scene, start, distributions, seed, settings.

    Functions count by name and code, so that they need not be pickled.
    """
    scene = sampling.scene
    functions = [scene.control, *(event.guard for event in as_events(scene.events)), settings.get("reduce")]
    functions += [event.callback for event in as_events(scene.events)]
    coefficients = [contact.restitution for contact in scene.contacts]
    functions += [e for e in coefficients if callable(e)]
    plain = replace(
        scene,
        control=None,
        period=None,
        delay=0.0,
        events=(),
        contacts=[
            replace(contact, restitution=0.0) if callable(contact.restitution) else contact
            for contact in scene.contacts
        ],
    )
    parts = [
        scene.model.saveToString(),
        [repr(vars(contact)) for contact in (*plain.contacts, *plain.held)],
        [str(getattr(plain, name)) for name in ("locked", "limit_restitution", "resting_speed", "without")],
        [scene.simultaneous, scene.period, scene.delay],
        sampling.q0.tolist(),
        sampling.v0.tolist(),
        [sampling.names, sampling.samples, sampling.seed, sampling.design],
        [_drawn(sampling)],
        {name: value for name, value in settings.items() if name != "reduce"},
        [_code(function) for function in functions if function is not None],
    ]
    return hashlib.sha256(repr(parts).encode()).hexdigest()


def _drawn(sampling: Sampling) -> list[list[float]]:
    """Return the first samples, which stand for the distributions."""
    drawn: list[list[float]] = sampling.draw(0, min(sampling.samples, 16)).tolist()
    return drawn


def _code(function: Any) -> str:
    code = getattr(function, "__code__", None)
    if code is not None:
        return f"{function.__module__}.{function.__qualname__}:{code.co_code.hex()}:{code.co_consts!r}"
    try:
        return hashlib.sha256(pickle.dumps(function)).hexdigest()
    except (pickle.PicklingError, TypeError, AttributeError):
        return type(function).__qualname__


class StudyFolder:
    """The files of an ensemble; chunks are written aside and renamed, so that each is whole or missing.

    Args:
        path: The folder, created if necessary.
        sampling: What is sampled.
        settings: What else the rows depend on.
        chunk: Number of samples of a file; that of the folder is kept if it has a study already.
        resume: Whether to continue a study that is there.

    Raises:
        InputError: A folder with another study, or one that is there without `resume`; no pyarrow.
    """

    def __init__(
        self, path: Any, sampling: Sampling, settings: Mapping[str, Any], chunk: int, resume: bool
    ) -> None:
        if find_spec("pyarrow") is None:
            raise InputError(
                "out: pyarrow is not installed; pip install 'pinimpact[data]' installs it", field="out"
            )
        self.path = file_path("out", path)
        self.path.mkdir(parents=True, exist_ok=True)
        self.samples, self.chunk = sampling.samples, chunk
        self.about = {
            "digest": digest(sampling, settings),
            "samples": sampling.samples,
            "seed": sampling.seed,
            "design": sampling.design,
            "parameters": list(sampling.names),
            "chunk": chunk,
            "versions": {
                "python": platform.python_version(),
                "pinimpact": __version__,
                **{name: metadata.version(name) for name in ("pin", "numpy", "scipy", "numba")},
            },
        }
        self._begin(resume)

    def _begin(self, resume: bool) -> None:
        file = self.path / STUDY
        if not file.exists():
            if any(self.path.glob("samples-*.parquet")):
                raise InputError(
                    f"out: {self.path} has samples but no {STUDY}; give another folder",
                    field="out",
                    value=str(self.path),
                )
            aside = file.with_suffix(".part")
            aside.write_text(json.dumps(self.about, indent=1), encoding="utf-8")
            os.replace(aside, file)
            return
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
            same, self.chunk = known["digest"] == self.about["digest"], int(known["chunk"])
        except (ValueError, KeyError, TypeError):
            raise InputError(
                f"out: {file} is not the record of a study", field="out", value=str(file)
            ) from None
        if not same:
            differs = [
                f"{name} {known.get(name)!r} there, {self.about[name]!r} here"
                for name in ("samples", "seed", "design", "parameters")
                if known.get(name) != self.about[name]
            ]
            raise InputError(
                f"out: {self.path} has another study "
                f"({'; '.join(differs) or 'of another scene or settings'}); give another folder",
                field="out",
                value=str(self.path),
            )
        if not resume:
            raise InputError(
                f"out: {self.path} has this study already; continue it by resume=True, or give another "
                "folder",
                field="out",
                value=str(self.path),
            )

    def file(self, first: int) -> Path:
        """Return the file of a chunk."""
        return self.path / f"samples-{first:09d}.parquet"

    def read(self, first: int, count: int) -> Columns | None:
        """Return the columns of a chunk, or None if it is not there."""
        file = self.file(first)
        if not file.exists():
            return None
        from pyarrow import ArrowInvalid, parquet

        try:
            table = parquet.read_table(file)
        except (ArrowInvalid, OSError):
            table = None
        if table is None or table.num_rows != count:
            raise InputError(
                f"out: {file} is not a chunk of {count} samples; remove it", field="out", value=str(file)
            )
        return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}

    def write(self, first: int, columns: Columns) -> None:
        """Write the columns of a chunk."""
        aside = self.path / f".{self.file(first).name}"
        about = {name: self.about[name] for name in ("digest", "seed", "design")}
        write_table(aside, columns, {"pinimpact": json.dumps({**about, "units": "SI"})})
        os.replace(aside, self.file(first))


def joined(chunks: list[Columns]) -> Columns:
    """Return the rows of all chunks; a column that one lacks is NaN or empty there."""
    names = dict.fromkeys(name for chunk in chunks for name in chunk)
    found = {}
    for name in names:
        parts = []
        kind = next(chunk[name].dtype for chunk in chunks if name in chunk)
        for chunk in chunks:
            count = len(next(iter(chunk.values())))
            empty = np.full(count, np.nan) if kind.kind in "fiu" else np.full(count, "", dtype=object)
            parts.append(chunk.get(name, empty))
        found[name] = np.concatenate(parts)
    return found
