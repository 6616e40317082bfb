"""The output folder of a command, created and checked before the computation."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Literal

from ..errors import InputError
from ..tables import check_table_path

DEFAULT = Path("out")


@contextmanager
def output_folder(out: Path | None, names: Sequence[str], force: bool = False) -> Iterator[Path]:
    """Create the output folder of a command if necessary, and yield it.

    If the command fails, folders that were created and are empty are removed.

    Args:
        out: The folder; None for "out" or, if that contains files of these names, "out-2" and so on.
        names: Names of the files to be written.
        force: Whether existing files may be overwritten.

    Raises:
        InputError: The folder contains such files already, or cannot be written.
    """
    out = _chosen(out, names, force)
    if not force and (taken := _taken(out, names)):
        raise InputError(
            f"out: {out} already contains {_listed(taken)}; use --force to overwrite "
            f"{'it' if len(taken) == 1 else 'them'}, or another folder with -o",
            value=str(out),
        )
    created = [folder for folder in (out, *out.parents) if not folder.exists()]
    try:
        _make(out)
        yield out
    except BaseException:
        for folder in created:
            with suppress(OSError):  # it is not empty, or could not be created
                folder.rmdir()
        raise


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".pinimpact"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"out: cannot write to the folder {out}: {_reason(out, error)}; choose another with -o",
            value=str(out),
        ) from error


def _chosen(out: Path | None, names: Sequence[str], force: bool) -> Path:
    """Return the folder `out`; for None, the first default folder without files of these names."""
    if out is not None or force:
        return DEFAULT if out is None else out
    numbered = itertools.chain([DEFAULT], (Path(f"{DEFAULT}-{k}") for k in itertools.count(2)))
    return next(folder for folder in numbered if not _taken(folder, names))


def table_files(output: Path, force: bool = False) -> dict[Literal["samples", "impacts"], Path]:
    """Return the files of a run's tables; raise `InputError` if they exist already or cannot be written."""
    output = check_table_path("output", output)
    impacts = output.with_stem(f"{output.stem}-impacts")
    taken = [path.name for path in (output, impacts) if path.exists()]
    if taken and not force:
        raise InputError(
            f"output: {_listed(taken)} already {'exists' if len(taken) == 1 else 'exist'}; use "
            "--force to overwrite, or another name",
            value=str(output),
        )
    return {"samples": output, "impacts": impacts}


def _taken(folder: Path, names: Sequence[str]) -> list[str]:
    return [name for name in names if (folder / name).exists()]


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _reason(folder: Path, error: OSError) -> str:
    file = next((path for path in (folder, *folder.parents) if path.is_file()), None)
    if file is not None:
        return f"{file} is a file"
    return (error.strerror or str(error)).lower()
