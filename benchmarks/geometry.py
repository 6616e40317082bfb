"""Cost of contacts from collision shapes: a Panda with contacts of all links, against one without.

python -m benchmarks.geometry
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from benchmarks.panda_scene import START, STILL, panda
from benchmarks.timing import best_of, publish, row

from pinimpact import Box, Contact, Plane, Scene, load_robot, simulate

ROUNDS = 20
LOW = Plane(point=(0.0, 0.0, -0.6), name="low floor")
BLOCK = Box(size=(0.1, 0.1, 0.1), center=(-0.3, 0.3, 0.4), name="block")
FLOOR = Plane(name="floor")
FALL = np.array([0.0, 0.7, 0.0, -1.75, 0.0, 1.57, 0.785, 0.0, 0.0])
SWING = FALL * [1, -1, 1, 1, 1, 1, 1, 1, 1]


def main() -> None:
    """Time each second with and without, in turns."""
    robot = load_robot("panda")
    table = panda()
    struck = replace(table, geometry=robot.collision_model)
    swinging = Scene(robot, contacts=Contact("panda_hand_tcp", Plane(point=(0.0, 0.0, -2.0))))
    falling = Scene(robot).contacts_from_geometry(FLOOR, friction=0.5, restitution=0.2)
    alone = replace(falling, contacts=[replace(contact, shape=None) for contact in falling.contacts])
    rows = []
    for name, one, other, start, seconds in (
        ("strikes a table, 1 s", struck.contacts_from_geometry(LOW), table, START, 1.0),
        (
            "swings, 1 s",
            swinging.contacts_from_geometry(LOW),
            swinging,
            SWING,
            1.0,
        ),
        (
            "swings beside a block, 1 s",
            replace(swinging, geometry=robot.collision_model).contacts_from_geometry(BLOCK),
            swinging,
            SWING,
            1.0,
        ),
        ("falls on the floor, 0.5 s", falling, alone, FALL, 0.5),
    ):
        calls = {
            "one": partial(simulate, one, start, STILL, seconds),
            "other": partial(simulate, other, start, STILL, seconds),
        }
        ran = [call() for call in calls.values()]
        assert [i.source for i in ran[0].impacts] == [i.source for i in ran[1].impacts], name
        taken = best_of(calls, ROUNDS)
        what = f"Panda {name}, {len(one.layout().watched)} contacts"
        against = "each point looked at alone" if other is alone else "one contact watched"
        goal = None if other is alone else 1.5
        rows.append(row(what, taken["one"], goal, against, taken["other"]))
    publish("geometry", rows)


if __name__ == "__main__":
    main()
