"""Set-up of a scene compiles all kernels that it may need, with declared types; none is compiled later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

RUNS = """
import sys
import numpy as np, pinocchio as pin
from numba.core.dispatcher import Dispatcher
from pinimpact import Contact, Event, Plane, Scene, Sphere, simulate
from tests.scene_models import UP, ball, free_body, pendulum

def overloads():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.startswith("pinimpact."):
            for item in list(vars(module).values()):
                if isinstance(item, Dispatcher):
                    found[f"{item.py_func.__module__}.{item.py_func.__name__}"] = len(item.overloads)
    return found

# contacts with a plane and a sphere, as in all scenes below
floor = Contact("center", Plane(), radius=0.1, friction=0.3, restitution=0.5)
post = Contact("center", Sphere((3, 0, 0), 0.2), radius=0.1, name="post")
simulate(Scene(ball(), [floor, post]), [0, 0, 1.0, *UP], np.zeros(6), 1e-6)
before = overloads()

simulate(Scene(ball(), [floor, post]), [0, 0, 1, *UP], [2, 0, 0, 0, 30, 0], 2.0, rtol=0.1, atol=1, max_step=1)
corners = [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
box = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2), corners)
feet = [Contact(f"tip{k}", Plane(), friction=0.4) for k in range(4)]
push = lambda t, q, v: [2 * t, 1.0, 0, 0, 0, 0]
run = simulate(Scene(box, feet, control=push), [0, 0, 0.3, *UP], [0.5, 0.2, 0, 0, 0, 1.0], 3.0)
assert {mode.mode for mode in run.modes} >= {"slip", "stick"}
swinging = pendulum()
swinging.lowerPositionLimit, swinging.friction = np.array([-0.5]), np.array([0.3])
scene = Scene(swinging, limit_restitution=0.3, events=[Event(lambda t, q, v: q[0])])
run = simulate(scene, [1.0], [0.0], 5.0)
assert run.impacts and run.events
grasped = Contact("center", Plane((0, 0, 1.0)), name="grasp")
simulate(Scene(ball(), [floor], held=[grasped]), [0, 0, 1.0, *UP], [0, 0, 0, 0, 0, 1.0], 0.2)
rolling = Scene(ball(), [Contact("center", Plane(), radius=0.1, friction=0.2)])
simulate(rolling, [0, 0, 0.1, *UP], [1.0, 0.5, 0, 0, -5.0, 0], 2.0).at(np.float64(0.3))
after = overloads()
print({name: count for name, count in after.items() if count != before.get(name, 0) and "scene" in name})
"""

WATCHED = """
import sys
import numpy as np, pinocchio as pin
from numba.core.dispatcher import Dispatcher
from pinimpact import Contact, Plane, Scene, impact, load_robot, simulate
from tests.scene_models import UP, ball, free_body

def there():  # return all compiled or loaded kernels with their types
    kernels = {item for name, module in list(sys.modules.items()) if name.startswith("pinimpact.")
               for item in list(vars(module).values()) if isinstance(item, Dispatcher)}
    return {(one.py_func.__qualname__, types) for one in kernels for types in one.overloads}

names = lambda found: {name for name, _ in found}
corners = [(x, y, -0.1) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
box = free_body(pin.Inertia.FromBox(1.0, 0.4, 0.4, 0.2), corners)
"""

LISTS = (
    WATCHED
    + """
def strike(e, mu):
    tips = [Contact(f"tip{k}", Plane(), friction=mu, restitution=e) for k in range(4)]
    impact(box, box.createData(), [0, 0, 0.1, *UP], [0.1, 0, -1.0, 0, 0.3, 0], tips)

strike(0.5, 0.0)
before = there()
assert {"propagate", "impulses_together"} <= names(before)  # also kernels that later impacts may need
strike(0.0, 0.5)
print({name: 1 for name in names(there() - before)})
"""
)

GROUPS = (
    WATCHED
    + """
set_up = lambda scene, q: simulate(scene, q, np.zeros(scene.model.nv), 1e-6)
floor = Contact("center", Plane(), radius=0.1, friction=0.3, restitution=0.5)
set_up(Scene(ball(), [floor]), [0, 0, 1.0, *UP])
assert not names(there()) & {"propagate", "impulses_together", "taking_part"}  # not needed for one contact

def struck(scene, q, v, duration):  # impacts at several contacts compile nothing after the set-up
    set_up(scene, q)
    before = there()
    run = simulate(scene, q, v, duration)
    assert any(impact.group for impact in run.impacts)
    assert not names(there() - before), names(there() - before)

for policy in ("together", "any", "propagate"):
    feet = [Contact(f"tip{k}", Plane(), friction=0.4, restitution=0.5, law="poisson") for k in range(4)]
    struck(Scene(box, feet, simultaneous=policy), [0, 0, 0.2, *UP], [0.3, 0, 0, 0, 0, 0], 0.3)
panda = load_robot("panda")
hand = Contact("panda_hand_tcp", Plane((0, 0, 0.2)), friction=0.4, restitution=0.5)
bent = [0, 0.3, 0, -1.5, 0, 1.5, 0, 0.02, 0.02]
struck(Scene(panda, [hand], locked=["panda_joint1"]), bent, np.zeros(9), 0.5)
print({})
"""
)

AS_DECLARED = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from pinimpact import Contact, Plane, Scene, Sphere, simulate
from pinimpact._compile.declared import declared_types
from tests.scene_models import UP, ball

floor = Contact("center", Plane(), radius=0.1, friction=0.3, restitution=0.5)
simulate(Scene(ball(), [floor]), [0, 0, 1.0, *UP], np.zeros(6), 1e-6)
kernels = {item for name, module in sys.modules.items() if name.startswith("pinimpact.")
           for item in vars(module).values() if isinstance(item, Dispatcher) and hasattr(item, "declared")}
assert len(kernels) > 20
print({one.py_func.__qualname__: set(one.overloads) - {declared_types(one)}
       for one in kernels if set(one.overloads) - {declared_types(one)}})
"""


@pytest.mark.parametrize(
    "code", [RUNS, LISTS, GROUPS, AS_DECLARED], ids=["nothing later", "lists", "groups", "as declared"]
)
def test_nothing_is_compiled_after_set_up(code):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=Path(__file__).parents[1],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "{}"


WARMED = """
import numpy as np
from numba.core import event
import pinimpact as p
from pinimpact.app.warmup import warm_up
from pinimpact.studies.cost import run_cost
from tests.scene_models import UP, ball, pendulum

warm_up()
W = np.array([[2, 0, 0.5], [0, 3, 0.4], [0.5, 0.4, 1]])
floor = p.Contact("center", p.Plane(), radius=0.1, friction=0.3, restitution=0.5)
model = ball()
q, v = np.array([0, 0, 0.1, *UP]), np.array([1.0, 0, -1, 0, 0, 0])
with event.install_recorder("numba:compile") as record:
    problem = p.ImpactProblem(W, (1, 0.5, -1), 0.3, 0.5)
    p.solve_impact(problem)
    p.solve_impact(problem, "euler")
    p.solve_impacts(W[None], [(1, 0.5, -1)], 0.3, 0.5, "energetic", work=True)
    p.impact(model, model.createData(), q, v, floor)
    other = p.Contact("center", p.Plane((0, 0, -0.01)), radius=0.09, name="other")
    p.impact(model, model.createData(), q, v, [floor, other])
    p.impacts(model, model.createData(), q[None], v[None], floor)
    for policy in ("together", "propagate"):
        run = p.simulate(p.Scene(model, [floor], simultaneous=policy), [0, 0, 0.3, *UP], v, 0.5)
    assert run.impacts
    run.forces("center on plane", 0.4)
    q.flags.writeable = v.flags.writeable = False
    p.impacts(model, model.createData(), q[None], v[None], floor, friction=np.broadcast_to(0.3, 1))
    p.impact(model, model.createData(), q, v, floor)
    p.simulate(p.Scene(model, [floor]), q, v, 0.1)
    hits = p.impacts(model, model.createData(), np.tile(q, (3, 1)), np.tile(v, (3, 1)), floor)
    assert np.isfinite(hits.work.total).all()
    hinged = pendulum()
    tip = p.Contact("tip", p.Plane((0, 0, -0.5)), friction=0.3)
    at = p.place_in_contact(hinged, hinged.createData(), [0.3], tip)
    p.impact(hinged, hinged.createData(), at, [-1.0], tip)
    p.contact_matrices(hinged, hinged.createData(), at, tip)
    for scheme in ("auto", "time-stepping"):
        p.simulate(p.Scene(hinged, [tip]), [1.4], [0.0], 0.5, scheme=scheme)
    p.Stepper(p.Scene(hinged, [tip]), [1.4], [0.0]).step([0.1], 0.1)
    run_cost({"a problem": problem}, ("exact", "euler", "rk4", "adaptive"), repeats=1, time_cap=1e-3)
print({one.data["dispatcher"].py_func.__qualname__ for _, one in record.buffer if one.is_start} or {})
"""


def test_nothing_is_compiled_after_warmup() -> None:
    test_nothing_is_compiled_after_set_up(WARMED)
