"""Error against time for every method on the standard problems, with the diagram.

python -m benchmarks.exchange_rate
"""

from __future__ import annotations

from benchmarks.timing import FIGURES

from pinimpact.cost import run_cost

if __name__ == "__main__":
    report = run_cost(progress=print)
    FIGURES.mkdir(parents=True, exist_ok=True)
    report.save(FIGURES / "work_precision.json")
    report.plot(FIGURES / "work_precision.png")
    table = report.table() + "\n\n" + report.answer(1e-6)
    (FIGURES / "work_precision.txt").write_text(table + "\n", encoding="utf-8")
    print(table)
