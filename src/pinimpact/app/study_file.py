"""Study files: an ensemble of a scene file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field
from scipy import stats

from ..checks import near_matches
from ..errors import InputError, UnknownNameError
from ..studies.ensemble_result import Ensemble
from ..studies.ensembles import ensemble
from .scene_file import Table, Time, bundled_scenes, read_toml, validated
from .scene_loader import LoadedScene, load_scene


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


@dataclass(frozen=True)
class LoadedStudy:
    """A study file that is ready to run."""

    file: StudyFile
    loaded: LoadedScene
    over: dict[str | tuple[str, ...], Any]

    def run(
        self, out: Path, workers: int | None, resume: bool, progress: Callable[[int, int], None]
    ) -> Ensemble:
        """Run the ensemble; errors as in `ensemble`."""
        loaded, file = self.loaded, self.file
        return ensemble(
            *(loaded.scene, loaded.q, loaded.v, file.duration or loaded.file.duration),
            over=self.over,
            samples=file.samples,
            seed=file.seed,
            design=file.design,
            executor=workers,
            out=out,
            resume=resume,
            progress=progress,
            **loaded.file.options,
        )


def load_study(path: Path) -> LoadedStudy:
    """Read a study file and its scene; errors as in `load_scene`."""
    file = validated(StudyFile, read_toml(path, "study", ()), path)
    scene: str | Path = file.scene
    if file.scene not in bundled_scenes():
        scene = path.parent / file.scene
    return LoadedStudy(
        file, load_scene(scene), {name: _distribution(name, table) for name, table in file.over.items()}
    )


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
        raise InputError(f"over.{key}: {name} has other parameters ({error})") from error
