"""Error against run time of all methods for the standard problems, as a table and a diagram.

python -m benchmarks.exchange_rate
"""

from __future__ import annotations

from benchmarks.timing import FIGURES

from pinimpact.studies.cost import run_cost

TARGETS = (1e-3, 1e-6, 1e-12)

if __name__ == "__main__":
    report = run_cost(progress=print)
    FIGURES.mkdir(parents=True, exist_ok=True)
    report.save(FIGURES / "work_precision.json")
    report.plot(FIGURES / "work_precision.png")
    answers = "\n\n".join(report.advice(target) for target in TARGETS)
    (FIGURES / "cheapest.txt").write_text(answers + "\n", encoding="utf-8")
    print(report.table(), answers, sep="\n\n")
