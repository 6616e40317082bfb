"""Identification of friction and restitution from measured impacts."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import pinimpact
from pinimpact import Contact, InputError, Plane, Scene, UnknownNameError, load_robot, solve_impacts, studies

CUBES = Path(__file__).parents[2] / "shared" / "data" / "cube_tosses" / "impacts.npz"


def random_bodies(count: int, rng: np.random.Generator):
    """Return W and v⁻ of random impacts at corners of bodies of unit mass."""
    arms = rng.normal(size=(count, 3, 3)) * [[[1.2], [1.2], [0.6]]]
    delassus = np.eye(3) + arms @ np.swapaxes(arms, 1, 2)
    velocity = rng.normal(size=(count, 3))
    velocity[:, 2] = -rng.uniform(0.5, 2.0, count)
    return delassus, velocity


def cube_scene(d):
    """Return a scene of the tossed cube with unit mass, in the length unit of the data."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "cube")
    model.appendBodyToJoint(
        joint, pin.Inertia(1.0, np.zeros(3), d["inertia_over_mass_body"]), pin.SE3.Identity()
    )
    model.addBodyFrame("cube", joint, pin.SE3.Identity(), 0)
    rotation = Rotation.from_quat(d["quaternion_wxyz"], scalar_first=True)
    radii = np.linalg.norm(
        d["contact_from_com"] - rotation.apply(d["corner_sphere_centres_from_com"][d["corner"]]), axis=1
    )
    contacts = []
    for i, centre in enumerate(d["corner_sphere_centres_from_com"]):
        of_corner = radii[d["corner"] == i]
        contacts.append(Contact("cube", Plane(), offset=centre, radius=of_corner.mean(), name=f"corner {i}"))
    return Scene(model, contacts)


def cube_states(d):
    """Return q, v⁻, v⁺ of the cube's impacts."""
    rotation = Rotation.from_quat(d["quaternion_wxyz"], scalar_first=True)
    q = np.hstack([d["com"], rotation.as_quat()])
    back = rotation.inv()
    states = [np.hstack([back.apply(d[f"v_{s}"]), back.apply(d[f"w_{s}"])]) for s in ("before", "after")]
    return q, *states


@pytest.fixture(scope="module")
def cubes():
    if not CUBES.is_file():
        pytest.skip(f"the recorded tosses are not in {CUBES.parent}")
    return dict(np.load(CUBES))


@pytest.mark.parametrize("law", pinimpact.LAWS)
@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_fit_of_exact_impacts(law: str, loss: str) -> None:
    W, before = random_bodies(40, np.random.default_rng(1))
    after = solve_impacts(W, before, 0.21, 0.43, law=law).velocity
    fit = studies.identify((W, before, after), law=law, loss=loss)
    assert fit.x == pytest.approx([0.21, 0.43], abs=1e-7)
    assert fit.unidentified == ()
    assert fit.interval(0.99).ravel() == pytest.approx([0.21, 0.21, 0.43, 0.43], abs=1e-6)


def test_fit_of_exact_impacts_at_the_bounds() -> None:
    W, before = random_bodies(40, np.random.default_rng(1))
    for truth in ((0.0, 0.0), (0.0, 0.43), (0.21, 0.0), (0.21, 1.0)):
        fit = studies.identify((W, before, solve_impacts(W, before, *truth).velocity))
        assert fit.x == pytest.approx(truth, abs=1e-7)
        assert fit.unidentified == ()


@pytest.mark.parametrize(
    ("truth", "free", "named"),
    [
        ((3.0, 0.5), {"friction": (0, 2), "restitution": (0, 1)}, ["friction is not .* its bound 2 fit"]),
        ((0.3, 0.5), {"friction": (0.4, 2), "restitution": (0, 1)}, ["friction is not .* its bound 0.4 fit"]),
        ((0.3, 0.9), {"friction": (0, 2), "restitution": (0, 0.8)}, ["restitution is not .* bound 0.8 fit"]),
        ((0.0, 0.5), None, []),
        ((0.3, 0.0), None, []),
        ((0.3, 1.0), None, []),
    ],
)
def test_coefficients_beyond_the_bounds_are_named(truth, free, named) -> None:
    """Zero friction, and a restitution of zero or one, are no bounds of the search."""
    rng = np.random.default_rng(5)
    W, before = random_bodies(60, rng)
    before[:, :2] *= 20.0
    after = solve_impacts(W, before, *truth).velocity + 0.01 * rng.normal(size=(60, 3))
    found = studies.identify((W, before, after), free=free).unidentified
    assert len(found) == len(named)
    assert all(re.match(pattern, sentence) for pattern, sentence in zip(named, found, strict=True))


@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
@pytest.mark.parametrize(("beyond", "named"), [(0.0, False), (1e-5, True)])
def test_exact_coefficients_at_a_bound_are_not_beyond_it(beyond, named, loss) -> None:
    """The unbounded fit of exact impacts ends at the true values, within rounding errors."""
    for seed in range(4):
        W, before = random_bodies(60, np.random.default_rng(seed))
        before[:, :2] *= 20.0
        for bounded, mu, e in (("friction", 2.0 + beyond, 0.5), ("restitution", 0.3, 0.8 + beyond)):
            free = {"friction": (0, 2), "restitution": (0, 0.8)}
            fit = studies.identify(
                (W, before, solve_impacts(W, before, mu, e).velocity), free=free, loss=loss
            )
            assert [sentence.partition(" ")[0] for sentence in fit.unidentified] == [bounded] * named


def test_coefficients_of_single_contacts_of_a_robot() -> None:
    robot = load_robot("solo12")
    rng = np.random.default_rng(2)
    truth = {"FL_FOOT": (0.15, 0.2), "FR_FOOT": (0.3, 0.2)}
    feet = [Contact(foot, Plane(), *pair, name=foot) for foot, pair in truth.items()]
    q = np.array([pin.integrate(robot.model, robot.q0, 0.1 * rng.normal(size=18)) for _ in range(30)])
    v = rng.normal(size=(30, 18))
    v[:, 2] -= 3.0
    after, names = np.empty_like(v), np.array(["FL_FOOT", "FR_FOOT"] * 15)
    for i in range(30):
        after[i] = pinimpact.impact(robot.model, robot.data, q[i], v[i], feet[i % 2]).v
    scene = Scene(robot, [Contact(foot, Plane(), 0.9, 0.2, name=foot) for foot in truth])
    free = {"friction": (0, 1), "friction:FR_FOOT": (0, 1)}
    noise = 1e-4 * np.eye(18)
    for covariance in (None, noise):
        fit = studies.identify((q, v, after), scene, free, contact=names, covariance=covariance)
        assert fit.names == ("friction", "friction:FR_FOOT")
        assert fit.x == pytest.approx([0.15, 0.3], abs=1e-6)
    fitted = fit.apply(scene)
    assert [one.friction for one in fitted.contacts] == pytest.approx([0.15, 0.3], abs=1e-6)
    assert [one.restitution for one in fitted.contacts] == [0.2, 0.2]


def tosses(rng: np.random.Generator, groups: int = 60, each: int = 3):
    """Return noisy impacts of tosses, whose friction varies from toss to toss, and the index of the toss."""
    group = np.repeat(np.arange(groups), each)
    W, before = random_bodies(len(group), rng)
    before[:, :2] += np.sign(before[:, :2])  # fast slip
    mu = 0.16 + 0.011 * rng.normal(size=groups)[group]
    after = solve_impacts(W, before, mu, 0.27).velocity + 0.002 * rng.normal(size=(len(group), 3))
    return (W, before, after), group


@pytest.mark.slow
def test_standard_errors_agree_with_scatter_of_estimates() -> None:
    rng = np.random.default_rng(3)
    fits, naive = [], []
    for k in range(60):
        found, group = tosses(rng)
        fits.append(studies.identify(found, group=group))
        if k < 20:  # enough for a mean of standard errors
            naive.append(studies.identify(found).standard_errors)
    scatter = np.std([fit.x for fit in fits], axis=0)
    # a standard deviation of 60 numbers has a standard error of 9 %
    assert np.mean([fit.standard_errors for fit in fits], axis=0) == pytest.approx(scatter, rel=0.27)
    assert np.mean(naive, axis=0)[0] < 0.8 * scatter[0]  # impacts of a toss are not independent
    inside = [(fit.interval()[:, 0] <= (0.16, 0.27)) & (fit.interval()[:, 1] >= (0.16, 0.27)) for fit in fits]
    assert np.all(np.sum(inside, axis=0) >= 52)  # fewer have a probability of 0.3 % for intervals of 95 %


def test_outlier_has_less_weight_with_soft_loss() -> None:
    W, before = random_bodies(60, np.random.default_rng(4))
    after = solve_impacts(W, before, 0.2, 0.4).velocity
    after += 0.001 * np.random.default_rng(5).normal(size=after.shape)
    after[7] += [2.0, 0.0, 3.0]
    error = {
        loss: np.abs(studies.identify((W, before, after), loss=loss).x - [0.2, 0.4]).max()
        for loss in ("linear", "soft_l1")
    }
    assert error["soft_l1"] < 0.1 * error["linear"]


@pytest.mark.parametrize("sideways", [0.0, 1e-16, 1e-9, 0.005])
def test_components_without_errors_do_not_set_the_scale_of_the_loss(sideways: float) -> None:
    """A ball falls vertically 30 times with e = 0.5, and one rebound is recorded with the wrong sign."""
    rng = np.random.default_rng(0)
    before, after = np.zeros((2, 30, 3))
    before[:, 2], after[:, 2] = -2.0, 1.0 + 0.005 * rng.normal(size=30)
    after[:, :2] = sideways * rng.normal(size=(30, 2))
    after[0, 2] = -1.5
    fit = studies.identify(
        (np.tile(np.eye(3), (30, 1, 1)), before, after), free={"restitution": (0, 1)}, fixed={"friction": 0.3}
    )
    mean = (after[:, 2] / 2.0).mean()  # result of least squares, with the error due to the outlier
    assert abs(fit.x[0] - 0.5) < 0.1 * abs(mean - 0.5)
    low, high = fit.interval()[0]
    assert low < 0.5 < high
    assert high - low < 0.02
    assert not fit.unidentified


def test_fit_with_zero_median_of_residuals_is_least_squares() -> None:
    """More than half of the impacts are exact; e is the mean, with the jackknife standard error."""
    before, after = np.zeros((2, 10, 3))
    before[:, 2], after[:, 2] = -2.0, 1.0
    after[:2, 2] = 1.5, 0.5
    fit = studies.identify(
        (np.tile(np.eye(3), (10, 1, 1)), before, after), free={"restitution": (0, 1)}, fixed={"friction": 0.3}
    )
    e = after[:, 2] / 2.0
    without = (e.sum() - e) / 9.0
    assert fit.x == pytest.approx(0.5, abs=1e-12)
    assert fit.standard_errors == pytest.approx(np.sqrt(0.9 * np.sum((without - 0.5) ** 2)), rel=1e-9)


def test_friction_is_not_determined_if_all_impacts_stick() -> None:
    W, before = random_bodies(30, np.random.default_rng(6))
    before[:, :2] *= 0.01
    W[:] = np.diag([3.0, 3.0, 1.0])
    after = solve_impacts(W, before, 1.0, 0.4).velocity
    after += 0.001 * np.random.default_rng(7).normal(size=after.shape)
    fit = studies.identify((W, before, after))
    assert len(fit.unidentified) == 1
    assert fit.unidentified[0].startswith("friction is not determined: all impacts end sticking")
    assert fit.interval()[0] == pytest.approx([0.0, 2.0])
    assert fit.x[1] == pytest.approx(0.4, abs=0.01)
    assert "all impacts end sticking" in repr(fit)


@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
@pytest.mark.parametrize("towards", [-2.0, 2.0])
def test_friction_is_not_determined_if_no_residual_depends_on_it(towards: float, loss: str) -> None:
    """W is the identity, and the body sticks or separates, so v⁺ does not depend on friction."""
    before = np.tile([0.1, 0.0, towards], (20, 1))
    after = np.tile([0.0, 0.0, 1.0], (20, 1)) if towards < 0.0 else before.copy()
    after += 0.01 * np.random.default_rng(0).normal(size=after.shape)
    given = np.tile(np.eye(3), (20, 1, 1)), before, after
    fit = studies.identify(given, free={"friction": (0, 2)}, fixed={"restitution": 0.5}, loss=loss)
    assert "friction is not determined" in fit.unidentified[0]
    assert fit.interval().tolist() == [[0.0, 2.0]]


def test_fit_does_not_end_where_all_impacts_stick() -> None:
    # if most of few impacts stick, the best initial point may have so much friction that all stick
    rng = np.random.default_rng(1)
    arms = rng.normal(size=(400, 3, 3))
    W, before = np.eye(3) + arms @ arms.transpose(0, 2, 1), rng.normal(size=(400, 3)) - [0, 0, 3]
    for seed in (1, 4, 17, 69, 97):
        rng = np.random.default_rng(seed)
        mu, e = rng.uniform(0.0, 0.6), rng.uniform(0.0, 1.0)
        some = rng.permutation(400)[:2]
        after = solve_impacts(W[some], before[some], mu, e).velocity
        fit = studies.identify((W[some], before[some], after))
        assert fit.x == pytest.approx([mu, e], abs=1e-5)


def test_restitution_is_not_determined_by_grazing_impacts() -> None:
    rng = np.random.default_rng(8)
    W, before = random_bodies(30, rng)
    before[:, 2] *= 1e-3
    after = solve_impacts(W, before, 0.1, 0.4).velocity + 0.05 * rng.normal(size=(30, 3))
    fit = studies.identify((W, before, after), fixed={"friction": 0.1}, free={"restitution": (0, 1)})
    assert "the median approach speed is 0.0014 m/s" in fit.unidentified[0]


def test_contact_without_impacts_is_named() -> None:
    robot = load_robot("solo12")
    scene = Scene(robot, [Contact(foot, Plane(), 0.5, name=foot) for foot in ("FL_FOOT", "FR_FOOT")])
    v = np.zeros((3, 18))
    v[:, 2] = -1.0
    q = np.tile(robot.q0, (3, 1))
    free = {"restitution:FL_FOOT": (0, 1), "friction:FR_FOOT": (0, 1)}
    fit = studies.identify((q, v, v * 0.9), scene, free, contact="FL_FOOT")
    assert fit.unidentified[-1] == "friction:FR_FOOT is not determined: no impact is of this contact."


def test_covariance_is_that_of_the_jackknife_over_groups() -> None:
    """Compare with fits that leave out one group; equal to first order, as the cost is nearly quadratic."""
    found, group = tosses(np.random.default_rng(12), groups=12)
    fit = studies.identify(found, group=group, loss="linear")
    left_out = []
    for k in range(12):
        kept = group != k
        left_out.append(studies.identify([x[kept] for x in found], group=group[kept], loss="linear").x)
    error = np.array(left_out) - fit.x
    size = np.outer(fit.standard_errors, fit.standard_errors)
    assert fit.covariance / size == pytest.approx(11 / 12 * error.T @ error / size, abs=0.05)


def test_groups_of_unequal_weight_have_fewer_degrees_of_freedom() -> None:
    """Compare with Satterthwaite's formula for a mean over groups of sizes n_g, a_g = n_g/(n − n_g)²."""
    W = np.tile(np.eye(3), (45, 1, 1))
    before = np.tile([0.0, 0.0, -1.0], (45, 1))  # v⁺ = e, so the fit is a mean
    after = np.zeros((45, 3))
    after[:, 2] = 0.5 + 0.01 * np.random.default_rng(14).normal(size=45)
    sizes = np.array([1, 2, 3, 4, 5, 6, 7, 8, 9])
    options = {"free": {"restitution": (0, 1)}, "fixed": {"friction": 0.2}, "loss": "linear"}
    fit = studies.identify((W, before, after), group=np.repeat(np.arange(9), sizes), **options)
    weights = sizes / (45 - sizes) ** 2
    assert fit.degrees == pytest.approx([weights.sum() ** 2 / (weights**2).sum()])
    even = studies.identify((W, before, after), group=np.repeat(np.arange(9), 5), **options)
    assert even.degrees == pytest.approx([8.0])
    low, high = even.interval(0.9)[0]
    assert high - low == pytest.approx(2.0 * 1.8595480375228421 * even.standard_errors[0])  # t of 8


def test_parameter_of_one_group_has_no_interval() -> None:
    robot = load_robot("solo12")
    feet = [Contact(foot, Plane(), 0.1, 0.5, name=foot) for foot in ("FL_FOOT", "FR_FOOT")]
    rng = np.random.default_rng(13)
    v = rng.normal(size=(8, 18))
    v[:, 2] = -4.0
    q, names = np.tile(robot.q0, (8, 1)), np.array(["FL_FOOT"] * 6 + ["FR_FOOT"] * 2)
    after = [
        pinimpact.impact(robot.model, robot.data, q[i], v[i], feet[i // 6]).v + 0.01 * rng.normal(size=18)
        for i in range(8)
    ]
    free = {"restitution:FL_FOOT": (0, 1), "restitution:FR_FOOT": (0, 1)}
    group = [0, 0, 1, 1, 2, 2, 3, 3]
    fit = studies.identify((q, v, np.array(after)), Scene(robot, feet), free, contact=names, group=group)
    assert fit.unidentified == ("restitution:FR_FOOT has no interval: only one group determines it.",)
    assert fit.interval()[1] == pytest.approx([0.0, 1.0])
    assert 0.0 < fit.standard_errors[0] < 0.1


def test_apply_sets_law_of_fit() -> None:
    W, before = random_bodies(20, np.random.default_rng(9))
    after = solve_impacts(W, before, 0.2, 0.4, law="newton").velocity
    fit = studies.identify((W, before, after), law="newton")
    scene = fit.apply(Scene(load_robot("panda"), [Contact("panda_hand_tcp", Plane())]))
    (contact,) = scene.contacts
    assert (contact.law, contact.friction) == ("newton", pytest.approx(0.2, abs=1e-6))


@pytest.mark.parametrize("copies", [2, 3])
def test_copies_of_the_data_are_the_same_groups(copies) -> None:
    """Copies of all groups, under other labels and in another order, change neither fit nor interval."""
    found, group = tosses(np.random.default_rng(16), groups=12)
    fit = studies.identify(found, group=group)
    order = np.random.default_rng(17).permutation(copies * len(group))
    repeated = [np.concatenate([column] * copies)[order] for column in found]
    labels = np.concatenate([group + 100 * k for k in range(copies)])[order]
    again = studies.identify(repeated, group=labels)
    assert again.groups == 12
    assert again.interval() == pytest.approx(fit.interval(), abs=1e-6)
    newton = studies.identify(repeated, group=labels, law="newton")
    assert studies.compare(newton, again).groups == 12


def test_one_impact_in_two_groups_has_no_interval() -> None:
    W, before = random_bodies(1, np.random.default_rng(18))
    after = solve_impacts(W, before, 0.3, 0.5).velocity + 0.01
    given = [np.concatenate([column, column]) for column in (W, before, after)]
    fit = studies.identify(given, free={"restitution": (0, 1)}, fixed={"friction": 0.3})
    assert fit.unidentified == ("restitution has no interval: only one group determines it.",)
    assert fit.interval().tolist() == [[0.0, 1.0]]
    assert fit.groups == 1


def test_figure_has_axes_for_each_parameter() -> None:
    W, before = random_bodies(20, np.random.default_rng(10))
    after = solve_impacts(W, before, 0.2, 0.4).velocity
    figure = studies.identify((W, before, after + 1e-3)).plot()
    assert [axes.get_xlabel().split(" = ")[0] for axes in figure.axes[:2]] == ["friction", "restitution"]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"free": {}}, InputError, "free: {} given; bounds by name"),
        ({"free": {"frction": (0, 1)}}, UnknownNameError, "did you mean 'friction'"),
        ({"free": {"friction:foot": (0, 1)}}, UnknownNameError, "'foot' is not a contact of the scene"),
        ({"free": {"restitution": (0, 2)}}, InputError, "two rising numbers from 0 to 1"),
        ({"free": {"friction": (0, 1)}}, InputError, "restitution is neither free nor fixed"),
        ({"loss": "hubber"}, UnknownNameError, "loss: 'hubber' is not a loss"),
        ({"law": "kane"}, UnknownNameError, "is not a restitution law"),
        ({"group": [1, 2]}, InputError, r"group: \[1, 2\] given; 5 labels, one for each row"),
        ({"group": [1, 2, 3, 4, float("nan")]}, InputError, "group: NaN given as a label"),
        ({"group": np.full(5, np.nan)}, InputError, "group: NaN given as a label"),
        ({"group": [1] * 5}, InputError, "5 rows in 1 group; intervals that are robust to groups need two"),
        ({"found": (np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros((0, 3)))}, InputError, "0 rows in 0 gr"),
        ({"free": {"restitution": (0, 1)}, "fixed": {"friction": "a"}}, InputError, "friction: 'a' given"),
        ({"free": {"restitution": (0, 1)}, "fixed": {"friction": -1}}, InputError, "friction: -1.0 is neg"),
        ({"covariance": -np.eye(3)}, InputError, "covariance: a matrix is not a covariance"),
        ({"covariance": [[1, 2, 0], [0, 1, 0], [0, 0, 1]]}, InputError, "is not a covariance"),
        ({"found": np.zeros((5, 3))}, InputError, r"\(delassus, v_before, v_after\)"),
        ({"found": (np.zeros((5, 3, 3)), np.zeros((5, 3)), np.zeros((4, 3)))}, InputError, "shapes"),
        ({"found": (np.zeros((5, 3, 3)), -np.ones((5, 3)), np.ones((5, 3)))}, InputError, "impact 0 has no"),
        ({"found": (np.zeros((5, 6)), np.zeros((5, 6)), np.zeros((5, 6)))}, InputError, "give the scene"),
    ],
)
def test_bad_input_is_named(change: dict, error: type, message: str) -> None:
    W, before = random_bodies(5, np.random.default_rng(11))
    with pytest.raises(error, match=message):
        studies.identify(**({"found": (W, before, before)} | change))


def test_rows_without_approach_determine_nothing() -> None:
    W, before = random_bodies(5, np.random.default_rng(12))
    before[:, 2] = np.abs(before[:, 2])
    reasons = studies.identify((W, before, before)).unidentified
    assert len(reasons) == 2
    assert all("approaches in no row" in reason for reason in reasons)


def test_missing_or_unknown_contact_raises() -> None:
    robot = load_robot("solo12")
    scene = Scene(robot, [Contact(foot, Plane(), name=foot) for foot in ("FL_FOOT", "FR_FOOT")])
    found = np.tile(robot.q0, (2, 1)), np.zeros((2, 18)), np.zeros((2, 18))
    with pytest.raises(InputError, match="contact: the scene has 2 contacts; give the name"):
        studies.identify(found, scene)
    with pytest.raises(UnknownNameError, match="contact: 'foot' is not a contact of the scene"):
        studies.identify(found, scene, contact="foot")


def test_recorded_cubes(cubes) -> None:
    """Compare with published results for these data by an independent fit with the same law."""
    fit = studies.identify(
        cube_states(cubes), cube_scene(cubes), contact=names_of(cubes), group=cubes["toss"]
    )
    assert fit.x == pytest.approx([0.1606, 0.2696], abs=3e-4)
    assert fit.standard_errors == pytest.approx([0.0011, 0.0010], abs=1e-4)
    assert fit.unidentified == ()


def names_of(d):
    return np.array([f"corner {i}" for i in d["corner"]])


def cross_validated(d) -> float:
    """Return the root mean square error [m/s] of tenfold cross-validation over tosses."""
    scene, names, toss = cube_scene(d), names_of(d), d["toss"]
    q, before, after = cube_states(d)
    labels = np.unique(toss)
    fold = np.random.default_rng(0).permutation(len(labels))[np.searchsorted(labels, toss)] % 10
    squares, model = np.zeros(len(q)), scene.model
    inertia = np.array(model.inertias[1].inertia)
    for k in range(10):
        fitted = fold != k
        found = q[fitted], before[fitted], after[fitted]
        fit = studies.identify(found, scene, contact=names[fitted], group=toss[fitted])
        contacts = {one.label: one for one in fit.apply(scene).contacts}
        for i in np.flatnonzero(~fitted):
            hit = pinimpact.impact(model, model.createData(), q[i], before[i], contacts[names[i]])
            error = hit.v - after[i]
            squares[i] = error[:3] @ error[:3] + error[3:] @ inertia @ error[3:]
    return float(np.sqrt(squares.mean()))


def test_cross_validation_of_recorded_cubes(cubes) -> None:
    assert cross_validated(cubes) <= 0.0430


def test_paired_fits_belong_to_the_same_impacts_with_the_same_weights() -> None:
    rng = np.random.default_rng(15)
    W, before = random_bodies(30, rng)
    after = solve_impacts(W, before, 0.3, 0.5).velocity + 0.05 * rng.normal(size=(30, 3))
    fit = studies.identify((W, before, after))
    newton = studies.identify((W.copy(), before.copy(), after.copy()), law="newton")
    assert studies.compare(fit, newton).groups == 30
    turned = np.roll(np.arange(30), 1)
    others = {
        "velocities": (W, before, after + 1e-6),
        "masses": (0.01 * W, before, after),
        "order": (W[turned], before[turned], after[turned]),
    }
    for found in others.values():
        other = studies.identify(found)
        with pytest.raises(InputError, match="other: its errors belong to data other than those of test"):
            studies.compare(fit, other)
        assert studies.compare(fit, other, paired=False).groups == 30
    whitened = studies.identify((W, before, after), covariance=0.05**2 * np.eye(3))
    for paired in (True, False):
        with pytest.raises(
            InputError, match=r"errors are those of impacts by covariance, .* by energy: their"
        ):
            studies.compare(fit, whitened, paired)


def test_fit_without_effects_that_the_scene_switches_off() -> None:
    """The impacts are without friction and locked joints; the scene has both, but switches them off."""
    robot = load_robot("solo12")
    rng = np.random.default_rng(4)
    smooth = Contact("FL_FOOT", Plane(), 0.0, 0.4)
    q = np.array([pin.integrate(robot.model, robot.q0, 0.1 * rng.normal(size=18)) for _ in range(20)])
    v = rng.normal(size=(20, 18))
    v[:, 2] -= 3.0
    after = np.array(
        [pinimpact.impact(robot.model, robot.data, *now, smooth).v for now in zip(q, v, strict=True)]
    )
    rough = Scene(robot, [Contact("FL_FOOT", Plane(), 0.3, 0.9)], locked=("FL_KFE",))
    free = {"restitution": (0.0, 1.0)}
    without = ("contact friction", "locked joints")
    weights = {"covariance": np.eye(18)}
    plain = studies.identify((q, v, after), replace(rough, without=without), free, **weights)
    assert plain.x == pytest.approx([0.4], abs=1e-9)
    for some in ((), without[:1], without[1:]):
        fit = studies.identify((q, v, after), replace(rough, without=some), free, **weights)
        assert studies.compare(fit, plain).interval[0, 0] > 0.1
    by_energy = [
        studies.identify((q, v, after), replace(rough, without=some), free) for some in (without, without[:1])
    ]
    with pytest.raises(InputError, match=r"give .* fits of different scenes the same covariance="):
        studies.compare(*by_energy)  # locked joints change the energy of a velocity
    with pytest.raises(InputError, match="free: friction is free, but the scene is without contact friction"):
        studies.identify((q, v, after), replace(rough, without=without))
    with pytest.raises(InputError, match="free: restitution is free, but the scene is without restitution"):
        studies.identify((q, v, after), replace(rough, without=("restitution",)), free)
