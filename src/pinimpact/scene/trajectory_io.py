"""Trajectory files: one .npz file of numbers and text, which contains no code."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import fields as dataclass_fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Array
from ..checks import file_path, output_file
from ..contact_space.problem import ImpactProblem
from ..errors import InputError
from ..geometry.plane import Plane
from ..geometry.sphere import Sphere
from ..geometry.surfaces import Surface
from ..robot.contact import Contact
from ..robot.solids import Box, Shape
from ._kernels.workspace import DENSE_TERMS
from .dense_step import WORKS, DenseStep
from .forces import TabulatedForces
from .records import Energy, EventRecord, ImpactGroup, ImpactRecord, ModeInterval, Note, SteppedInterval

FORMAT = 2

SURFACES: dict[str, type[Surface]] = {"plane": Plane, "sphere": Sphere, "box": Box, "shape": Shape}
"""Class of each `kind` of surface."""

GROUP = ("delassus", "velocity", "friction", "restitution", "law", "surface_velocity", "stiffness")
"""Stored fields of an impact problem at several contacts."""

PLAIN = ("termination", "complete", "switched_off", "statistics", "sources", "coordinates")
"""Arguments of `Trajectory` that are stored as JSON."""

FORCE_TABLES = ("force_rows", "force_world", "force_points", "force_normals", "force_joints", "force_unique")


def write_trajectory(path: str | Path, parts: Mapping[str, Any]) -> None:
    """Write the arguments of a `Trajectory`, by name, to one .npz file."""
    impacts, segments, events, forces = (parts[name] for name in ("impacts", "segments", "events", "forces"))
    t, q, v = parts["samples"]
    nq, nv = q.shape[1], v.shape[1]
    meta = {
        "format": FORMAT,
        **{name: parts[name] for name in PLAIN},
        "notes": [[note.time, note.text] for note in parts["notes"]],
        "stepped": [[s.start, s.end, s.dt, s.reason, s.error] for s in parts["stepped"]],
        "modes": [[m.source, m.mode, m.start, m.end] for m in parts["modes"]],
        "forces": forces.contacts,
        "contacts": [_contact_fields(contact) for contact in parts["contacts"]],
        "events": [[event.time, event.name] for event in events],
        **_impacts_in_words(impacts),
    }

    with open(output_file("path", path), "wb") as file:
        np.savez_compressed(
            file,
            meta=np.array(json.dumps(meta)),
            joints=parts["joints"],
            t=t,
            q=q,
            v=v,
            energy=np.array([getattr(parts["energy"], name) for name in Energy.__dataclass_fields__]),
            segment_times=_stack([(s.start, s.end, s.h) for s in segments], 3),
            segment_q=_stack([s.q for s in segments], nq),
            segment_v=_stack([s.v for s in segments], nv),
            segment_w=_stack([s.w for s in segments], WORKS),
            segment_dense=_dense(segments, 2 * nv + WORKS),
            event_q=_stack([event.q for event in events], nq),
            event_v=_stack([(event.v_before, event.v_after) for event in events], 2, nv),
            **dict(zip(FORCE_TABLES, forces.tables, strict=True)),
            **_impacts_in_numbers(impacts, nq, nv),
        )


def _impacts_in_words(impacts: Sequence[ImpactRecord]) -> dict[str, Any]:
    """Return the data of impacts that are stored as JSON: coefficients, points, problems at many contacts."""
    groups = list(dict.fromkeys(impact.group[0] for impact in impacts if impact.group is not None))
    return {
        "points": [None if i.contact is None else _contact_fields(i.contact) for i in impacts],
        "impacts": [
            [
                *(i.time, i.source, i.problem.friction, i.problem.restitution, i.problem.law),
                *(i.resting, i.simultaneous, i.record),
            ]
            for i in impacts
        ],
        "groups": [{name: _plain(getattr(group.problem, name)) for name in GROUP} for group in groups],
        "policies": [[group.policy, dict(group.options)] for group in groups],
        "in_group": [None if i.group is None else [groups.index(i.group[0]), i.group[1]] for i in impacts],
    }


def _impacts_in_numbers(impacts: Sequence[ImpactRecord], nq: int, nv: int) -> dict[str, Any]:
    problems = [impact.problem for impact in impacts]
    vectors = [
        (problem.velocity, problem.surface_velocity, impact.impulse_world)
        for problem, impact in zip(problems, impacts, strict=True)
    ]
    return {
        "impact_q": _stack([i.q for i in impacts], nq),
        "impact_v": _stack([(i.v_before, i.v_after) for i in impacts], 2, nv),
        "impact_delassus": _stack([problem.delassus for problem in problems], 3, 3),
        "impact_vectors": _stack(vectors, 3, 3),
        "impact_scale": _stack([problem.velocity_scale for problem in problems]),  # None becomes NaN
        "impact_factor": _stack([_factor(problem) for problem in problems], 10),
    }


def _stack(rows: Sequence[Any], *shape: int) -> Array:
    return np.array(rows, dtype=float).reshape(len(rows), *shape)


def _dense(segments: Sequence[DenseStep], rates: int) -> Array:
    """Return the dense output (len(segments), 7, rates) of all steps, with zeros for missing terms."""
    dense = np.zeros((len(segments), DENSE_TERMS, rates))
    for step, coefficients in zip(segments, dense, strict=True):
        coefficients[: len(step.coefficients)] = step.coefficients
    return dense


def read_trajectory(path: str | Path) -> dict[str, Any]:
    """Return the arguments of a `Trajectory`, by name, from a file of `write_trajectory`.

    Raises:
        InputError: The file is missing, or is not a trajectory.
    """
    path = file_path("path", path)
    if not path.is_file():
        raise InputError(f"path: there is no file {path}", value=path)
    try:
        if not zipfile.is_zipfile(path):
            raise ValueError("not a zip archive")
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        meta = json.loads(str(arrays["meta"]))
        if meta["format"] != FORMAT:
            raise ValueError(f"format {meta['format']}")
        return _parts(arrays, meta)
    except Exception as error:  # what a damaged archive raises depends on the damaged part
        what = f"it lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputError(
            f"path: {str(path)!r} is not a readable trajectory ({what}); give a file that save() wrote",
            value=path,
        ) from error


def _parts(arrays: Mapping[str, Any], meta: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a `Trajectory` from the arrays and the JSON data of a file."""
    events = [
        EventRecord(time, name, arrays["event_q"][i], *arrays["event_v"][i])
        for i, (time, name) in enumerate(meta["events"])
    ]
    return {
        "segments": _segments(arrays),
        "joints": arrays["joints"],
        "samples": (arrays["t"], arrays["q"], arrays["v"]),
        "impacts": _impacts(arrays, meta),
        "events": events,
        "modes": [ModeInterval(*row) for row in meta["modes"]],
        "energy": Energy(*arrays["energy"]),
        "stepped": [SteppedInterval(*row) for row in meta["stepped"]],
        "notes": [Note(*row) for row in meta["notes"]],
        **{name: meta[name] for name in PLAIN},
        "forces": TabulatedForces(meta["forces"], *(arrays[name] for name in FORCE_TABLES)),
        "contacts": [_contact(fields) for fields in meta["contacts"]],
    }


def _segments(arrays: Mapping[str, Any]) -> list[DenseStep]:
    segments = []
    rows = (arrays[f"segment_{name}"] for name in ("q", "v", "w", "dense"))
    for (start, end, h), q, v, w, dense in zip(arrays["segment_times"].tolist(), *rows, strict=True):
        segment = DenseStep(start, h, q, v, w, dense, arrays["joints"])
        segment.end = end
        segments.append(segment)
    return segments


def _impacts(arrays: Mapping[str, Any], meta: Mapping[str, Any]) -> list[ImpactRecord]:
    points, in_group = meta["points"], meta["in_group"]
    groups = [
        ImpactGroup(ImpactProblem(**{name: _numbers(value) for name, value in problem.items()}), *how)
        for problem, how in zip(meta["groups"], meta["policies"], strict=True)
    ]
    scales, factors = arrays["impact_scale"], arrays["impact_factor"]
    return [
        ImpactRecord(
            time,
            source,
            arrays["impact_q"][i],
            arrays["impact_v"][i, 0],
            arrays["impact_v"][i, 1],
            resting,
            simultaneous,
            record,
            partial(
                _contact_space,
                arrays["impact_delassus"][i],
                arrays["impact_vectors"][i],
                (mu, e, law),
                None if np.isnan(scales[i]) else float(scales[i]),
                factors[i],
            ),
            None if in_group[i] is None else (groups[in_group[i][0]], in_group[i][1]),
            None if points[i] is None else _contact(points[i]),
        )
        for i, (time, source, mu, e, law, resting, simultaneous, record) in enumerate(meta["impacts"])
    ]


def _fields(value: Any) -> dict[str, Any]:
    """Return the arguments of a contact or a surface, with numbers that JSON supports."""
    arguments = {field.name: getattr(value, field.name) for field in dataclass_fields(value) if field.init}
    return {name: int(v) if isinstance(v, np.integer) else v for name, v in arguments.items()}


def _contact_fields(contact: Contact) -> dict[str, Any]:
    """Return the arguments of a contact, without functions, and of its pair if it has one."""
    found = _fields(contact) | {"plane": {"kind": contact.plane.kind} | _fields(contact.plane)}
    if callable(contact.restitution):
        found["restitution"] = 0.0
    if contact.pair is not None:
        found["pair"] = _contact_fields(contact.pair)
    return found


def _contact(fields: dict[str, Any]) -> Contact:
    pair, surface = fields.get("pair"), dict(fields["plane"])
    plane = SURFACES[surface.pop("kind")](**surface)
    return Contact(**fields | {"plane": plane, "pair": None if pair is None else _contact(pair)})


def _plain(value: Any) -> Any:
    """Return an array as nested lists, whose numbers JSON stores to the last digit."""
    return value.tolist() if isinstance(value, np.ndarray) else value


def _numbers(value: Any) -> Any:
    return np.array(value) if isinstance(value, list) else value


def _contact_space(
    delassus: Array, vectors: Array, law: tuple[float, float, str], scale: float | None, factor: Array
) -> tuple[ImpactProblem, Array]:
    velocity, surface, impulse = vectors
    known = None if np.isnan(factor).any() else factor[:9].reshape(3, 3)
    size = None if known is None else float(factor[9])
    return ImpactProblem(delassus, velocity, *law, surface, scale, factor=known, factor_scale=size), impulse


def _factor(problem: ImpactProblem) -> Array:
    """Return the factor (3, 3) of an impact's W, row by row, and its scale (10,); NaN if there is none."""
    if problem.factor is None or problem.factor_scale is None:
        return np.full(10, np.nan)
    return np.append(np.asarray(problem.factor), problem.factor_scale)
