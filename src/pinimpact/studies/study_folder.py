"""The folder of an ensemble: study.json and a Parquet file for each chunk of samples."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, MethodType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from .. import __version__
from ..checks import file_path
from ..errors import InputError
from ..tables import write_table
from .sampling import Sampling

Columns = dict[str, NDArray[Any]]

STUDY = "study.json"


def digest(sampling: Sampling, settings: Mapping[str, Any]) -> str:
    """Return a digest of all that determines a study's rows: scene, start, distributions, seed, settings."""
    drawn = sampling.draw(0, min(sampling.samples, 16))  # the first samples represent the distributions
    about = [sampling.names, sampling.samples, sampling.seed, sampling.design]
    about += [sampling.q0, sampling.v0, drawn]
    parts = _content([about, sampling.scene, settings], {})
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def _content(value: Any, seen: dict[int, Any]) -> Iterator[str]:
    """Yield the content of a value as texts that are equal in all processes.

    Functions are represented by their code, defaults and closures, and need not be picklable.
    """
    kind = type(value)
    yield kind.__qualname__
    if value is None or isinstance(value, (bool, int, float, complex, str, bytes, type)):
        yield repr(value)
    elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
        yield f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    elif isinstance(value, pin.Model):
        yield value.saveToString()
    elif isinstance(value, (pin.Data, pin.GeometryData)):
        pass  # computed from the model
    elif id(value) in seen:
        pass  # it refers to itself, or was met before
    else:
        seen[id(value)] = value  # kept, or another object could have its id later
        for part in _parts(value):
            yield from _content(part, seen)


def _parts(value: Any) -> Iterable[Any]:
    """Return the parts of a value."""
    if isinstance(value, Mapping):
        return sorted(value.items(), key=lambda item: repr(item[0]))
    if isinstance(value, (set, frozenset)):
        return sorted(value, key=repr)
    if isinstance(value, Sequence):
        return value
    if isinstance(value, MethodType):
        return value.__func__, value.__self__
    if isinstance(value, CodeType):
        return value.co_code, value.co_names, value.co_consts
    code = getattr(getattr(value, "py_func", value), "__code__", None)
    if code is not None:
        value = getattr(value, "py_func", value)
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return value.__module__, value.__qualname__, code, value.__defaults__, value.__kwdefaults__, cells
    if isinstance(value, partial):
        return value.func, value.args, value.keywords
    if isinstance(value, pin.GeometryModel):
        return [(g.name, g.parentJoint, g.placement.homogeneous, g.geometry) for g in value.geometryObjects]
    if hasattr(value, "vertices"):
        return (np.array(value.vertices()),)
    if type(value).__module__.startswith(("pinocchio", "coal")) or not hasattr(value, "__dict__"):
        return (pickle.dumps(value),)
    # without what a class does not keep, such as what it computes on demand
    return (value.__getstate__() if "__getstate__" in dir(type(value)) else vars(value),)


class StudyFolder:
    """The files of an ensemble. Chunks are written to temporary files, then renamed: none is incomplete.

    The folder is created if necessary; `settings` determine the rows in addition to the sampling.

    Raises:
        InputError: A folder with another study, or with this one unless `resume`; pyarrow is not installed.
    """

    def __init__(self, path: Any, sampling: Sampling, settings: Mapping[str, Any], resume: bool) -> None:
        if find_spec("pyarrow") is None:
            raise InputError("out: pyarrow is not installed; pip install 'pinimpact[data]' installs it")
        self.path = file_path("out", path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise InputError(f"out: {self.path} cannot be a folder: {reason}") from error
        self.samples = sampling.samples
        self.about: dict[str, Any] = {
            "digest": digest(sampling, settings),
            "samples": sampling.samples,
            "seed": sampling.seed,
            "design": sampling.design,
            "parameters": list(sampling.names),
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
                raise self._in_use(f"{self.path} has samples but no {STUDY};")
            aside = file.with_suffix(".part")
            aside.write_text(json.dumps(self.about, indent=1), encoding="utf-8")
            os.replace(aside, file)
            return
        try:
            known = json.loads(file.read_text(encoding="utf-8"))
            same, versions = known["digest"] == self.about["digest"], dict(known["versions"])
        except (ValueError, KeyError, TypeError):
            raise InputError(f"out: {file} is not the record of a study", value=str(file)) from None
        if not same:
            differs = [
                f"{name} {known.get(name)!r} there, {self.about[name]!r} here"
                for name in ("samples", "seed", "design", "parameters")
                if known.get(name) != self.about[name]
            ]
            how = "; ".join(differs) or "of another scene or settings"
            raise self._in_use(f"{self.path} has another study ({how});")
        other = {name: v for name, v in self.about["versions"].items() if versions.get(name) != v}
        for name, version in other.items():
            begun = f"the study in {self.path} used {name} {versions.get(name)}, but {version} is installed"
            raise self._in_use(f"{begun}; continue it with the same versions, or")
        if not resume:
            raise self._in_use(
                f"{self.path} has this study already; continue it by resume=True (--resume), or"
            )

    def _in_use(self, why: str) -> InputError:
        """Return the error for a folder that cannot be used."""
        return InputError(f"out: {why} give another folder", value=str(self.path))

    def file(self, first: int) -> Path:
        """Return the file of a chunk."""
        return self.path / f"samples-{first:09d}.parquet"

    def read(self) -> dict[int, Columns]:
        """Return the columns of the existing chunks, by their first sample."""
        found: dict[int, Columns] = {}
        end = 0
        for file in sorted(self.path.glob("samples-*.parquet")):
            columns = self._read(file)
            new = columns["sample"] >= end  # two runs at once may have divided the samples differently
            if new.any():
                found[int(columns["sample"][new][0])] = {name: x[new] for name, x in columns.items()}
                end = int(columns["sample"][-1]) + 1
        return found

    def _read(self, file: Path) -> Columns:
        from pyarrow import ArrowInvalid, parquet

        try:
            table = parquet.read_table(file)
            of = json.loads(table.schema.metadata[b"pinimpact"])["digest"]
            columns = {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}
            first = int(columns["sample"][0])
            whole = np.array_equal(columns["sample"], np.arange(first, first + table.num_rows))
        except (ArrowInvalid, OSError, ValueError, KeyError, IndexError, TypeError):
            of, whole = None, False
        if of != self.about["digest"] or not whole or file != self.file(first):
            what = "a chunk of another study" if of is not None and whole else "damaged"
            raise InputError(f"out: {file} is {what}; remove it", value=str(file))
        return columns

    def write(self, first: int, columns: Columns) -> None:
        """Write the columns of a chunk."""
        aside = self.path / f".{self.file(first).name}"
        about = {name: self.about[name] for name in ("digest", "seed", "design")}
        write_table(aside, columns, {"pinimpact": json.dumps({**about, "units": "SI"})})
        os.replace(aside, self.file(first))


def of_one_kind(chunks: Iterable[tuple[int, Columns]]) -> Iterator[tuple[int, Columns]]:
    """Yield chunks; raise `InputError` for a column of text and numbers, in one chunk or in several."""
    kinds: dict[str, set[bool]] = {}
    for first, columns in chunks:
        for name, column in columns.items():
            numbers = column.dtype.kind in "fiu"
            kinds.setdefault(name, set()).update([False] if numbers else (isinstance(x, str) for x in column))
            if len(kinds[name]) > 1:
                raise InputError(
                    f"reduce: column {name!r} mixes text and numbers; text in all rows, or numbers in all "
                    "rows, expected",
                    value=name,
                )
        yield first, columns


def joined(chunks: list[Columns]) -> Columns:
    """Return the rows of all chunks; a column that one lacks is NaN or empty there."""
    found = {}
    for name in dict.fromkeys(name for chunk in chunks for name in chunk):
        kind = next(chunk[name].dtype.kind for chunk in chunks if name in chunk)
        missing = np.array([np.nan] if kind in "fiu" else [""], dtype=None if kind in "fiu" else object)
        parts = [chunk.get(name, np.repeat(missing, len(chunk["sample"]))) for chunk in chunks]
        found[name] = np.concatenate(parts)
    return found
