"""Impacts as functions of JAX and PyTorch: gradients, transformations, errors."""

import builtins
import sys

import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, InputError, Plane, load_robot

try:
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
except ImportError:
    jax = None
try:
    import torch
except ImportError:
    torch = None

LIBRARIES = [
    pytest.param("jax", marks=pytest.mark.skipif(jax is None, reason="jax is not installed")),
    pytest.param("torch", marks=pytest.mark.skipif(torch is None, reason="torch is not installed")),
]


def _functions(library):
    if library == "jax":
        from pinimpact.integrations import jax as functions
    else:
        from pinimpact.integrations import torch as functions
    return functions


def _gradient(library, function, *arrays):
    """Return the gradients of a scalar function by all arguments."""
    if library == "jax":
        found = jax.grad(lambda *given: function(*given), argnums=tuple(range(len(arrays))))(
            *map(jnp.asarray, arrays)
        )
        return [np.asarray(g) for g in found]
    tensors = [torch.tensor(np.asarray(a, dtype=float), requires_grad=True) for a in arrays]
    function(*tensors).backward()
    return [t.grad.numpy() for t in tensors]


def _difference(function, arrays, i, direction, h=1e-6):
    low, high = list(arrays), list(arrays)
    low[i], high[i] = arrays[i] - h * direction, arrays[i] + h * direction
    return (function(*high) - function(*low)) / (2 * h)


def _problems(count, seed):
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(count, 3, 5))
    velocity = rng.normal(size=(count, 3))
    velocity[:, 2] = -np.abs(velocity[:, 2]) - 0.2
    return (
        roots @ roots.transpose(0, 2, 1),
        velocity,
        rng.uniform(0.1, 0.9, count),
        rng.uniform(0.1, 0.9, count),
    )


@pytest.mark.parametrize("library", LIBRARIES)
@pytest.mark.parametrize("law", ["newton", "poisson", "energetic"])
def test_gradients_in_contact_space_against_difference_quotients(library, law):
    functions = _functions(library)
    arrays = _problems(6, 3)
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 6, 3))

    def loss(*given):
        solved = pinimpact.solve_impacts(*given, law=law)
        return (a * solved.velocity).sum() + (b * solved.impulse).sum()

    def same(*given):
        after, impulse = functions.solve_impacts(*given, law=law)
        weights = (jnp.asarray(a), jnp.asarray(b)) if library == "jax" else (torch.tensor(a), torch.tensor(b))
        return (weights[0] * after).sum() + (weights[1] * impulse).sum()

    gradients = _gradient(library, same, *arrays)
    for i, gradient in enumerate(gradients):
        direction = rng.normal(size=arrays[i].shape)
        if i == 0:
            direction = direction + direction.transpose(0, 2, 1)
        expected = _difference(loss, arrays, i, direction)
        assert (gradient * direction).sum() == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.fixture(scope="module")
def quadruped():
    robot = load_robot("solo12")
    model, data = robot.model, robot.data
    q = pin.integrate(model, robot.q0, np.r_[0, 0, 0, 0.1, 0.2, -0.1, np.linspace(-0.3, 0.3, 12)])
    foot = next(f.name for f in model.frames if f.name.endswith("FOOT"))
    return model, data, q, foot


@pytest.mark.parametrize("library", LIBRARIES)
def test_gradients_of_impact_of_robot(library, quadruped):
    model, data, q, foot = quadruped
    functions = _functions(library)
    contact = Contact(foot, Plane(), friction=0.4, restitution=0.3)
    rng = np.random.default_rng(1)
    v = rng.normal(size=(3, model.nv))
    v[:, 2] -= 2.0
    weights = rng.normal(size=model.nv)

    def loss(q, v, mu, e):
        return (pinimpact.impacts(model, data, q, v, contact, mu, e).v @ weights).sum()

    def same(q, v, mu, e):
        w = jnp.asarray(weights) if library == "jax" else torch.tensor(weights)
        return (functions.impact(model, data, q, v, contact, mu, e) @ w).sum()

    arrays = [q, v, np.array(0.4), np.array(0.3)]
    gradients = _gradient(library, same, *arrays)
    assert [g.shape for g in gradients] == [np.shape(a) for a in arrays]
    for i in (1, 2, 3):
        direction = np.asarray(rng.normal(size=arrays[i].shape))
        expected = _difference(loss, arrays, i, direction)
        assert (gradients[i] * direction).sum() == pytest.approx(expected, rel=1e-6, abs=1e-6)
    tangent = rng.normal(size=model.nv)
    h = 1e-6
    ends = [pin.integrate(model, q, s * h * tangent) for s in (1, -1)]
    expected = (loss(ends[0], *arrays[1:]) - loss(ends[1], *arrays[1:])) / (2 * h)
    assert gradients[0] @ ((ends[0] - ends[1]) / (2 * h)) == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert gradients[0][3:7] @ q[3:7] == pytest.approx(0.0, abs=1e-9)  # by its norm


@pytest.mark.parametrize("library", LIBRARIES)
def test_results_are_on_the_device_of_the_arguments(library):
    gpu = torch.cuda.is_available() if library == "torch" else jax.default_backend() == "gpu"
    if not gpu:
        pytest.skip("no accelerator")
    functions, arrays = _functions(library), _problems(4, 9)
    exact = pinimpact.solve_impacts(*arrays, derivatives=True)
    if library == "torch":
        given = [torch.tensor(a, device="cuda", requires_grad=True) for a in arrays]
        after, _ = functions.solve_impacts(*given)
        after.sum().backward()
        slope = given[1].grad
        assert after.is_cuda
        assert slope.is_cuda
        after, slope = after.detach().cpu(), slope.cpu()
    else:
        given = [jnp.asarray(a) for a in arrays]
        of = jax.jit(lambda v: functions.solve_impacts(given[0], v, *given[2:])[0])
        after, slope = of(given[1]), jax.jit(jax.grad(lambda v: of(v).sum()))(given[1])
        assert after.devices() == slope.devices() == given[1].devices()
    np.testing.assert_array_equal(after, exact.velocity)
    np.testing.assert_allclose(slope, exact.derivatives.dv_dv.sum(axis=1), rtol=0, atol=1e-14)


@pytest.mark.skipif(jax is None, reason="jax is not installed")
def test_jax_transforms_both_ways_and_in_batches():
    functions = _functions("jax")
    arrays = tuple(map(jnp.asarray, _problems(5, 8)))
    one = lambda *given: functions.solve_impacts(*given)[0]  # noqa: E731
    forwards = jax.jit(jax.vmap(jax.jacfwd(one, argnums=1)))(*arrays)
    backwards = jax.vmap(jax.jacrev(one, argnums=1))(*arrays)
    exact = pinimpact.solve_impacts(*map(np.asarray, arrays), derivatives=True).derivatives.dv_dv
    np.testing.assert_allclose(forwards, exact, rtol=0, atol=1e-14)
    np.testing.assert_allclose(backwards, exact, rtol=0, atol=1e-14)
    np.testing.assert_array_equal(jax.vmap(one)(*arrays), one(*arrays))


@pytest.mark.skipif(jax is None, reason="jax is not installed")
@pytest.mark.parametrize("count", [2, 3])
def test_jax_maps_one_argument_over_rows_of_another(count):
    w, velocity, _, _ = map(jnp.asarray, _problems(5, 3))
    friction = jnp.linspace(0.1, 0.5, count)
    of = lambda mu: _functions("jax").solve_impacts(w, velocity, mu, 0.5)[0]  # noqa: E731
    for mapped in (of, jax.jacfwd(of), jax.jacrev(of)):
        np.testing.assert_array_equal(jax.vmap(mapped)(friction), jnp.stack([mapped(mu) for mu in friction]))


@pytest.mark.skipif(jax is None, reason="jax is not installed")
@pytest.mark.parametrize("direction", ["jacfwd", "jacrev"])
def test_derivatives_by_one_argument_where_others_do_not_exist(direction):
    """Slip begins here: derivatives by v_t, W and μ do not exist, and v₃⁺ = −e v₃° by Poisson's law."""
    w = np.array([[2.0, 0.0, 0.9], [0.0, 2.0, 0.0], [0.9, 0.0, 1.5]])
    of = lambda v, mu, e: _functions("jax").solve_impacts(w, v, mu, e)[0][2]  # noqa: E731
    by = [getattr(jax, direction)(of, k)(jnp.array([0.0, 0.0, -1.0]), 0.1, 0.5) for k in range(3)]
    assert np.isnan(by[0]).any()
    assert by[2] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.skipif(jax is None, reason="jax is not installed")
def test_whole_numbers_are_converted():
    one = _functions("jax").solve_impacts(np.eye(3, dtype=int), [1, 0, -2], 1, 0)[0]
    np.testing.assert_array_equal(one, _functions("jax").solve_impacts(np.eye(3), [1.0, 0, -2], 1.0, 0.0)[0])


@pytest.mark.parametrize("library", LIBRARIES)
def test_rows_without_solution_are_nan_and_do_not_affect_others(library):
    functions = _functions(library)
    w, v, mu, e = _problems(2, 5)
    w[1] = np.nan
    convert = jnp.asarray if library == "jax" else torch.tensor
    after = np.asarray(functions.solve_impacts(*map(convert, (w, v, mu, e)))[0])
    assert np.isfinite(after[0]).all()
    assert np.isnan(after[1]).all()


@pytest.mark.parametrize("library", LIBRARIES)
def test_invalid_rows_of_a_robot_have_no_derivatives_and_do_not_affect_others(library, quadruped):
    model, data, q, foot = quadruped
    functions, contact = _functions(library), Contact(foot, Plane(), friction=0.4, restitution=0.3)
    v = np.zeros(model.nv)
    v[:3] = 0.3, 0.1, -1.0
    rows = [np.tile(q, (5, 1)), np.tile(v, (5, 1)), np.full(5, 0.4), np.full(5, 0.3)]
    rows[0][1, 3:7] *= 1.1  # as after a step along a gradient
    rows[1][2], rows[2][3], rows[3][4] = np.nan, -0.4, 1.3
    found = _gradient(
        library, lambda *given: functions.impact(model, data, *given[:2], contact, *given[2:]).sum(), *rows
    )
    expected = pinimpact.impact_derivatives(model, data, q, v, contact)
    np.testing.assert_allclose(found[1][0], expected.dv_dv.sum(axis=0), rtol=0, atol=1e-12)
    assert found[2][0] == pytest.approx(expected.dv_dfriction.sum(), abs=1e-12)
    for gradient in found:
        assert np.isfinite(gradient[0]).all()
        assert np.isnan(gradient[1:]).all()


@pytest.mark.parametrize("library", LIBRARIES)
def test_restitution_as_a_function_of_speed(library, quadruped):
    model, data, q, foot = quadruped

    class Falling:
        def __call__(self, speed):
            return 0.8 / (1.0 + speed)

        def slope(self, speed):
            return -0.8 / (1.0 + speed) ** 2

    contact = Contact(foot, Plane(), friction=0.0, restitution=Falling())
    v = np.zeros(model.nv)
    v[2] = -1.0
    functions = _functions(library)
    gradient = _gradient(library, lambda v: functions.impact(model, data, q, v, contact)[2], v)[0]
    expected = pinimpact.impact_derivatives(model, data, q, v, contact).dv_dv[2]
    np.testing.assert_allclose(gradient, expected, atol=1e-13)


@pytest.mark.parametrize("library", LIBRARIES)
def test_bad_input_is_named(library, quadruped):
    model, data, q, foot = quadruped
    functions = _functions(library)
    w, v, mu, e = _problems(2, 5)
    single = (jnp if library == "jax" else torch).float32
    convert = jnp.asarray if library == "jax" else torch.tensor
    with pytest.raises(InputError, match=r"velocity: .*float32 given, double precision expected"):
        functions.solve_impacts(w, convert(v, dtype=single), mu, e)
    with pytest.raises(InputError, match=r"q: shape \(3,\) given"):
        functions.impact(model, data, np.zeros(3), np.zeros(model.nv), Contact(foot, Plane()))
    at_rest = q, np.zeros(model.nv)
    with pytest.raises(InputError, match=r"contact: .* is not a Contact"):
        functions.impact(model, data, *at_rest, [Contact(foot, Plane())])
    with pytest.raises(pinimpact.UnknownNameError, match="'elbow'"):
        functions.impact(model, data, *at_rest, Contact(foot, Plane()), locked=["elbow"])
    with pytest.raises(InputError, match=r"leading shapes delassus \(2,\), velocity \(5,\), friction"):
        functions.solve_impacts(w, np.zeros((5, 3)), mu, e)
    with pytest.raises(pinimpact.UnknownNameError, match="law"):
        functions.solve_impacts(w, v, mu, e, law="elastic")


@pytest.mark.parametrize("library", ["jax", "torch"])
def test_missing_library_is_named(library, monkeypatch):
    imported = builtins.__import__

    def refuse(name, *rest):
        if name == library or name.startswith(library + "."):
            raise ImportError(name)
        return imported(name, *rest)

    monkeypatch.delitem(sys.modules, f"pinimpact.integrations.{library}", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(InputError, match=rf"{library}: not installed; pip install 'pinimpact\[{library}\]'"):
        __import__(f"pinimpact.integrations.{library}")
