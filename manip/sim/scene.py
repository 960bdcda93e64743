"""The scene that the batch engine steps, compiled from a robosuite environment."""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import mujoco
import numpy as np

from manip.robot_config import RobotConfig
from manip.sim.names import lookup
from manip.sim.robosuite_factory import PANDA, PHYSICS_DT, make_stock
from manip.sim.robot_model import hand_kind
from manip.sim.scene_layout import SceneLayout, read_scene_layout
from manip.sim.sensors import Sensors
from manip.sim.slots import force_slots
from manip.sim.touches import Side, Touch

Array = np.ndarray
Fidelity = Literal["exact", "fast"]

FAST_DT = 0.005
"""Timestep [s] of the fast fidelity: 10 instead of 25 substeps at 20 Hz."""

_DELICATE = {"Robotiq85Gripper", "JacoThreeFingerGripper"}
"""Grippers for which that is too long. The Robotiq's fingers press on one another, and
with 5 ms they fly apart within a second; Jaco's lose what they hold."""

ARENA_BYTES = 64 << 20
"""Memory of one MjData; robosuite reserves 1.3 GB of address space."""


@dataclass(frozen=True)
class Scene:
    """A robosuite task and robot, compiled.

    physics: stock MJCF without visual geoms, with contact sensors for each touch, which
    touch_of_sensor tells, and then sensors of forces. visual: the stock model, for
    pictures.
    """

    physics: mujoco.MjModel
    visual: mujoco.MjModel
    stock: Any
    layout: SceneLayout
    touch_of_sensor: Array
    substeps: int
    control_dt: float

    @property
    def nq(self) -> int:
        """Length of qpos."""
        return int(self.physics.nq)

    def geom_size(self, name: str) -> Array:
        """Sizes [3] m of a geom of the physics model, as MuJoCo defines them by type.

        Raises:
            UserError: no such geom; the message lists the geoms that exist.
        """
        sizes: Array = self.physics.geom_size[lookup(self.physics, "geom", name)]
        return sizes.copy()

    def free_qpos(self, name: str) -> slice:
        """Entries of qpos that place a free body: position [3] m, quaternion wxyz."""
        start = int(self.physics.jnt_qposadr[self.physics.body(name).jntadr[0]])
        return slice(start, start + 7)


def build_scene(
    stock: Any, sensors: Sensors, control_freq: int = 20, fidelity: Fidelity = "exact"
) -> Scene:
    """Compile the scene of a stock environment made by `make_stock`.

    fidelity: "exact" is robosuite's own physics (2 ms); "fast" takes 5 ms steps where
        the gripper bears them, and leaves out the collisions of the arm's links, and of
        parked bodies with the floor, for training and sweeps.
    """
    layout = read_scene_layout(stock, sensors)
    quick = fidelity == "fast" and hand_kind(stock) not in _DELICATE
    dt = FAST_DT if quick else PHYSICS_DT
    spec = _physics(stock, fidelity, dt)
    if fidelity == "fast":
        _let_fall(spec, sensors.parked)
    owners = []
    for index, touch in enumerate(layout.touches):
        owners += [index] * _add_touch_sensors(spec, touch)
    for site in sensors.forces.values():
        _add_force_sensor(spec, site)
    physics = spec.compile()
    slots = (*layout.slots, *force_slots(physics, sensors.forces))
    return Scene(
        physics=physics,
        visual=stock.sim.model._model,
        stock=stock,
        layout=replace(layout, slots=slots),
        touch_of_sensor=np.array(owners, dtype=np.int64),
        substeps=round(1 / control_freq / dt),
        control_dt=1 / control_freq,
    )


def load_scene(
    name: str,
    sensors: Sensors,
    robot: RobotConfig = PANDA,
    fidelity: Fidelity = "exact",
    seed: int | None = 0,
) -> Scene:
    """Build the stock environment `name` and its scene.

    seed: fixes what robosuite samples at construction (Lift's cube size).
    """
    stock = make_stock(name, robot, seed)
    return build_scene(stock, sensors, robot.control_freq, fidelity)


def _physics(stock: Any, fidelity: Fidelity, dt: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec.from_string(stock.model.get_xml())
    spec.option.timestep = dt
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    spec.memory = ARENA_BYTES
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    _strip(spec, stock, fidelity)
    return spec


def _strip(spec: mujoco.MjSpec, stock: Any, fidelity: Fidelity) -> None:
    """Delete what cannot touch anything, and what only such geoms used."""
    prefix = stock.robots[0].robot_model.naming_prefix
    for geom in list(spec.geoms):
        of_arm = geom.parent.name.startswith(prefix)
        collides = geom.contype or geom.conaffinity
        if not collides or (fidelity == "fast" and of_arm):
            spec.delete(geom)
    for geom in spec.geoms:
        geom.material = ""
    for site in spec.sites:
        site.material = ""
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)
    for part in (*spec.materials, *spec.textures):
        spec.delete(part)


def _let_fall(spec: mujoco.MjSpec, parked: tuple[str, ...]) -> None:
    """Let bodies fall through the floor, where resting would cost contacts."""
    for body in parked:
        spec.add_exclude(bodyname1="world", bodyname2=body)


def _add_touch_sensors(spec: mujoco.MjSpec, touch: Touch) -> int:
    """Add a contact sensor a pair, which reads the contacts found; their number."""
    geom, subtree = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtObj.mjOBJ_XBODY
    sides = _present(spec, touch.first), _present(spec, touch.second)
    pairs = list(product(*sides))
    for a, b in pairs:
        spec.add_sensor(
            name=f"{touch.name}/{a}/{b}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=geom if touch.first.geoms else subtree,
            objname=a,
            reftype=geom if touch.second.geoms else subtree,
            refname=b,
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND), 0, 1],
        )
    return len(pairs)


def _add_force_sensor(spec: mujoco.MjSpec, site: str) -> None:
    spec.add_sensor(
        name=f"force/{site}",
        type=mujoco.mjtSensor.mjSENS_FORCE,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname=site,
    )


def _present(spec: mujoco.MjSpec, side: Side) -> list[str]:
    """Names of a side; of its geoms, those that the fidelity has kept."""
    if side.geoms:
        return [name for name in side.geoms if spec.geom(name)]
    return [side.body or ""]
