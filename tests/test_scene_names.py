"""Names of contacts in a scene, and initial states of held contacts."""

from __future__ import annotations

import re
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import pinimpact
from pinimpact import Contact, Plane, Scene, simulate
from pinimpact.app.scene_loader import load_scene

from .scene_models import UP, ball, free_body, pendulum, run, shaped_body, slider, unbounded

FLOOR = Plane()
WALL = Plane(point=(1.0, 0, 0), normal=(-1.0, 0, 0))
SCENES = Path(__file__).parents[1] / "examples" / "scenes"


def labels(scene: Scene) -> list[str]:
    return [contact.label for contact in (*scene.contacts, *scene.held)]


def test_one_frame_with_two_planes() -> None:
    scene = Scene(ball(), [Contact("center", plane, restitution=0.8, radius=0.1) for plane in (FLOOR, WALL)])
    assert labels(scene) == ["center on plane 1", "center on plane 2"]
    trajectory = simulate(scene, [0, 0, 0.2, *UP], [3.0, 0, 0, 0, 0, 0], 0.4)
    first = {impact.source: impact for impact in reversed(trajectory.impacts)}
    assert first["center on plane 1"].time == pytest.approx(np.sqrt(2 * 0.1 / 9.81))
    assert first["center on plane 2"].time == pytest.approx(0.9 / 3.0)


def test_two_points_on_one_plane() -> None:
    corners = [Contact("center", FLOOR, offset=(x, 0, 0)) for x in (-0.1, 0.1)]
    assert labels(Scene(ball(), corners)) == ["center on plane 1", "center on plane 2"]
    assert labels(Scene(ball(), corners[:1], held=corners[1:])) == ["center on plane 1", "center on plane 2"]


def test_one_shape_with_two_planes() -> None:
    crate = shaped_body(coal.Box(0.2, 0.2, 0.2), pin.Inertia.FromBox(1.0, 0.2, 0.2, 0.2), name="crate")
    both = Scene(crate, [Contact(geometry="crate", plane=plane) for plane in (FLOOR, WALL)])
    assert labels(both) == [f"crate corner {k} on plane {n}" for n in (1, 2) for k in range(1, 9)]
    later = Scene(crate).contacts_from_geometry(FLOOR).contacts_from_geometry(WALL)
    assert labels(later) == [f"crate corner {k} on plane{n}" for n in ("", " 1") for k in range(1, 9)]
    with pytest.raises(pinimpact.InputError, match="2 contacts are called 'crate corner 1 on plane'"):
        Scene(crate).contacts_from_geometry(FLOOR).contacts_from_geometry(FLOOR, friction=0.5)


def test_given_names_are_kept() -> None:
    contacts = [
        Contact("center", FLOOR),
        Contact("center", FLOOR, offset=(0.1, 0, 0), name="center on plane 1"),
        Contact("center", FLOOR, offset=(0.2, 0, 0)),
        Contact("center", WALL, name="wall"),
        Contact("body", FLOOR),
    ]
    model = ball()
    model.addFrame(pin.Frame("body", 1, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    found = labels(Scene(model, contacts))
    assert found == ["center on plane 2", "center on plane 1", "center on plane 3", "wall", "body on plane"]


def test_duplicate_contact_or_name_raises() -> None:
    with pytest.raises(pinimpact.InputError, match="'center on plane' is given twice"):
        Scene(ball(), [Contact("center", FLOOR), Contact("center", FLOOR)])
    with pytest.raises(pinimpact.InputError, match="2 contacts are called 'foot'"):
        Scene(ball(), [Contact("center", plane, name="foot") for plane in (FLOOR, WALL)])


def test_contact_named_like_joint_limit_or_dry_joint_raises() -> None:
    model = pendulum()
    model.upperPositionLimit = np.array([0.5])
    with pytest.raises(pinimpact.InputError, match=r"'hinge upper'.*joint limit"):
        Scene(model, [Contact("tip", FLOOR, name="hinge upper")])
    contact = Contact("tip", FLOOR, name="hinge")
    assert labels(Scene(model, [contact])) == ["hinge"]
    model.friction = np.array([0.1])
    with pytest.raises(pinimpact.InputError, match=r"'hinge'.*dry friction"):
        Scene(model, [contact])


@pytest.mark.parametrize("field", ["contacts", "held"])
@pytest.mark.parametrize("value", [3, ["center"], [None]])
def test_invalid_contacts_raise(field: str, value: object) -> None:
    with pytest.raises(pinimpact.InputError, match=f"^{field}: ") as caught:
        Scene(ball(), **{field: value})
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("limit_restitution", "much"),
        ("limit_restitution", 1.5),
        ("resting_speed", "slow"),
        ("resting_speed", 0.0),
        ("resting_speed", -1.0),
        ("resting_speed", np.inf),
    ],
)
def test_invalid_numbers_raise(field: str, value: object) -> None:
    with pytest.raises(pinimpact.InputError, match=f"^{field}: ") as caught:
        Scene(ball(), **{field: value})
    assert caught.value.field == field


def test_scene_file_names_contacts_by_planes(tmp_path: Path) -> None:
    text = (SCENES / "ball_on_conveyor.toml").read_text(encoding="utf-8")
    text = text.replace("ball.urdf", str(SCENES / "ball.urdf")).replace('name = "ball on belt"\n', "")
    path = tmp_path / "scene.toml"
    wall = "[plane.wall]\npoint = [9, 0, 0]\nnormal = [-1, 0, 0]\n"

    def contact(plane: str, offset: float) -> str:
        return f'[[contact]]\nframe = "ball"\nplane = "{plane}"\noffset = [{offset}, 0, 0]\n'

    path.write_text(text + wall + contact("wall", 0.0) + contact("wall", 0.01), encoding="utf-8")
    assert labels(load_scene(path).scene) == ["ball on belt", "ball on wall 1", "ball on wall 2"]
    path.write_text(text + wall + 2 * contact("wall", 0.0), encoding="utf-8")
    with pytest.raises(pinimpact.InputError, match=re.escape("contact[2]: the same as contact[1]")):
        load_scene(path)
    solo = load_scene(SCENES / "solo12_landing.toml").scene
    assert labels(solo) == [f"{foot}_FOOT on floor" for foot in ("FL", "FR", "HL", "HR")]


# ---- reachable and held contacts


def test_surface_beyond_ignored_joint_limits_is_reachable() -> None:
    model = slider()
    unbounded(model)
    model.lowerPositionLimit, model.upperPositionLimit = np.full(3, -0.1), np.full(3, 0.1)
    deep = Contact("point", Plane(point=(0, 0, -0.5)))
    assert Scene(model, [deep]).plan().unreachable == ("point on plane",)
    scene = Scene(model, [deep], without=["joint limits"])
    assert scene.plan().unreachable == ()
    assert run(scene, np.zeros(3), np.zeros(3), 1.0).q[-1] == pytest.approx([0, 0, -0.5], abs=1e-9)


@pytest.mark.parametrize("height", [0.377, -0.377])
def test_held_contact_far_from_its_surface_raises(height: float) -> None:
    rod = free_body(pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), [(-0.5, 0, 0)])
    scene = Scene(rod, held=[Contact("tip0", FLOOR, name="foot")])
    with pytest.raises(
        pinimpact.InputError, match=rf"q0: .*'foot' starts {height} m from its surface"
    ) as caught:
        simulate(scene, [0, 0, height, *UP], np.zeros(6), 0.1)
    assert caught.value.field == "q0"


def test_held_contact_keeps_small_initial_gap() -> None:
    rod = free_body(pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), [(-0.5, 0, 0)])
    foot = Contact("tip0", FLOOR)
    trajectory = run(Scene(rod, held=[foot]), [0, 0, 3e-4, *UP], np.zeros(6), 0.3)
    assert [mode.mode for mode in trajectory.modes] == ["held"]
    data = rod.createData()
    gaps = [foot.gap(rod, data, q) for q in trajectory.q]
    assert gaps == pytest.approx([3e-4] * len(gaps), abs=1e-9)
