"""Ensembles: draws, independence of chunks and workers, survival, statistics against closed forms, errors."""

import json
import os
import pathlib
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from scipy import stats

from pinimpact import Contact, InputError, Plane, Scene, SimulationError, UnknownNameError
from pinimpact.studies.ensembles import ensemble

pytest.importorskip("pyarrow")


def _scene(restitution=0.5, **more):
    """Return a mass on a vertical rail above a plane."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.OP_FRAME))
    return Scene(model, [Contact("tip", Plane(), restitution=restitution, name="tip")], **more)


OVER = {"restitution": stats.uniform(0.2, 0.6), "v0:rail": stats.norm(0.0, 0.2)}


def _same(one, other):
    assert list(one.columns) == list(other.columns)
    for name, column in one.columns.items():
        np.testing.assert_array_equal(column, other.columns[name], err_msg=name)


def _run(samples=12, **how):
    return ensemble(_scene(), [0.1], [0.0], 0.2, over=OVER, samples=samples, seed=5, **how)


def test_rows_are_those_of_single_runs():
    found = _run()
    for e, kick, speed, height in zip(
        *(found.columns[n] for n in ("restitution", "v0:rail", "v.rail", "q.rail")), strict=True
    ):
        g = 9.81
        impact = np.sqrt(kick**2 + 2 * g * 0.1)
        after = 0.2 - (kick + impact) / g
        v = e * impact - g * after
        if after > 0 and e * impact / g * 2 > after:  # one impact
            assert speed == pytest.approx(v, abs=1e-9)
            assert height == pytest.approx(e * impact * after - g * after**2 / 2, abs=1e-9)
    assert set(found.columns["status"]) == {"OK"}


@pytest.mark.parametrize("design", ["random", "sobol", "halton"])
def test_draws_depend_neither_on_chunks_nor_on_workers(design, tmp_path, monkeypatch):
    whole = _run(design=design)
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 5)
    _same(whole, _run(design=design))
    with ThreadPoolExecutor(2) as pool:
        _same(whole, _run(design=design, executor=pool))
    assert len(np.unique(whole.columns["restitution"])) == 12


def test_processes_give_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 5)
    _same(_run(), _run(executor=2, out=tmp_path / "study"))
    assert sorted(p.name for p in (tmp_path / "study").iterdir()) == [
        "samples-000000000.parquet",
        "samples-000000005.parquet",
        "samples-000000010.parquet",
        "study.json",
    ]


def test_a_study_is_resumed_after_a_check(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 5)
    whole = _run(out=tmp_path)
    (tmp_path / "samples-000000005.parquet").unlink()
    kept = (tmp_path / "samples-000000000.parquet").stat().st_mtime_ns
    with pytest.raises(InputError, match="has this study already"):
        _run(out=tmp_path)
    _same(whole, _run(out=tmp_path, resume=True))
    assert (tmp_path / "samples-000000000.parquet").stat().st_mtime_ns == kept
    with pytest.raises(InputError, match=r"another study \(samples 12 there, 13 here\)"):
        _run(samples=13, out=tmp_path, resume=True)
    with pytest.raises(InputError, match="of another scene or settings"):
        ensemble(_scene(), [0.1], [0.0], 0.3, over=OVER, samples=12, seed=5, out=tmp_path, resume=True)
    (tmp_path / "samples-000000010.parquet").write_bytes(b"none")
    with pytest.raises(InputError, match="is not a chunk of 2 samples"):
        _run(out=tmp_path, resume=True)
    (tmp_path / "study.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="is not the record of a study"):
        _run(out=tmp_path, resume=True)


def test_files_name_their_study(tmp_path):
    from pyarrow import parquet

    _run(out=tmp_path)
    about = json.loads(parquet.read_schema(tmp_path / "samples-000000000.parquet").metadata[b"pinimpact"])
    study = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert about["digest"] == study["digest"]
    assert study["versions"].keys() >= {"python", "pin", "pinimpact", "numpy"}


class _Killing:
    """A row of a run that kills its process: once per file that can be made, or always without a file."""

    def __init__(self, parent, flag=None):
        self.parent, self.flag = parent, flag

    def __call__(self, trajectory):
        if os.getpid() != self.parent:
            if self.flag is None:
                os._exit(1)
            try:
                pathlib.Path(self.flag).touch(exist_ok=False)
            except FileExistsError:
                pass
            else:
                os._exit(1)
        return {"v": float(trajectory.v[-1, 0])}


def test_a_worker_that_dies_is_replaced_and_changes_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 4)
    killing = _Killing(os.getpid(), str(tmp_path / "died"))
    killed = _run(executor=1, reduce=killing)
    assert (tmp_path / "died").exists()
    _same(_run(reduce=killing), killed)


def test_workers_that_die_again_and_again_are_an_error(monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 4)
    with pytest.raises(SimulationError, match="died 3 times, the last time in samples 0 to 11"):
        _run(executor=1, reduce=_Killing(os.getpid()))


def test_a_sample_that_raises_is_a_row():
    found = ensemble(
        _scene(), [0.1], [0.0], 0.05, over={"restitution": stats.uniform(-0.5, 1.0)}, samples=8, seed=1
    )
    bad = found.columns["restitution"] < 0
    assert 0 < bad.sum() < 8
    np.testing.assert_array_equal(found.columns["status"] == "InputError", bad)
    assert all("restitution" in text for text in found.columns["message"][bad])
    assert np.isnan(found.columns["v.rail"][bad]).all()
    assert np.isfinite(found.columns["v.rail"][~bad]).all()
    assert sum(share.value for share in found.frequencies().values()) == pytest.approx(1.0)


def test_single_impacts_follow_the_distributions():
    speed, e = stats.norm(-1.0, 0.1), stats.uniform(0.2, 0.6)
    found = ensemble(
        _scene(), [0.0], [0.0], None, over={"v0:rail": speed, "restitution": e}, samples=4000, seed=2
    )
    after = found.columns["v.rail"]
    np.testing.assert_allclose(after, -found.columns["restitution"] * found.columns["v0:rail"], rtol=1e-13)
    mean = 0.5  # of e, times 1
    spread = np.sqrt((0.12 / 4 + 0.25) * (0.01 + 1.0) - 0.25)
    assert abs(after.mean() - mean) < 4 * spread / np.sqrt(len(after))
    middle = found.quantiles("v.rail", 0.5)[0]
    assert middle.low < middle.value < middle.high


def test_sobol_indices_of_a_product_are_those_of_its_variances():
    # v⁺ = −e v of independent e and v: parts μ_v² σ_e², μ_e² σ_v² and σ_e² σ_v² of its variance
    found = ensemble(
        _scene(),
        [0.0],
        [0.0],
        None,
        over={"v0:rail": stats.uniform(-2.0, 1.0), "restitution": stats.uniform(0.2, 0.6)},
        samples=4000,
        design="saltelli",
    )
    of_v, of_e = 1 / 12, 0.36 / 12
    parts = np.array([0.25 * of_v, 2.25 * of_e, of_v * of_e])
    indices = found.sobol_indices("v.rail")
    np.testing.assert_allclose(indices.first_order, parts[:2] / parts.sum(), atol=0.01)
    np.testing.assert_allclose(indices.total_order, (parts[:2] + parts[2]) / parts.sum(), atol=0.01)
    with pytest.raises(InputError, match=r"design: .random., .saltelli. expected"):
        _run().sobol_indices("v.rail")


def test_a_tangent_of_the_start_is_added_on_the_manifold():
    robot = pin.Model()
    joint = robot.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "base")
    robot.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
    robot.addFrame(pin.Frame("tip", joint, pin.SE3.Identity(), pin.OP_FRAME))
    scene = Scene(robot, [Contact("tip", Plane())])
    q0 = np.array([0, 0, 1.0, 0, 0, 0, 1])
    spread = stats.multivariate_normal(np.zeros(6), 0.01 * np.eye(6))
    found = ensemble(scene, q0, np.zeros(6), 1e-9, over={"q0": spread}, samples=3)
    for i in range(3):
        change = [found.columns[f"q0:base.{name}"][i] for name in ("vx", "vy", "vz", "wx", "wy", "wz")]
        end = [found.columns[f"q.base.{name}"][i] for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        np.testing.assert_allclose(end, pin.integrate(robot, q0, np.array(change)), atol=1e-8)


def test_trajectories_are_kept_on_request(tmp_path):
    from pinimpact import Trajectory

    found = _run(samples=2, out=tmp_path, keep=True)
    kept = Trajectory.load(tmp_path / "trajectory-000000001.npz")
    assert kept.v[-1, 0] == found.columns["v.rail"][1]


@pytest.mark.parametrize(
    ("error", "match", "change"),
    [
        (InputError, "samples: 0 given", {"samples": 0}),
        (InputError, "over: {} given, distributions", {"over": {}}),
        (UnknownNameError, "did you mean 'friction'", {"over": {"fricton": stats.norm()}}),
        (UnknownNameError, "'friction:foot' names nothing", {"over": {"friction:foot": stats.norm()}}),
        (InputError, "0.3 given, a frozen distribution", {"over": {"friction": 0.3}}),
        (InputError, "is given twice", {"over": {"v0": stats.norm(), "v0:rail": stats.norm()}}),
        (
            InputError,
            r"draws of shape \(2,\) given, 1 numbers expected",
            {"over": {"v0": stats.multivariate_normal([0, 0])}},
        ),
        (UnknownNameError, "is not a design", {"design": "grid"}),
        (InputError, "a concurrent.futures.Executor expected", {"executor": "dask"}),
        (InputError, "executor: 0 given", {"executor": 0}),
        (InputError, "keep: True given without out", {"keep": True}),
        (InputError, "reduce: 3 is not a function", {"reduce": 3}),
    ],
)
def test_bad_input_is_named(error, match, change):
    given = {"over": OVER, "samples": 2} | change
    with pytest.raises(error, match=match):
        ensemble(_scene(), [0.1], [0.0], 0.1, **given)


def test_what_cannot_be_sent_is_refused_before_anything_runs(tmp_path):
    scene = _scene(control=lambda t, q, v: 0.0 * v)
    with pytest.raises(InputError, match="scene: cannot be sent to other processes"):
        ensemble(scene, [0.1], [0.0], 0.1, over=OVER, samples=2, executor=2, out=tmp_path / "none")
    assert not (tmp_path / "none").exists()
    with ProcessPoolExecutor(1) as pool, pytest.raises(InputError, match="cannot be sent"):
        ensemble(scene, [0.1], [0.0], 0.1, over=OVER, samples=2, executor=pool)


def test_a_dask_cluster_gives_the_same_bits_when_a_worker_is_killed(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    monkeypatch.setattr("pinimpact.studies.ensembles._chunk", lambda task: 4)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        killed = []

        def progress(done, count):
            if not killed:
                killed.append(next(iter(cluster.workers.values())))
                client.run(os._exit, 1, workers=[killed[0].worker_address], on_error="ignore", wait=False)

        _same(_run(40), _run(40, executor=client.get_executor(), progress=progress))
        assert killed
