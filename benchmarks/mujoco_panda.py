"""The Panda of example-robot-data in MuJoCo, without meshes, with a sphere at the hand and a table."""

from __future__ import annotations

import re
from pathlib import Path

import mujoco
import numpy as np
from example_robot_data.robots_loader import PandaLoader


def load(table: float, step: float, contact: bool = True) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return model and data; `table` is the height of the table [m]."""
    text = Path(PandaLoader().df_path).read_text()
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", text, flags=re.DOTALL)
    text = text.replace("<robot ", '<robot xmlns:xacro="none" ', 1) if "xacro:" in text else text
    text = re.sub(
        r"(<robot[^>]*>)",
        r'\1<mujoco><compiler discardvisual="false" fusestatic="false"/></mujoco>',
        text,
        count=1,
    )
    spec = mujoco.MjSpec.from_string(text)
    spec.option.timestep = step
    if contact:
        plane = spec.worldbody.add_geom()
        plane.type, plane.size, plane.pos = mujoco.mjtGeom.mjGEOM_PLANE, [1, 1, 0.1], [0, 0, table]
        tip = spec.body("panda_hand_tcp").add_geom()
        tip.type, tip.size, tip.mass = mujoco.mjtGeom.mjGEOM_SPHERE, [1e-3, 0, 0], 0.0
    model = spec.compile()
    return model, mujoco.MjData(model)


def set_state(model: mujoco.MjModel, data: mujoco.MjData, q: np.ndarray, v: np.ndarray) -> None:
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
