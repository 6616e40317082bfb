"""Study files: an ensemble of a scene file."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from scipy import stats

from ..checks import near_matches
from ..errors import InputError, UnknownNameError
from ..studies.ensemble_result import Ensemble
from ..studies.ensembles import ensemble
from .scene_file import Table, Time, bundled_scenes, read_toml, validated
from .scene_loader import load_scene


class StudyFile(Table):
    """A study file."""

    scene: str
    """Path of a scene file, relative to the folder of this file, or the name of one of pinimpact."""
    samples: Annotated[int, Field(gt=0)]
    """Number of samples."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of all draws."""
    design: str = "random"
    """How samples are drawn; see `ensemble`."""
    duration: Time | None = None
    """Time to simulate. Default: that of the scene file."""
    over: dict[str, dict[str, float | str]]
    """Distributions by parameter: ``distribution``, a name in `scipy.stats`, and its parameters."""


def load_study(path: Path) -> Callable[..., Ensemble]:
    """Return `ensemble` with the arguments in a study file and its scene file; errors as in `load_scene`.

    The caller adds the arguments that do not affect the results, such as `executor` and `out`.
    """
    file = validated(StudyFile, read_toml(path, "study", ()), path)
    bundled = file.scene in bundled_scenes()
    loaded = load_scene(file.scene if bundled else path.parent / file.scene)
    options: dict[str, Any] = file.model_dump(include={"samples", "seed", "design"}) | loaded.file.options
    options["over"] = {name: _distribution(name, table) for name, table in file.over.items()}
    duration = file.duration or loaded.file.duration
    return partial(ensemble, loaded.scene, loaded.q, loaded.v, duration, **options)


def _distribution(key: str, table: dict[str, float | str]) -> Any:
    parameters = dict(table)
    name = parameters.pop("distribution", None)
    known = [n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous)]
    if name not in known:
        raise UnknownNameError(
            f"over.{key}.distribution: {name!r} is not a continuous distribution of scipy.stats; "
            f"{near_matches(name, known)}",
            value=name,
        )
    try:
        return getattr(stats, str(name))(**parameters)
    except TypeError as error:
        raise InputError(f"over.{key}: {table} given, the parameters of {name} expected ({error})") from error
