"""Examples of the paper by URDF models: reference solutions, closed forms, first order of "euler"."""

import numpy as np
import pytest
from numpy import cos, pi, sin, sqrt, tan

import pinimpact

THETA = 0.46
ROD_MU_C = tan(THETA) / (sqrt(3) / 2)  # (37): the slip starts at 60° from x
ROD_MU_ST = 3 * sin(THETA) * cos(THETA) / (1 + 3 * sin(THETA) ** 2)  # (38)

ROD_Q = np.array([0, 0, 0, 0, THETA])
PENDULUM_Q = np.array([0, pi / 4])

PROBLEMS = {
    "A": ("ellipsoid", (5 / sqrt(2), 5 / sqrt(2), -1)),
    "B": ("ellipsoid", (0.5, 0.5, -1)),
    "right": ("rod", (0.2, 0.2 * sqrt(3), -2)),
    "left": ("rod", (-0.2, 0.2 * sqrt(3), -2)),
    "pendulum": ("pendulum", (-sqrt(2) / 2, sqrt(2) / 2, -sqrt(2) / 2)),
}
FRICTION = {"μc/2": 0.5 * ROD_MU_C, "μc": ROD_MU_C, "2μc": 2 * ROD_MU_C, "√2": sqrt(2)}
# errata.md: problem, μ, velocity after, impulse, compression impulse, where v_t vanishes, what follows
TABLE = """
A 0.2 3.101327636013 2.811040684094 0.5 -0.217103134960 -0.206998063383 1.5 1.0 - -
A 0.5 2.408690591528 1.806240282332 0.5 -0.563421657202 -0.494083892457 1.5 1.0 - -
A 1.0 1.120678302242 0.473424175271 0.5 -1.207427801845 -0.874888494475 1.5 1.0 - -
B 0.2 0 0 0.5 -0.25 -0.142857142857 1.5 1.0 1.4706508132 stick
B 0.5 0 0 0.5 -0.25 -0.142857142857 1.5 1.0 0.5882603253 stick
B 1.0 0 0 0.5 -0.25 -0.142857142857 1.5 1.0 0.2941301626 stick
right 0.0 0.2 -0.913956148535 1.6 0 0 1.056111734238 0.586728741244 - -
left 0.0 -0.2 -0.913956148535 1.6 0 0 1.056111734238 0.586728741244 - -
right μc/2 0.000053890958 -0.644087046198 1.489726502270 -0.049986527261 0.197077577115 1.092758624164 0.607088124536 - -
left μc/2 -0.000053890958 -0.644087046198 1.489726502270 0.049986527261 0.197077577115 1.092758624164 0.607088124536 - -
right μc 0 -0.282699372217 1.421846459886 -0.05 0.484793797943 1.173574991471 0.651986106373 0.1747961561 slip
left μc 0 -0.282699372217 1.421846459886 0.05 0.484793797943 1.173574991471 0.651986106373 0.1747961561 slip
right 2μc 0 0 1.392162592350 -0.05 0.716849072400 1.246109760686 0.692283200381 0.1204374413 stick
left 2μc 0 0 1.392162592350 0.05 0.716849072400 1.246109760686 0.692283200381 0.1204374413 stick
right 0.7 0 -0.084710897502 1.399723074561 -0.05 0.646915597474 1.223843904641 0.679913280356 0.1584802017 slip
left 0.7 0 -0.084710897502 1.399723074561 0.05 0.646915597474 1.223843904641 0.679913280356 0.1584802017 slip
pendulum 0.0 0.565685424949 0.707106781187 0.565685424949 0 0 0.848528137424 0.471404520791 - -
pendulum 0.5 0.278869522355 0.022468774391 0.278869522355 -0.021184943200 -0.228212668932 0.678502478894 0.376945821608 - -
pendulum 0.9 0.051127829836 0.000000000018 0.051127829836 -0.048669447543 -0.235702260390 0.554159188225 0.307866215681 - -
pendulum 1.2 0 0 0 -0.001114124874 -0.235702260396 0.472518645665 0.262510358703 0.2663820138 stick
pendulum √2 0 0 0 0.047140452079 -0.235702260396 0.424264068712 0.235702260396 0.2357022604 stick
pendulum 2.0 0 0 0 0.136568080003 -0.235702260396 0.334836440788 0.186020244882 0.1860202449 stick
"""  # noqa: E501


def row_of(line):
    """Return problem, μ, v⁺, P, compression impulse, P₃ at the end of slip or None, and the mode after it."""
    name, mu, *numbers, compression, vanishes, then = line.split()
    vectors = np.array(numbers, dtype=float).reshape(2, 3)
    stop = None if vanishes == "-" else float(vanishes)
    return PROBLEMS[name], float(FRICTION.get(mu, mu)), *vectors, float(compression), stop, then


REFERENCE = [row_of(line) for line in TABLE.split("\n") if line]
RESTITUTION = {"ellipsoid": 0.5, "rod": 0.8, "pendulum": 0.8}


def from_urdf(problem, mu, **options):
    """Return the impact of a bundled model whose tip has the velocity of the paper."""
    body, (x, y, z) = problem
    if body == "ellipsoid":
        robot, q, v = pinimpact.load_robot("ellipsoid"), None, np.array([x, y, z, 0, 0, 0])
    elif body == "rod":
        robot, q, v = pinimpact.load_robot("rod"), ROD_Q, np.array([x, y, z, 0, 0])
    else:
        robot, q, v = pinimpact.load_robot("spherical_pendulum"), PENDULUM_Q, np.array([y * sqrt(2), 1.0])
    q = robot.q0 if q is None else q
    contact = pinimpact.Contact("tip", pinimpact.Plane(), friction=mu, restitution=RESTITUTION[body])
    return pinimpact.impact(robot.model, robot.data, q, v, contact, **options)


def row_name(row):
    return f"{row[0][0]} {row[0][1][0]:+.1f} μ={row[1]:.3f}"


@pytest.mark.parametrize("row", REFERENCE, ids=row_name)
def test_reference_solutions(row):
    problem, mu, velocity, impulse, compression, vanishes, then = row
    solution = from_urdf(problem, mu).solution
    assert np.abs(solution.velocity - velocity).max() < 2e-12
    assert np.abs(solution.impulse - impulse).max() < 2e-12
    assert solution.compression_impulse == pytest.approx(compression, abs=2e-12)
    ends = [segment.end for segment in solution.segments if segment.phase == "compression"]
    assert ends[-1] == pytest.approx(compression, abs=2e-12)
    if vanishes is not None:
        path = from_urdf(problem, mu, record=True).solution.path
        at_rest = np.hypot(*path.velocity[:, :2].T) < 1e-12
        assert path.normal_impulse[at_rest][0] == pytest.approx(vanishes, abs=6e-11)
        flag = pinimpact.Flag.STICK if then == "stick" else pinimpact.Flag.SLIP_RESUMED
        assert flag in solution.flags


@pytest.mark.parametrize("row", [row for row in REFERENCE if row[1] > 0.0], ids=row_name)
def test_euler_is_of_first_order_for_reference_solutions(row):
    problem, mu, velocity, impulse, _, vanishes, _ = row
    exact = np.array([*velocity, *impulse])

    def error(steps):
        solution = from_urdf(problem, mu, method="euler", steps=steps).solution
        return np.abs([*solution.velocity, *solution.impulse] - exact).max()

    steps = np.array([200, 400, 800, 1600, 3200])
    errors = np.array([error(n) for n in steps])
    assert errors[-1] < 2e-4
    if vanishes is None:
        assert -np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(1, abs=0.02)
    elif errors.max() > 1e-9:  # else slip is straight, and steps have no error
        scaled = errors * steps  # depends on where in a step slip stops
        assert scaled.max() < 6 * scaled.min()


@pytest.mark.parametrize("mu", [0.1, 0.3, 0.9])
def test_ellipsoid_follows_equations_32_and_33(mu):
    path = from_urdf(PROBLEMS["A"], mu, record=True).solution.path
    v1, v2, v3 = path.velocity.T
    start = 5 / sqrt(2)
    assert len(v1) > 5
    assert np.abs(v2 - start * (v1 / start) ** (7 / 4)).max() < 1e-12  # (32)
    assert v3[-1] == pytest.approx(0.5, abs=1e-14)  # (33), corrected: −e v₃ᵒ


def test_slip_of_rod_is_straight_at_mu_c_only():
    def last_direction_before_rest(mu):
        path = from_urdf(PROBLEMS["right"], mu, record=True).solution.path
        moving = np.hypot(*path.velocity[:, :2].T) > 1e-3
        slipping = path.velocity[moving & (path.normal_impulse < 0.1), :2]
        return np.arctan2(slipping[:, 1], slipping[:, 0])

    assert np.abs(last_direction_before_rest(ROD_MU_C) - pi / 3).max() < 1e-12  # (37)
    assert (np.diff(last_direction_before_rest(0.8 * ROD_MU_C)) < 0).all()
    assert (np.diff(last_direction_before_rest(1.2 * ROD_MU_C)) > 0).all()


@pytest.mark.parametrize(("factor", "sticks"), [(1 - 1e-9, False), (1 + 1e-9, True)])
def test_rod_sticks_above_mu_st(factor, sticks):
    flags = from_urdf(PROBLEMS["right"], ROD_MU_ST * factor).solution.flags  # (38)
    assert (pinimpact.Flag.STICK in flags) is sticks
    assert (pinimpact.Flag.SLIP_RESUMED in flags) is not sticks


def test_slip_of_pendulum_is_straight_at_mu_c():
    mu_c = tan(pi / 4) / (1 / sqrt(2))  # (41), corrected: tan θ / |cos φ₀|
    path = from_urdf(PROBLEMS["pendulum"], mu_c, record=True).solution.path
    assert np.abs(path.velocity[:, 0] + path.velocity[:, 1]).max() < 1e-14


@pytest.mark.parametrize("theta", [0.5, pi / 4, 1.1])
@pytest.mark.parametrize(("factor", "sticks"), [(1 - 1e-6, False), (1 + 1e-6, True)])
def test_pendulum_sticks_above_mu_st(theta, factor, sticks):
    robot = pinimpact.load_robot("spherical_pendulum")
    mu = factor / tan(theta)  # (42)
    contact = pinimpact.Contact("tip", pinimpact.Plane(), friction=mu, restitution=0.8)
    v = np.array([0.0, 1.0])  # slip along −x in the plane of the pendulum, so v_t vanishes with v₃
    hit = pinimpact.impact(robot.model, robot.data, np.array([0, theta]), v, contact)
    assert (hit.solution.status == pinimpact.Status.LOCKED) is sticks
    if not sticks:
        assert hit.solution.velocity[2] > 0
