"""The search for the first fall of a sampled function below zero, run without the compiler."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

SEARCH = """
import json, math, random
from types import SimpleNamespace
from pinimpact.scene._kernels import event_location
event_location.set_state_within = event_location.set_directions_within = lambda *_: None
random.seed(1)
FUNCTIONS = {
    "parabola": lambda t: (t - 0.3) ** 2 - 1e-6,
    "kink": lambda t: abs(t - 0.37) - 1e-2,
    "root": lambda t: math.sqrt(max(0.81 - t, 0.0)) - 1e-3,
    "jump": lambda t: 1.0 if t < 0.618 else -1.0,
    "above": lambda t: 1.0 + math.sin(20.0 * t) + 1e-3,
    "noise": lambda t: 1e-9 * random.choice((-0.9, 100.0)),
}
found = {}
for name, function in FUNCTIONS.items():
    calls = []
    def value(work, i, t):
        calls.append(t)
        return function(t), 0.0
    first_fall = event_location.search_for_fall(value)
    time = first_fall(SimpleNamespace(step_start=0.0, step_length=1.0), 0, 1.0, 1e-9)
    found[name] = time if math.isfinite(time) else None, len(calls)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def found():
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", SEARCH], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("name", "time"),
    [("parabola", 0.299), ("kink", 0.36), ("root", 0.81 - 1e-6), ("jump", 0.618), ("above", None)],
)
def test_first_fall_of_function_is_found(found, name, time):
    assert found[name][0] == (None if time is None else pytest.approx(time, abs=1e-12))


def test_noise_below_the_tolerance_is_not_resolved(found):
    time, calls = found["noise"]
    assert time is None
    assert calls < 300
