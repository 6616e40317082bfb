"""A study whose workers and main process are killed while it runs.

`python -m tests.interrupted_study FOLDER SAMPLES` runs or resumes the study in a folder with two workers.
"""

import os
import random
import signal
import subprocess
import sys
import time
from multiprocessing import parent_process
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy import stats

from pinimpact import Contact, Plane, Scene
from pinimpact.studies import ensembles

SAMPLES = 300
LONGEST = 120.0
"""Time without progress after which a test fails [s]."""


class Row:
    """Row of a run that, in a worker, takes 20 ms more and records its process as a file in a folder."""

    def __init__(self, folder):
        self.folder = str(folder)

    def __call__(self, trajectory):
        if parent_process() is not None:
            Path(self.folder, str(os.getpid())).touch()
            time.sleep(0.02)
        return ensembles.final_state(trajectory)


def study(folder, processes, executor, samples=SAMPLES):
    """Run or resume the study."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.OP_FRAME))
    over = {"restitution": stats.uniform(0.2, 0.6), "v0:rail": stats.norm(0.0, 0.2)}
    given = {"over": over, "samples": samples, "seed": 5, "reduce": Row(processes), "executor": executor}
    scene = Scene(model, [Contact("tip", Plane(), name="tip")])
    return ensembles.ensemble(scene, [0.1], [0.0], 0.4, out=folder, resume=True, **given)


def alive(pid):
    """Return whether a process runs."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def wait_for(what, met):
    """Wait until a condition is met."""
    begun = time.monotonic()
    while not met():
        assert time.monotonic() - begun < LONGEST, f"no {what} in {LONGEST} s"
        time.sleep(0.01)


def kill_and_finish(root, kills, seed=0, samples=SAMPLES):
    """Kill workers and the main process in turn, continue each time, and return columns and kills by victim.

    After a kill of the main process its workers have to end too.
    """
    rng = random.Random(seed)
    folder, processes = root / "study", root / "processes"
    processes.mkdir()
    command = [sys.executable, "-m", "tests.interrupted_study", str(root), str(samples)]
    cwd = Path(__file__).parents[1]
    done = {"worker": 0, "main": 0}
    main = subprocess.Popen(command, cwd=cwd)
    while sum(done.values()) < kills:
        before = len(list(folder.glob("samples-*")))
        wait_for("chunk", lambda before=before: len(list(folder.glob("samples-*"))) > before)
        time.sleep(rng.uniform(0.0, 0.15))  # at any moment of a chunk
        assert main.poll() is None, "the study has ended before all kills"
        workers = [int(file.name) for file in processes.iterdir() if alive(int(file.name))]
        if sum(done.values()) % 2 == 0 and workers:
            os.kill(rng.choice(workers), signal.SIGKILL)
            done["worker"] += 1
        else:
            main.kill()
            main.wait()
            done["main"] += 1
            wait_for("end of the workers", lambda workers=workers: not any(map(alive, workers)))
            main = subprocess.Popen(command, cwd=cwd)
    assert main.wait(timeout=10 * LONGEST) == 0
    return study(folder, processes, None, samples).columns, done


def undisturbed(root, samples=SAMPLES):
    """Return the columns of the study in this process."""
    (root / "none").mkdir()
    processes = root / "processes"
    processes.mkdir(exist_ok=True)
    return study(root / "whole", processes, None, samples).columns


def differences(one, other):
    """Return the names of columns that differ in a bit."""
    return [name for name in one if not np.array_equal(one[name], other[name])] + sorted(
        set(one) ^ set(other)
    )


if __name__ == "__main__":
    ensembles.LARGEST_CHUNK = 3
    root = Path(sys.argv[1])
    study(root / "study", root / "processes", 2, int(sys.argv[2]))
