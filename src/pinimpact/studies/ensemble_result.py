"""The results of an ensemble, with statistics."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from .. import checks
from ..arrays import Array
from ..checks import choice, counted, output_file, real_numbers, whole_number
from ..errors import InputError
from ..scene.trajectory import Trajectory
from ..tables import data_frame

RESAMPLES = 200
"""Number of bootstrap resamples for the intervals of Sobol' indices; enough for two digits of their width."""


class Estimate(NamedTuple):
    """An estimate with its confidence interval from `low` to `high`."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """The result of `ensemble`.

    Attributes:
        columns: Arrays by name: sample, the parameters, status ("OK", the name of an error, or for impacts
            that of a `Status`), message, and the results of ``reduce``.
        parameters: Names of the parameters, which are columns too.
        design: Name of the sampling design.
    """

    columns: Mapping[str, NDArray[Any]]
    parameters: tuple[str, ...]
    design: str
    _run: Callable[[Array], Trajectory] | None = None

    def __len__(self) -> int:
        return len(self.columns["sample"])

    def __repr__(self) -> str:
        return f"Ensemble({counted(len(self), 'sample')} over {', '.join(self.parameters)})"

    def trajectory(self, sample: int) -> Trajectory:
        """Simulate a sample again and return its trajectory.

        Raises:
            InputError: A sample that does not exist, or an ensemble of single impacts.
            PinimpactError: The error of a sample that failed.
        """
        row = whole_number("sample", sample, 0)
        if self._run is None or row >= len(self):
            what = f"a number from 0 to {len(self) - 1} is expected"
            if self._run is None:
                what = "single impacts have no trajectories"
            raise InputError(f"sample: {sample} given; {what}", value=sample)
        return self._run(np.array([self.columns[name][row] for name in self.parameters], dtype=float))

    def to_dataframe(self) -> Any:
        """Return the columns as a pandas DataFrame; raise `InputError` if pandas is not installed."""
        return data_frame(self.columns)

    def _numbers(self, column: str) -> Array:
        name = choice("column", column, self.columns, "a column")
        values = self.columns[name]
        if values.dtype.kind not in "fiu":
            raise InputError(f"column: {name!r} contains text; a column of numbers is expected", value=name)
        return np.asarray(values, dtype=float)

    def quantiles(
        self, column: str, q: ArrayLike = (0.05, 0.5, 0.95), confidence: float = 0.95
    ) -> list[Estimate]:
        """Return quantiles of a column with confidence intervals, both from order statistics.

        NaN is omitted; infinite values, such as the time of an impact that does not occur, are included. The
        intervals are exact for independent samples of any distribution; for designs other than "random" they
        are too wide.
        """
        values, confidence = self._numbers(column), checks.level(confidence, "confidence")
        values = values[~np.isnan(values)]
        found = []
        for level in [checks.level(one, "q") for one in np.ravel(real_numbers("q", q)).tolist()]:
            if len(values) == 0:
                found.append(Estimate(np.nan, np.nan, np.nan))
                continue
            test = stats.quantile_test(values, p=level)
            interval = test.confidence_interval(confidence)
            value = np.quantile(values, level, method="inverted_cdf")
            found.append(Estimate(float(value), float(interval.low), float(interval.high)))
        return found

    def frequencies(self, column: str = "status", confidence: float = 0.95) -> dict[str, Estimate]:
        """Return the relative frequency of each value of a column, with Wilson intervals, largest first."""
        return shares(self.columns[choice("column", column, self.columns, "a column")], confidence)

    def sobol_indices(self, column: str) -> Any:
        """Return first-order and total Sobol' indices of a column: the result of `scipy.stats.sobol_indices`.

        Raises:
            InputError: A design other than "saltelli", or a column with NaN or infinite values.
        """
        if self.design != "saltelli":
            raise InputError(
                f"design: {self.design!r} given; Sobol' indices need an ensemble with the design 'saltelli'",
                value=self.design,
            )
        values, d = self._numbers(column), len(self.parameters)
        if not np.isfinite(values).all():
            raise InputError(
                f"column: {column!r} is not finite in {counted(int((~np.isfinite(values)).sum()), 'row')}; "
                "Sobol' indices need finite numbers in all rows",
                value=column,
            )
        blocks = values.reshape(d + 2, -1)
        given = {"f_A": blocks[:1], "f_B": blocks[1:2], "f_AB": blocks[2:, None]}
        return stats.sobol_indices(func=given, n=blocks.shape[1])

    def results(self) -> list[str]:
        """Return the names of the columns that are neither parameters nor messages."""
        return [name for name in self.columns if name not in {"sample", "message", *self.parameters}]

    def plot(self, columns: Sequence[str] | None = None) -> Any:
        """Return a figure with the distributions of columns; by default, of all results."""
        from ..visual.plots import distributions

        names = columns or self.results()
        return distributions({n: self.columns[choice("columns", n, self.columns, "a column")] for n in names})

    def facts(self) -> dict[str, Any]:
        """Return quantiles, frequencies and, for the design "saltelli", Sobol' indices as plain data."""
        results: dict[str, Any] = {}
        for name in self.results():
            if self.columns[name].dtype.kind in "fiu":
                estimates = zip(("5 %", "50 %", "95 %"), self.quantiles(name), strict=True)
                results[name] = {level: _finite(e) for level, e in estimates}
            else:
                results[name] = {value: _finite(e) for value, e in self.frequencies(name).items()}
        facts = {"samples": len(self), "parameters": list(self.parameters), "results": results}
        if self.design == "saltelli":
            numbers = {name: self.columns[name] for name, row in results.items() if "50 %" in row}
            varied = [n for n, x in numbers.items() if np.isfinite(x).all() and np.ptp(x) > 0.0]
            facts["sobol_indices"] = {name: self._indices(name) for name in varied}
        return facts

    def _indices(self, column: str) -> dict[str, Any]:
        """Return the Sobol' indices of a column by parameter, with bootstrap intervals."""
        indices = self.sobol_indices(column)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # equal indices in all resamples: no interval exists
            errors = indices.bootstrap(n_resamples=RESAMPLES)
        found: dict[str, Any] = {parameter: {} for parameter in self.parameters}
        for name, part in (("first order", "first_order"), ("total", "total_order")):
            values, interval = getattr(indices, part), getattr(errors, part).confidence_interval
            for parameter, *numbers in zip(self.parameters, values, *interval, strict=True):
                found[parameter][name] = _finite(Estimate(*numbers))
        return found

    def save_summary(self, path: str | Path) -> Path:
        """Write quantiles, frequencies, Sobol' indices and plots as one HTML page, and return its path."""
        from ..visual.ensemble_page import ensemble_page

        path = output_file("path", path)
        path.write_text(ensemble_page(self.facts(), self.plot()), encoding="utf-8")
        return path

    def summary(self, columns: Sequence[str] | None = None) -> str:
        """Return quantiles or frequencies of columns, and the first error message, as text."""
        lines = [f"{counted(len(self), 'sample')} over {', '.join(self.parameters)}"]
        failed = np.flatnonzero(self.columns["message"] != "")
        lines += [f"sample {self.columns['sample'][i]}: {self.columns['message'][i]}" for i in failed[:1]]
        for name in columns or self.results():
            if self.columns[choice("columns", name, self.columns, "a column")].dtype.kind in "fiu":
                low, middle, high = self.quantiles(name)
                lines.append(
                    f"{name}: median {middle.value:.4g} ({middle.low:.4g} to {middle.high:.4g}), "
                    f"90 % within {low.value:.4g} to {high.value:.4g}"
                )
            else:
                parts = (
                    f"{value or 'none'} {100 * share.value:.3g} % ({100 * share.low:.3g} to "
                    f"{100 * share.high:.3g})"
                    for value, share in self.frequencies(name).items()
                )
                lines.append(f"{name}: {', '.join(parts)}")
        return "\n".join(lines)


def shares(values: NDArray[Any], confidence: float) -> dict[str, Estimate]:
    """Return the relative frequency of each value, with Wilson intervals, largest first."""
    names, counts = np.unique(values.astype(str), return_counts=True)
    confidence = checks.level(confidence, "confidence")
    found = {}
    for k in np.argsort(-counts, kind="stable").tolist():
        test = stats.binomtest(int(counts[k]), len(values))
        interval = test.proportion_ci(confidence, method="wilson")
        share = float(counts[k]) / len(values)
        found[str(names[k])] = Estimate(share, float(interval.low), float(interval.high))
    return found


def _finite(estimate: Estimate) -> dict[str, float | None]:
    numbers = estimate._asdict()
    return {name: float(x) if np.isfinite(x) else None for name, x in numbers.items()}
