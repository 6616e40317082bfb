"""Ensembles: draws, independence of chunks and workers, lost workers, statistics, errors."""

import functools
import html
import itertools
import json
import os
import pathlib
import re
import subprocess
import sys
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from scipy import stats

from pinimpact import Contact, Event, InputError, Plane, Scene, SimulationError, UnknownNameError
from pinimpact.studies import ensembles
from pinimpact.studies.ensembles import ensemble
from pinimpact.studies.sampling import Sampling
from pinimpact.studies.study_folder import digest

from . import interrupted_study

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


def test_rows_agree_with_closed_form():
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
def test_draws_are_independent_of_chunks_and_workers(design, tmp_path, monkeypatch):
    whole = _run(design=design)
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 5)
    _same(whole, _run(design=design))
    with ThreadPoolExecutor(2) as pool:
        _same(whole, _run(design=design, executor=pool))
    assert len(np.unique(whole.columns["restitution"])) == 12


def test_processes_give_identical_results(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 5)
    _same(_run(), _run(executor=2, out=tmp_path / "study"))
    names = sorted(p.name for p in (tmp_path / "study").iterdir())
    assert names[0] == "samples-000000000.parquet"
    assert names[-1] == "study.json"
    assert 4 <= len(names) <= 13


@pytest.mark.parametrize("seed", range(20))
def test_chunks_cover_missing_samples_once(seed):
    rng = np.random.default_rng(seed)
    cuts = np.unique(np.r_[0, rng.integers(0, 500, 12), 500])
    known = {int(a): int(b - a) for a, b in itertools.pairwise(cuts) if rng.random() < 0.4}
    pieces = ensembles._Pieces(known, 500)
    done, flying = [(first, count) for first, count in known.items()], []
    while (piece := pieces.take(int(rng.integers(1, 5)))) is not None or flying:
        flying += [] if piece is None else [piece]
        if rng.random() < 0.1:
            pieces.give_back(flying)
            flying = []
        elif flying and rng.random() < 0.5:
            done.append(flying.pop(rng.integers(len(flying))))
            pieces.timed(done[-1][1], rng.uniform(0.0, 0.2))
    samples = [i for first, count in done for i in range(first, first + count)]
    assert sorted(samples) == list(range(500))


def test_size_of_chunks_reaches_target_time():
    pieces = ensembles._Pieces({}, 10**9)
    sizes = []
    for _ in range(12):
        _, count = pieces.take()
        sizes.append(count)
        pieces.timed(count, 1e-3 * count)
    assert sizes[:5] == [1, 8, 64, 512, int(ensembles.CHUNK_SECONDS / 1e-3)]
    assert len(set(sizes[4:])) == 1
    pieces.timed(sizes[-1], 1e3)  # slower samples
    assert pieces.take()[1] == 4


class _AtOnce(Executor):
    """An executor that runs each task when it is submitted."""

    submitted = 0

    def submit(self, task, *args):
        self.submitted += 1
        future = Future()
        future.set_result(task(*args))
        return future


@pytest.mark.parametrize(("seconds", "grows"), [(100.0, True), (0.0, False)])
def test_number_of_chunks_in_flight(seconds, grows):
    executor, pieces, most = _AtOnce(), ensembles._Pieces({}, 300), 0
    task = lambda first, count: ({"sample": np.arange(first, first + count)}, seconds)  # noqa: E731
    for yielded, _ in enumerate(ensembles._by_executor(task, pieces, executor, 2)):
        most = max(most, executor.submitted - yielded)
        pieces.size = 1
    assert (most > 4 * ensembles.IN_FLIGHT) == grows
    assert grows or most == 2 * ensembles.IN_FLIGHT


def _resume(out, **change):
    return ensemble(
        change.pop("scene", _scene()),
        [0.1],
        [0.0],
        change.pop("duration", 0.2),
        over=OVER,
        out=out,
        resume=True,
        **{"samples": 12, "seed": 5, **change},
    )


def test_resumed_study(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 5)
    whole = _run(out=tmp_path)
    files = sorted(tmp_path.glob("*.parquet"))  # of 1, 5, 5 and 1 samples
    files[1].unlink()
    kept = files[2].stat().st_mtime_ns
    with pytest.raises(InputError, match="has this study already"):
        _run(out=tmp_path)
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 3)
    _same(whole, _resume(tmp_path))
    assert files[2].stat().st_mtime_ns == kept
    _same(whole, _resume(tmp_path))  # nothing is missing
    with pytest.raises(InputError, match=r"another study \(samples 12 there, 13 here\)"):
        _resume(tmp_path, samples=13)
    with pytest.raises(InputError, match="of another scene or settings"):
        _resume(tmp_path, duration=0.3)


def test_samples_of_overlapping_chunks_count_once(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 5)
    whole = _run(out=tmp_path / "a")
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 3)
    _run(out=tmp_path / "b")
    for file in (tmp_path / "b").glob("*.parquet"):
        if not (tmp_path / "a" / file.name).exists():
            file.rename(tmp_path / "a" / file.name)
    _same(whole, _resume(tmp_path / "a"))


def _changed(folder, change):
    """Apply a function to the record of a study in a folder."""
    record = json.loads((folder / "study.json").read_text(encoding="utf-8"))
    change(record)
    (folder / "study.json").write_text(json.dumps(record), encoding="utf-8")


def test_files_of_other_studies_and_damaged_files_raise(tmp_path):
    _run(out=tmp_path / "study")
    _run(out=tmp_path / "other", rtol=1e-6)
    file, other = (tmp_path / name / "samples-000000000.parquet" for name in ("study", "other"))
    chunk = file.read_bytes()
    file.write_bytes(other.read_bytes())
    with pytest.raises(InputError, match=r"samples-000000000.parquet is a chunk of another study; remove"):
        _resume(tmp_path / "study")
    for damaged in (b"none", chunk[:-10], b""):
        file.write_bytes(damaged)
        with pytest.raises(InputError, match=r"samples-000000000.parquet is damaged; remove it"):
            _resume(tmp_path / "study")
    file.rename(file.with_name("samples-000000001.parquet"))
    with pytest.raises(InputError, match="is damaged"):
        _resume(tmp_path / "study")
    file.with_name("samples-000000001.parquet").unlink()
    _changed(tmp_path / "study", lambda record: record["versions"].update(scipy="1.0"))
    with pytest.raises(InputError, match=r"used scipy 1\.0, but .* is installed"):
        _resume(tmp_path / "study")
    (tmp_path / "study" / "study.json").write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match="is not the record of a study"):
        _resume(tmp_path / "study")


def _control(gain, function=np.sin):
    """Return a control with its gain in a closure."""

    def control(t, q, v):
        def force(x):
            return gain * function(x)

        return np.array([force(t)])

    return control


def _by_sine(t, q, v):
    return 0.0 * np.sin(v)


def _by_cosine(t, q, v):
    return 0.0 * np.cos(v)


class _Gain:
    def __init__(self, gain):
        self.gain = gain

    def force(self, t, q, v):
        return self.gain * v


@pytest.mark.parametrize(
    ("one", "same", "other"),
    [
        (_control(1.0), _control(1.0), _control(2.0)),
        (_by_sine, _by_sine, _by_cosine),
        (_Gain(1.0).force, _Gain(1.0).force, _Gain(2.0).force),
    ],
)
def test_study_with_another_function_is_another_study(tmp_path, one, same, other):
    _resume(tmp_path, scene=_scene(control=one))
    _resume(tmp_path, scene=_scene(control=same))
    with pytest.raises(InputError, match="of another scene or settings"):
        _resume(tmp_path, scene=_scene(control=other))


def _digest():
    sampling = Sampling(_scene(control=_control(1.0)), [0.1], [0.0], OVER, 9, 1, "random")
    return digest(sampling, {"duration": 1.0})


def test_digest_is_the_same_in_each_process():
    seed = "2" if os.environ.get("PYTHONHASHSEED") == "1" else "1"  # another one than here
    found = subprocess.run(
        [sys.executable, "-c", "from tests.test_ensemble import _digest; print(_digest())"],
        cwd=pathlib.Path(__file__).parents[1],
        env=dict(os.environ, PYTHONHASHSEED=seed),
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == _digest()


def test_files_contain_digest_of_their_study(tmp_path):
    from pyarrow import parquet

    _run(out=tmp_path)
    about = json.loads(parquet.read_schema(tmp_path / "samples-000000000.parquet").metadata[b"pinimpact"])
    study = json.loads((tmp_path / "study.json").read_text(encoding="utf-8"))
    assert about["digest"] == study["digest"]
    assert study["versions"].keys() >= {"python", "pin", "pinimpact", "numpy"}


class _Killing:
    """Row of a run that kills its worker process, once if it has a file as a flag, else each time."""

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


def test_killed_worker_is_replaced(tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 4)
    killing = _Killing(os.getpid(), str(tmp_path / "died"))
    killed = _run(executor=1, reduce=killing)
    assert (tmp_path / "died").exists()
    _same(_run(reduce=killing), killed)


@pytest.mark.slow
@pytest.mark.skipif(not pathlib.Path("/proc/self/stat").exists(), reason="needs /proc")
def test_study_after_kills_of_workers_and_main_process(tmp_path):
    columns, done = interrupted_study.kill_and_finish(tmp_path, kills=2, samples=100)
    assert done == {"worker": 1, "main": 1}
    assert interrupted_study.differences(columns, interrupted_study.undisturbed(tmp_path, 100)) == []


def test_repeatedly_killed_workers_raise(monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 4)
    monkeypatch.setattr("pinimpact.studies.ensembles.REMAKES", 1)  # each takes the start of a process
    with pytest.raises(SimulationError, match=r"died 2 times .* in samples 0 to 3"):
        _run(executor=1, reduce=_Killing(os.getpid()))


def test_sample_that_raises_is_a_row_with_its_message():
    found = ensemble(
        _scene(), [0.1], [0.0], 0.05, over={"restitution": stats.uniform(-0.5, 1.0)}, samples=8, seed=1
    )
    bad = found.columns["restitution"] < 0
    assert 0 < bad.sum() < 8
    np.testing.assert_array_equal(found.columns["status"] == "InputError", bad)
    assert all("restitution" in text for text in found.columns["message"][bad])
    assert np.isnan(found.columns["v.rail"][bad]).all()
    assert np.isfinite(found.columns["v.rail"][~bad]).all()
    first = int(np.argmax(bad))
    assert f"sample {first}: {found.columns['message'][first]}\n" in found.summary()
    assert sum(share.value for share in found.frequencies().values()) == pytest.approx(1.0)


def test_single_impacts_against_closed_form():
    speed, e = stats.norm(-1.0, 0.1), stats.uniform(0.2, 0.6)
    found = ensemble(
        _scene(), [0.0], [0.0], None, over={"v0:rail": speed, "restitution": e}, samples=4000, seed=2
    )
    after = found.columns["v.rail"]
    np.testing.assert_allclose(after, -found.columns["restitution"] * found.columns["v0:rail"], rtol=1e-13)
    mean = 0.5  # mean of e times mean speed 1
    spread = np.sqrt((0.12 / 4 + 0.25) * (0.01 + 1.0) - 0.25)
    assert abs(after.mean() - mean) < 4 * spread / np.sqrt(len(after))
    middle = found.quantiles("v.rail", 0.5)[0]
    assert middle.low < middle.value < middle.high


def test_columns_of_parameters_are_their_draws():
    """Also of those that do not act, because a parameter of the only contact overrides them."""
    over = {"friction:tip": stats.uniform(0.1, 0.2), "friction": stats.uniform(0.5, 0.4)}
    drawn = ensemble(_scene(), [0.0], [-1.0], 0.01, over=over, samples=5, seed=3).columns
    found = ensemble(_scene(), [0.0], [-1.0], None, over=over, samples=5, seed=3).columns
    for name in over:
        np.testing.assert_array_equal(found[name], drawn[name])
        assert ((over[name].support()[0] <= found[name]) & (found[name] <= over[name].support()[1])).all()


def test_quantiles_with_infinite_values():
    """A mass with v ~ N(0, 1) m/s upwards falls by h = 0.1 m in a time of (v + √(v² + 2 g h))/g."""

    def first(trajectory):
        return {"first": trajectory.impacts[0].time if trajectory.impacts else np.inf}

    over = {"v0:rail": stats.norm(0.0, 1.0)}
    found = ensemble(_scene(), [0.1], [0.0], 0.2, over=over, samples=300, seed=5, reduce=first)
    v = found.columns["v0:rail"]
    falls = (v + np.sqrt(v**2 + 2 * 9.81 * 0.1)) / 9.81
    never = falls > 0.2
    assert 0.05 < never.mean() < 0.5
    median, top = found.quantiles("first", [0.5, 0.99])
    assert median.value == pytest.approx(np.sort(falls)[149], rel=1e-9)  # the 150th of 300 values
    assert top.value == np.inf
    assert "90 % within" in found.summary()
    found.plot()


@pytest.mark.parametrize(
    ("q", "confidence"), [(0.0, 0.95), (1.5, 0.95), (np.nan, 0.95), (0.5, 95), (0.5, 1.0)]
)
def test_invalid_levels_of_quantiles_raise(q, confidence):
    with pytest.raises(InputError, match=r"between 0 and 1|finite"):
        _run(3).quantiles("v.rail", q, confidence)


def test_sobol_indices_against_closed_form():
    # the variance of v⁺ = −e v, of independent e and v, is the sum of μ_e² σ_v², μ_v² σ_e² and σ_e² σ_v²
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
    with pytest.raises(InputError, match=r"design: .random. given; .* .saltelli."):
        _run().sobol_indices("v.rail")


@pytest.mark.parametrize("samples", [1, 4, 5])
def test_few_samples_have_sobol_indices_with_intervals(samples, tmp_path):
    over = {"v0:rail": stats.uniform(-2.0, 1.0), "restitution": stats.uniform(0.2, 0.6)}
    found = ensemble(_scene(), [0.0], [0.0], None, over=over, samples=samples, design="saltelli")
    v = found.columns["v.rail"]
    assert len(v) == 8  # two base samples for A, for B, and for A with each column of B
    a, b, *mixed = v.reshape(4, 2)
    spread = np.r_[a, b].var()
    indices = found.facts()["sobol_indices"]["v.rail"]
    for name, ab in zip(found.parameters, mixed, strict=True):  # Saltelli et al. (2010), Table 2 (f)
        total = indices[name]["total"]
        assert total["value"] == pytest.approx(((a - ab) ** 2).mean() / 2 / spread, rel=1e-12)
        assert total["low"] <= total["value"] <= total["high"]
    found.save_summary(tmp_path / "summary.html")


@pytest.mark.parametrize("design", ["sobol", "halton", "saltelli"])
def test_independent_numbers_of_one_distribution(design):
    """They are drawn as those of single distributions are."""
    parts = {"friction": stats.uniform(0.2, 0.3), "restitution": stats.uniform(0.0, 1.0)}
    joint = {("friction", "restitution"): stats.uniform([0.2, 0.0], [0.3, 1.0])}
    how = {"samples": 8, "design": design}
    one, other = (ensemble(_scene(), [0.0], [-1.0], None, over=over, **how) for over in (parts, joint))
    _same(one, other)


def test_integers_are_drawn_as_numbers():
    over = {"restitution": stats.randint(0, 2)}
    found = ensemble(_scene(), [0.0], [-1.0], None, over=over, samples=9)
    assert found.columns["restitution"].dtype == float
    np.testing.assert_allclose(found.columns["v.rail"], found.columns["restitution"])


def _tables(page):
    """Return the rows of all tables of a page, cells without markup."""
    rows = re.findall(r"<tr>(.*?)</tr>", page)
    return [tuple(re.sub("<.*?>", "", cell) for cell in re.findall(r"<t[dh]>(.*?)</t[dh]>", r)) for r in rows]


def test_summary_page(tmp_path):
    """The page has quantiles, frequencies and Sobol indices, and loads no other files."""
    over = {"v0:rail": stats.uniform(-2.0, 1.0), "restitution": stats.uniform(0.2, 0.6)}
    given = {"over": over, "samples": 400, "design": "saltelli"}
    found = ensemble(_scene(), [0.0], [0.0], None, **given)
    page = found.save_summary(tmp_path / "summary.html").read_text(encoding="utf-8")
    rows = _tables(page)
    low, middle, high = found.quantiles("v.rail")
    written = next(row for row in rows if row[0] == "v.rail" and len(row) == 4 and row[1] not in over)
    for cell, estimate in zip(written[1:], (low, middle, high), strict=True):
        numbers = [float(x) for x in re.findall(r"[-+.e\d]+", cell)]
        np.testing.assert_allclose(numbers, estimate, rtol=1e-3)
    assert any(row[:2] == ("status", "SEPARATED") and row[2].startswith("100 (") for row in rows)
    indices = found.sobol_indices("v.rail")
    for k, name in enumerate(found.parameters):
        first, total = next(row[2:] for row in rows if row[:2] == ("v.rail", name))
        value, lowest, highest = (float(x) for x in re.findall(r"[-+.e\d]+", first))
        assert value == pytest.approx(indices.first_order[k], rel=1e-3)
        assert lowest < value < highest
        assert float(total.split()[0]) == pytest.approx(indices.total_order[k], rel=1e-3)
    assert page.count("data:image/png;base64,") == 1
    assert not re.search(r"""(src|href)=["'](?!data:)""", page)


TEXT = "<small></small><script>alert(1)</script> & <b>"


def _injected(trajectory):
    return {TEXT: TEXT, f"x{TEXT}": 1.0}


def test_names_and_values_are_text_in_the_summary_page(tmp_path):
    page = _run(3, reduce=_injected).save_summary(tmp_path / "summary.html").read_text(encoding="utf-8")
    assert "<script" not in page
    cells = [html.unescape(cell) for row in _tables(page) for cell in row]
    assert cells.count(TEXT) == 2
    assert cells.count(f"x{TEXT}") == 1
    assert "100 (43.85 to 100)" in cells  # Wilson's interval for 3 of 3: from n / (n + 1.96²)


def run_command(*options):
    """Run the command on `study.toml`."""
    from click.testing import CliRunner

    from pinimpact.app.cli import main

    return CliRunner().invoke(main, ["ensemble", "study.toml", "-o", "study", *options])


def write_study(samples, friction, scale):
    """Write `study.toml`, with friction drawn from a uniform distribution, to the working directory."""
    pathlib.Path("study.toml").write_text(
        f'scene = "falling_rod"\nsamples = {samples}\nduration = 0.01\n[over.friction]\n'
        f'distribution = "uniform"\nloc = {friction}\nscale = {scale}\n',
        encoding="utf-8",
    )


def test_command_writes_summary_and_resumes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_study(3, 0.2, 0.4)
    first = run_command()
    assert first.exit_code == 0, first.output
    assert "status: OK 100 %" in first.output
    assert f"Summary: {pathlib.Path('study/summary.html')}" in first.output
    assert "<h2>Quantiles" in pathlib.Path("study/summary.html").read_text(encoding="utf-8")
    again = run_command()
    assert again.exit_code == 1
    assert "--resume" in again.output
    pathlib.Path("study/samples-000000001.parquet").unlink()
    third = run_command("--resume")
    assert third.exit_code == 0
    assert third.output == first.output


def test_command_fails_if_all_samples_fail(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_study(2, -0.4, 0.2)
    found = run_command("-q")
    assert found.exit_code == 1
    assert "all 2 samples failed" in found.output
    assert "friction" in found.output


def test_change_of_q0_is_in_tangent_space():
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


def test_trajectories_are_saved_on_request(tmp_path):
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
        (
            UnknownNameError,
            "'friction:foot' given, but the scene has no 'foot'",
            {"over": {"friction:foot": stats.norm()}},
        ),
        (InputError, "0.3 given, a frozen distribution", {"over": {"friction": 0.3}}),
        (InputError, "a frozen distribution", {"over": {"friction": stats.norm}}),
        (InputError, "nothing can be drawn .*a draw is nan", {"over": {"friction": stats.norm(np.nan)}}),
        (InputError, "out: .*test_ensemble.py cannot be a folder", {"out": __file__}),
        (InputError, "duration: -1.0 given", {"duration": -1.0}),
        (InputError, "rtol: -1.0 given", {"rtol": -1.0}),
        (UnknownNameError, "is not a scheme", {"scheme": "fast"}),
        (TypeError, "unexpected keyword argument 'nonsense'", {"nonsense": 3}),
        (InputError, "is given twice", {"over": {"v0": stats.norm(), "v0:rail": stats.norm()}}),
        (
            InputError,
            r"draws of shape \(2,\) given, 1 number expected",
            {"over": {"v0": stats.multivariate_normal([0, 0])}},
        ),
        (UnknownNameError, "is not a design", {"design": "grid"}),
        (InputError, "a concurrent.futures.Executor expected", {"executor": "dask"}),
        (InputError, "executor: 0 given", {"executor": 0}),
        (InputError, "keep: True given without out", {"keep": True}),
        (InputError, "reduce: 3 is not a function", {"reduce": 3}),
        (InputError, "nothing can be drawn from .*scale", {"over": {"friction": stats.norm(0.1, -1.0)}}),
        (InputError, "reduce: given with duration=None", {"duration": None, "reduce": dict}),
        (InputError, "keep: given with duration=None", {"duration": None, "keep": True, "out": "x"}),
        (InputError, "rtol: given with duration=None", {"duration": None, "rtol": 1e-6}),
        (
            InputError,
            "does not change a single impact",
            {"duration": None, "over": {"stiffness": stats.uniform()}},
        ),
    ],
)
def test_bad_input_is_named(error, match, change):
    given = {"over": OVER, "samples": 2} | change
    with pytest.raises(error, match=match):
        ensemble(_scene(), [0.1], [0.0], given.pop("duration", 0.1), **given)


def test_scene_that_cannot_be_pickled_raises_before_the_first_run(tmp_path):
    scene = _scene(control=lambda t, q, v: 0.0 * v)
    with pytest.raises(InputError, match="scene: cannot be sent to other processes"):
        ensemble(scene, [0.1], [0.0], 0.1, over=OVER, samples=2, executor=2, out=tmp_path / "none")
    assert not (tmp_path / "none").exists()
    with ProcessPoolExecutor(1) as pool, pytest.raises(InputError, match="cannot be sent"):
        ensemble(scene, [0.1], [0.0], 0.1, over=OVER, samples=2, executor=pool)


def _rows(trajectory, what):
    return {
        "array": {"v": trajectory.v[-1]},
        "list": [1.0],
        "taken": {"status": 1.0},
        "good": {"v": trajectory.v[-1, 0], "what": "good"},
    }[what]


@pytest.mark.parametrize(
    ("what", "status", "match"),
    [
        ("array", "InputError", "reduce: 'v' is .*; a number or a text expected"),
        ("list", "InputError", r"reduce: \[1.0\] returned, a row by name expected"),
        ("taken", "InputError", "reduce: a column 'status' returned"),
        ("good", "OK", "^$"),
    ],
)
def test_rows_of_reduce_are_numbers_or_texts(what, status, match):
    found = _run(2, reduce=functools.partial(_rows, what=what))
    assert set(found.columns["status"]) == {status}
    assert all(re.search(match, text) for text in found.columns["message"])


def _direction(trajectory, other):
    """Return in which direction the mass moves: "down", `other`, or an error."""
    v = trajectory.v[-1, 0]
    if v > 0.4:
        raise ValueError("too fast")
    return {"direction": "down" if v < 0 else other}


@pytest.mark.parametrize("chunk", [1, 3, 12])
@pytest.mark.parametrize("files", [False, True])
def test_kinds_of_columns_do_not_depend_on_chunks(chunk, files, tmp_path, monkeypatch):
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", chunk)
    with ThreadPoolExecutor(2) as pool:
        how = {"out": tmp_path / "study"} if files else {"executor": pool}
        found = _run(reduce=functools.partial(_direction, other="up"), **how)
        speeds = _run().columns["v.rail"]
        wanted = ["" if v > 0.4 else "down" if v < 0 else "up" for v in speeds]
        assert {*wanted} == {"", "down", "up"}
        assert found.columns["direction"].tolist() == wanted
        how = {"out": tmp_path / "mixed"} if files else {"executor": pool}
        with pytest.raises(InputError, match="reduce: column 'direction' mixes text and numbers"):
            _run(reduce=functools.partial(_direction, other=1), **how)


class _Counting:
    """A sampled control whose force increases with each call."""

    def __init__(self):
        self.calls = 0

    def __call__(self, t, q, v):
        self.calls += 1
        return np.array([float(self.calls)])


def test_each_sample_has_its_own_copy_of_the_control():
    scene = _scene(control=_Counting(), period=0.05)
    given = {"over": {"v0:rail": stats.uniform(0.0, 0.0)}, "samples": 3}
    found = ensemble(scene, [1.0], [0.0], 0.2, **given)
    assert np.ptp(found.columns["v.rail"]) == 0.0
    assert scene.control.calls == 0


def test_run_ended_by_event_is_a_row():
    scene = _scene(events=[Event(_half_way, terminal=True)])
    found = ensemble(scene, [0.1], [0.0], 0.2, over={"restitution": stats.uniform()}, samples=2)
    assert set(found.columns["status"]) == {"OK"}
    np.testing.assert_allclose(found.columns["q.rail"], 0.05, rtol=1e-9)


def _half_way(t, q, v):
    return q[0] - 0.05


def test_trajectory_of_sample_is_recomputed():
    found = _run(3)
    trajectory = found.trajectory(2)
    assert trajectory.v[-1, 0] == found.columns["v.rail"][2]
    with pytest.raises(InputError, match="sample: 3 given; a number from 0 to 2 is expected"):
        found.trajectory(3)
    hits = ensemble(_scene(), [0.0], [-1.0], None, over=OVER, samples=2)
    with pytest.raises(InputError, match="single impacts have no trajectories"):
        hits.trajectory(0)


def test_impacts_with_invalid_numbers_are_rows_with_messages():
    found = ensemble(
        _scene(), [0.0], [-1.0], None, over={"restitution": stats.uniform(-0.5, 1.0)}, samples=20
    )
    bad = found.columns["restitution"] < 0.0
    assert 0 < bad.sum() < 20
    assert set(found.columns["status"][bad]) == {"INVALID_NUMBERS"}
    assert all("restitution" in text for text in found.columns["message"][bad])
    assert set(found.columns["message"][~bad]) == {""}


class _Failing(ThreadPoolExecutor):
    """Executor whose third task raises."""

    count = 0

    def submit(self, *args):
        self.count += 1
        return super().submit(_fail) if self.count == 3 else super().submit(*args)


def _fail():
    raise OSError("no route to host")


def test_failing_executor_raises_after_saving_finished_chunks(tmp_path):
    with (
        _Failing(1) as pool,
        pytest.raises(SimulationError, match=r"failed \(OSError: no route to host\) in samples"),
    ):
        _run(executor=pool, out=tmp_path)
    assert len(list(tmp_path.glob("*.parquet"))) >= 2
    _same(_run(), _resume(tmp_path))


def test_dask_cluster_with_killed_worker_gives_identical_results(monkeypatch):
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    monkeypatch.setattr("pinimpact.studies.ensembles.LARGEST_CHUNK", 4)
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
