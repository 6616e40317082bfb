"""The rows of an ensemble, and statistics of them."""

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
"""Number of resamples for the intervals of Sobol' indices, which is enough for two digits of their width."""


class Estimate(NamedTuple):
    """A value with its interval: `low` to `high` holds what more samples would give, with the confidence."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """What `ensemble` returns.

    Attributes:
        columns: Arrays by name: sample, the parameters, status ("OK", the name of an error, or for impacts
            that of a `Status`), message, and the rows of ``reduce``.
        parameters: Names of the columns that were drawn.
        design: How they were drawn.
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
        """Return the trajectory of a sample, which is simulated again.

        Raises:
            InputError: A sample that does not exist, or an ensemble of single impacts; errors of the sample.
        """
        row = whole_number("sample", sample, 0)
        if self._run is None or row >= len(self):
            what = (
                "single impacts have no trajectories" if self._run is None else f"{len(self)} samples exist"
            )
            raise InputError(f"sample: {sample} given; {what}", value=sample)
        return self._run(np.array([self.columns[name][row] for name in self.parameters], dtype=float))

    def to_dataframe(self) -> Any:
        """Return the columns as a pandas DataFrame; raise `InputError` if pandas is not installed."""
        return data_frame(self.columns)

    def _numbers(self, column: str) -> Array:
        name = choice("column", column, self.columns, "a column")
        values = self.columns[name]
        if values.dtype.kind not in "fiu":
            raise InputError(f"column: {name!r} has text, numbers expected", value=name)
        return np.asarray(values, dtype=float)

    def quantiles(
        self, column: str, q: ArrayLike = (0.05, 0.5, 0.95), confidence: float = 0.95
    ) -> list[Estimate]:
        """Return quantiles of a column with their intervals, both order statistics.

        Rows without a number are left out; infinite ones, such as the time of an impact that never comes,
        count. The intervals are exact for independent samples of any distribution; for other designs than
        "random" they are too wide.
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
        """Return how often each value of a column occurs, with Wilson's intervals, most frequent first."""
        return shares(self.columns[choice("column", column, self.columns, "a column")], confidence)

    def sobol_indices(self, column: str) -> Any:
        """Return Sobol' indices of a column, first order and total, as `scipy.stats.sobol_indices` does.

        Raises:
            InputError: Another design than "saltelli", or rows without a number.
        """
        if self.design != "saltelli":
            raise InputError(
                f'design: {self.design!r}, "saltelli" expected: run the ensemble with it', value=self.design
            )
        values, d = self._numbers(column), len(self.parameters)
        if not np.isfinite(values).all():
            raise InputError(
                f"column: {column!r} lacks a number in {counted(int((~np.isfinite(values)).sum()), 'row')}; "
                "Sobol' indices need all",
                value=column,
            )
        blocks = values.reshape(d + 2, -1)
        given = {"f_A": blocks[:1], "f_B": blocks[1:2], "f_AB": blocks[2:, None]}
        return stats.sobol_indices(func=given, n=blocks.shape[1])

    def results(self) -> list[str]:
        """Return the names of the columns that are neither parameters nor messages."""
        return [name for name in self.columns if name not in {"sample", "message", *self.parameters}]

    def plot(self, columns: Sequence[str] | None = None) -> Any:
        """Return a figure with the distributions of columns, by default of all results."""
        from ..visual.plots import distributions

        names = columns or self.results()
        return distributions({n: self.columns[choice("columns", n, self.columns, "a column")] for n in names})

    def facts(self) -> dict[str, Any]:
        """Return quantiles and frequencies of results as plain data, and Sobol' indices by their design."""
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
        """Return the Sobol' indices of a column by parameter, with intervals by bootstrap."""
        indices = self.sobol_indices(column)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an index that is the same in all resamples has no interval
            errors = indices.bootstrap(n_resamples=RESAMPLES)
        parts = {"first order": "first_order", "total": "total_order"}
        return {
            parameter: {
                name: _finite(
                    Estimate(
                        getattr(indices, part)[k],
                        getattr(errors, part).confidence_interval.low[k],
                        getattr(errors, part).confidence_interval.high[k],
                    )
                )
                for name, part in parts.items()
            }
            for k, parameter in enumerate(self.parameters)
        }

    def save_summary(self, path: str | Path) -> Path:
        """Write quantiles, frequencies, Sobol' indices and plots as one HTML page, and return its path."""
        from ..visual.ensemble_page import ensemble_page

        path = output_file("path", path)
        path.write_text(ensemble_page(self.facts(), self.plot()), encoding="utf-8")
        return path

    def summary(self, columns: Sequence[str] | None = None) -> str:
        """Return quantiles of columns with numbers, frequencies of those with text and the first error."""
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
    """Return how often each value occurs, with Wilson's intervals, most frequent first."""
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
