"""Results as tables: pandas data frames, CSV and Parquet files."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import output_file
from .errors import InputError

Columns = Mapping[str, NDArray[Any]]
"""The columns of a table by name, arrays of equal length."""

AXES = ("t1", "t2", "n")
"""Names of the contact axes."""

SUFFIXES = (".csv", ".parquet")


def by_component(name: str, components: tuple[str, ...], values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return the columns of an array (m, k) by name, ``name.component``."""
    return {f"{name}.{key}": column for key, column in zip(components, values.T, strict=True)}


def data_frame(columns: Columns) -> Any:
    """Return a pandas data frame.

    Raises:
        InputError: pandas is not installed.
    """
    return _optional("pandas", "to_dataframe").DataFrame(dict(columns))


def check_table_path(field: str, path: str | Path) -> Path:
    """Return the path of a table to write; raise `InputError` for a missing folder, suffix or package."""
    path = output_file(field, path)
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{field}: {path.name!r} given; a name that ends in {' or '.join(SUFFIXES)} is expected",
            value=str(path),
        )
    if path.suffix == ".parquet":
        _optional("pyarrow", field)
    return path


def write_table(path: Path, columns: Columns, about: Mapping[str, str] | None = None) -> None:
    """Write a table in the format of the path's suffix; numbers in CSV files have full precision.

    Args:
        path: A path that ends in .csv or .parquet.
        columns: The columns by name.
        about: Metadata of a Parquet file.
    """
    if path.suffix == ".parquet":
        table = _optional("pyarrow", "path").table({name: np.asarray(x) for name, x in columns.items()})
        table = table.replace_schema_metadata({**(table.schema.metadata or {}), **(about or {})})
        import_module("pyarrow.parquet").write_table(table, path)
        return
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def _optional(package: str, field: str) -> Any:
    try:
        return import_module(package)
    except ImportError:
        raise InputError(
            f"{field}: {package} is not installed; pip install 'pinimpact[data]' installs it"
        ) from None


def nulls(value: Any) -> Any:
    """Return plain data with None for numbers that are not finite, which JSON does not have."""
    if isinstance(value, dict):
        return {key: nulls(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [nulls(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
