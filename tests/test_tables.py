"""Results as tables: data frames, CSV and Parquet."""

import csv
import sys
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

from pinimpact import (
    Contact,
    InputError,
    Plane,
    Scene,
    Trajectory,
    UnknownNameError,
    impact,
    impacts,
    load_robot,
    simulate,
)
from pinimpact.app.cli import main
from pinimpact.robot.names import coordinate_names
from pinimpact.tables import check_table_path, write_table

from .scene_models import UP, G, ball

pandas = pytest.importorskip("pandas")
parquet = pytest.importorskip("pyarrow.parquet")

MU, E, FALL, SPEED = 0.2, 0.5, 0.3, 2.0


@pytest.fixture(scope="module")
def landing():
    """Return the trajectory of a ball that bounces until it slides, and then rolls."""
    contact = Contact("center", Plane(), radius=0.1, friction=MU, restitution=E, name="floor")
    return simulate(Scene(ball(), [contact]), [0, 0, 0.1 + FALL, *UP], [SPEED, 0, 0, 0, 0, 0], 2.0)


def test_samples_of_falling_ball(landing):
    frame = landing.to_dataframe()
    hit = np.sqrt(2.0 * FALL / G)
    flight = frame[frame.t < hit]
    assert flight["q.body.z"].to_numpy() == pytest.approx(0.1 + FALL - 0.5 * G * flight.t**2, abs=1e-12)
    assert frame["q.body.qw"].iloc[0] == 1.0
    assert set(flight["floor.mode"]) == {"free"}
    lies = frame[frame["floor.mode"] != "free"]
    assert len(lies) > 3
    mass = 2.0 * (frame.potential.iloc[0] / (0.1 + FALL) / G) / 2.0
    assert lies["floor.force.n"].to_numpy() == pytest.approx(np.full(len(lies), mass * G), rel=1e-9)
    slips = frame[frame["floor.mode"] == "slip"]
    assert np.hypot(slips["floor.force.t1"], slips["floor.force.t2"]).to_numpy() == pytest.approx(
        np.full(len(slips), MU * mass * G), rel=1e-9
    )
    works = [name for name in frame if name.startswith("work.")]
    total = frame.kinetic + frame.potential
    assert (total - total[0]).to_numpy() == pytest.approx(
        (frame[works].sum(axis=1) + frame.residual).to_numpy(), abs=1e-12
    )


def test_impact_has_a_row_before_and_one_after_it(landing):
    frame, table = landing.to_dataframe(), landing.to_dataframe("impacts")
    hit = np.sqrt(2.0 * FALL / G)
    assert table.time[0] == pytest.approx(hit, rel=1e-12)
    assert table.approach[0] == pytest.approx(G * hit, rel=1e-12)
    before, after = frame[frame.t == table.time[0]].index
    assert frame["v.body.vz"][after] == pytest.approx(-E * frame["v.body.vz"][before], rel=1e-12)
    assert frame["floor.mode"][before] == frame["floor.mode"][after] == "free"
    mass = pin.computeTotalMass(ball())
    assert table["impulse.n"][0] == pytest.approx(mass * (1.0 + E) * G * hit, rel=1e-12)
    assert table["work.total"].sum() == pytest.approx(
        sum(0.5 * (i.v_after @ m @ i.v_after - i.v_before @ m @ i.v_before) for i, m in with_mass(landing)),
        abs=1e-12,
    )


def with_mass(trajectory):
    model = ball()
    for one in trajectory.impacts:
        yield one, np.array(pin.crba(model, model.createData(), one.q))


def test_modes_start_at_the_end_of_the_previous_one(landing):
    table = landing.to_dataframe("modes")
    assert list(table.columns) == ["source", "mode", "start", "end"]
    assert list(table["mode"])[-1] == "stick"
    assert table.end.iloc[-1] == landing.t[-1]
    frame = landing.to_dataframe()
    assert frame["floor.mode"].iloc[-1] == "stick"
    for row in table.itertuples():
        inside = frame[(frame.t > row.start) & (frame.t < row.end)]
        assert set(inside[f"{row.source}.mode"]) <= {row.mode}


def test_tables_of_run_without_impacts():
    contact = Contact("center", Plane(), radius=0.1, name="floor")
    run = simulate(Scene(ball(), [contact]), [0, 0, 5.0, *UP], np.zeros(6), 0.01)
    assert len(run.to_dataframe("impacts")) == len(run.to_dataframe("modes")) == 0
    assert "impulse.n" in run.to_dataframe("impacts")


def test_names_of_coordinates_are_in_pinocchios_order():
    model = pin.Model()
    kinds = pin.JointModelFreeFlyer, pin.JointModelSpherical, pin.JointModelPlanar, pin.JointModelRUBX
    for k, kind in enumerate(
        (*kinds, pin.JointModelRX, pin.JointModelTranslation, pin.JointModelSphericalZYX)
    ):
        model.addJoint(k, kind(), pin.SE3.Identity(), kind.__name__[10:])
    q, v = coordinate_names(model)
    assert (len(q), len(v)) == (model.nq, model.nv)
    assert len(set(q)) == len(q)
    assert len(set(v)) == len(v)
    ones = {name for name, value in zip(q, pin.neutral(model), strict=True) if value == 1.0}
    assert ones == {"FreeFlyer.qw", "Spherical.qw", "Planar.cos", "RUBX.cos"}
    assert q[-7] == "RX"
    assert v[model.joints[4].idx_v] == "RUBX"
    # each velocity changes the coordinate of the same axis
    for turning, turned in (
        ("FreeFlyer.wz", "FreeFlyer.qz"),
        ("Spherical.wx", "Spherical.qx"),
        ("Planar.wz", "Planar.sin"),
    ):
        moved = pin.integrate(model, pin.neutral(model), np.eye(model.nv)[v.index(turning)] * 1e-3)
        changed = {name for name, x, y in zip(q, moved, pin.neutral(model), strict=True) if abs(x - y) > 1e-5}
        assert changed == {turned}


def test_files_contain_all_digits(landing, tmp_path):
    columns = landing.columns()
    write_table(tmp_path / "a.csv", columns)
    write_table(tmp_path / "a.parquet", columns)
    with (tmp_path / "a.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == list(columns)
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column_names == head
    for k, (name, column) in enumerate(columns.items()):
        texts = [row[k] for row in rows]
        if column.dtype == object:
            assert texts == column.tolist() == table[name].to_pylist()
        else:
            assert np.array_equal([float(text) for text in texts], column)
            assert np.array_equal(table[name].to_numpy(), column)


def test_samples_of_saved_run(landing, tmp_path):
    landing.save(tmp_path / "run.npz")
    again = Trajectory.load(tmp_path / "run.npz")
    assert again.coordinates == landing.coordinates
    one, other = landing.to_dataframe(), again.to_dataframe()
    assert list(one) == list(other)
    numbers = one.select_dtypes("number").columns
    assert other[numbers].to_numpy() == pytest.approx(one[numbers].to_numpy(), abs=1e-8)


def test_invalid_tables_and_missing_packages_raise(landing, monkeypatch, tmp_path):
    with pytest.raises(UnknownNameError, match="rows: 'forces' is not a table"):
        landing.to_dataframe("forces")
    with pytest.raises(InputError, match=r"output: .*ends in \.csv or \.parquet"):
        check_table_path("output", tmp_path / "a.xlsx")
    with pytest.raises(InputError, match="output: there is no folder"):
        check_table_path("output", tmp_path / "missing" / "a.csv")
    monkeypatch.setitem(sys.modules, "pandas", None)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pandas is not installed; pip install 'pinimpact\[data\]'"):
        landing.to_dataframe()
    with pytest.raises(InputError, match="pyarrow is not installed"):
        check_table_path("output", tmp_path / "a.parquet")


def test_hits_as_columns():
    robot = load_robot("panda")
    model, data = robot.model, robot.data
    q = np.array([0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02])
    v = np.random.default_rng(7).normal(size=(40, 9))
    contact = Contact("panda_hand_tcp", Plane(normal=(0.3, -0.2, 1.0)), friction=0.4, restitution=0.5)
    hits = impacts(model, data, q, v, contact, law="energetic")
    frame = hits.to_dataframe()
    mass = np.array(pin.crba(model, data, q))
    for k in range(40):
        one = impact(model, data, q, v[k], replace(contact, law="energetic"))
        assert hits.v[k] == pytest.approx(one.v, abs=1e-12)
        assert hits.impulse[k] == pytest.approx(one.solution.impulse, abs=1e-12)
        assert frame["work.total"][k] == pytest.approx(
            0.5 * (one.v @ mass @ one.v - v[k] @ mass @ v[k]), abs=1e-10
        )
        assert frame["v.panda_joint2"][k] == hits.v[k, 1]
        assert frame["status"][k] == one.solution.status.name
    assert np.linalg.norm(hits.impulse, axis=1) == pytest.approx(np.linalg.norm(hits.impulse_world, axis=1))
    newton = impacts(model, data, q, v, contact, law="newton")
    struck = newton.impulse[:, 2] > 0.0
    assert not np.allclose(newton.impulse[struck], hits.impulse[struck], rtol=1e-3)
    with pytest.raises(UnknownNameError, match="law: 'hertz'"):
        impacts(model, data, q, v, contact, law="hertz")


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_command_line_writes_tables(tmp_path, suffix):
    from pinimpact.app.scene_file import bundled_scenes

    file = tmp_path / f"motion.{suffix}"
    scene = sorted(bundled_scenes())[0]
    call = ["run", scene, "-o", str(tmp_path / "out"), "--output", str(file), "-q"]
    done = CliRunner().invoke(main, call)
    assert done.exit_code == 0, done.output
    read = pandas.read_csv if suffix == "csv" else pandas.read_parquet
    run = Trajectory.load(tmp_path / "out" / "trajectory.npz")
    assert read(file)["t"].to_numpy() == pytest.approx(run.t, abs=1e-12)
    assert len(read(tmp_path / f"motion-impacts.{suffix}")) == len(run.impacts)
    again = CliRunner().invoke(main, [*call[:2], "-o", str(tmp_path / "out2"), "--output", str(file)])
    assert again.exit_code == 1
    assert "already exist" in again.output
    assert not (tmp_path / "out2").exists()
