"""The scene that the batch engine steps, compiled from a robosuite environment."""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

import mujoco
import numpy as np

from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.fields import physics_field_slots
from manip.sim.names import lookup
from manip.sim.not_copied import NotCopied
from manip.sim.robosuite_factory import PANDA, PHYSICS_DT, make_stock
from manip.sim.robot_model import default_qpos, hand_kind
from manip.sim.scene_layout import SceneLayout, read_scene_layout
from manip.sim.sensors import Sensors
from manip.sim.slots import Slot, force_slots
from manip.sim.touches import Side, Touch

Array = np.ndarray
Fidelity = Literal["exact", "fast"]

FAST_DT = 0.005
"""Timestep [s] of the fast fidelity: 10 instead of 25 substeps at 20 Hz."""

_UNSTABLE_AT_FAST_DT = {"Robotiq85Gripper", "JacoThreeFingerGripper"}
"""Grippers that need the exact timestep. With 5 ms the Robotiq's fingers, which press
on one another, diverge within a second, and Jaco's drop what they hold."""

GAINS = "gains"
"""Array of `Scene.varied` that is no part of the model: the controller's kp and kd."""

ARENA_BYTES = 64 << 20
"""Memory of one MjData; robosuite reserves 1.3 GB of address space."""


@dataclass(frozen=True)
class Scene(NotCopied):
    """A robosuite task and robot, compiled. It does not change: copies share it.

    Attributes:
        physics: the model that is stepped: stock MJCF without visual geoms, with
            contact sensors for the touches and then force sensors.
        visual: the stock model, for images.
        stock: the robosuite environment.
        layout: indices, names and gains.
        physics_fields: where the fields of `layout.fields` lie in `physics`; None for
            those that only images show.
        touch_of_sensor: for each contact sensor the touch to which it adds.
        substeps: simulation steps in a control period.
        control_dt: control period [s].
        varied: entries of `physics`, or the controller's gains, that differ between
            environments besides the task's fields.
        with_peaks: whether the readings include `peak_speed` [N, k] rad/s and
            `peak_torque` [N, k] N m, the largest ones of each of the k joints of the
            arms over the substeps of the last control period.
        parked: bodies that the task places out of the way (`Sensors.parked`).
    """

    physics: mujoco.MjModel
    visual: mujoco.MjModel
    stock: Any
    layout: SceneLayout
    physics_fields: tuple[Slot | None, ...]
    touch_of_sensor: Array
    substeps: int
    control_dt: float
    varied: tuple[Slot, ...] = ()
    with_peaks: bool = False
    parked: tuple[str, ...] = ()

    @property
    def parked_geoms(self) -> Array:
        """[ngeom] bool: the physics geoms of the parked bodies."""
        parked = [lookup(self.physics, "body", name) for name in self.parked]
        return np.isin(self.physics.geom_bodyid, parked)

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
        """Entries of qpos that place a free body: position [3] m, quaternion wxyz.

        Raises:
            UserError: no such body, or it is not on a free joint.
        """
        model = self.physics
        joint = model.body_jntadr[lookup(model, "body", name)]
        if joint < 0 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            raise UserError(f"body {name!r} is not on a free joint")
        start = int(model.jnt_qposadr[joint])
        return slice(start, start + 7)

    def __deepcopy__(self, memo: dict[int, Any]) -> "Scene":
        """The scene itself."""
        return self


def build_scene(
    stock: Any, sensors: Sensors, control_freq: int = 20, fidelity: Fidelity = "exact"
) -> Scene:
    """Compile the scene of a stock environment made by `make_stock`.

    Args:
        stock: the robosuite environment.
        sensors: what the task reads and sets.
        control_freq: control frequency [Hz].
        fidelity: "exact" is robosuite's own physics (2 ms); "fast", for training and
            sweeps, steps 5 ms where the gripper stays stable, and leaves out the
            collisions of the arm's links that touch no other in the default pose, and
            of parked bodies with the floor.

    Raises:
        UserError: a sensor names something that the environment's model lacks.
    """
    layout = read_scene_layout(stock, sensors)
    hand = hand_kind(stock.robots[0])
    coarse = fidelity == "fast" and hand not in _UNSTABLE_AT_FAST_DT
    dt = FAST_DT if coarse else PHYSICS_DT
    spec = _physics(stock, fidelity, dt)
    if fidelity == "fast":
        _exclude_from_floor(spec, sensors.parked)
    touch_of_sensor: list[int] = []
    for index, touch in enumerate(layout.touches):
        touch_of_sensor += [index] * _add_touch_sensors(spec, touch)
    for site in sensors.forces.values():
        _add_force_sensor(spec, site)
    physics = spec.compile()
    slots = (*layout.slots, *force_slots(physics, sensors.forces))
    return Scene(
        physics=physics,
        visual=stock.sim.model._model,
        stock=stock,
        layout=replace(layout, slots=slots),
        physics_fields=physics_field_slots(physics, sensors.fields),
        touch_of_sensor=np.array(touch_of_sensor, dtype=np.int64),
        substeps=round(1 / control_freq / dt),
        control_dt=1 / control_freq,
        parked=sensors.parked,
    )


def load_scene(
    name: str,
    sensors: Sensors,
    robot: RobotConfig = PANDA,
    fidelity: Fidelity = "exact",
    seed: int | None = 0,
) -> Scene:
    """Build the stock environment `name` and its scene.

    The seed fixes what robosuite samples at construction (Lift's cube size); the other
    arguments are those of `make_stock` and `build_scene`.
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
    """Delete geoms that cannot collide, and meshes that only they used."""
    free = _free_arm_bodies(stock) if fidelity == "fast" else set()
    for geom in list(spec.geoms):
        collides = geom.contype or geom.conaffinity
        if not collides or geom.parent.name in free:
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


def _free_arm_bodies(stock: Any) -> set[str]:
    """Names of the arms' bodies that touch no other one of them in the default pose.

    The Sawyer's first link rests on its base, and the friction holds the first joint.
    """
    model = stock.sim.model._model
    data = mujoco.MjData(model)
    data.qpos[:] = default_qpos(stock)
    mujoco.mj_forward(model, data)
    prefixes = tuple(robot.robot_model.naming_prefix for robot in stock.robots)
    names = np.array([model.body(number).name for number in range(model.nbody)])
    of_arm = np.array([name.startswith(prefixes) for name in names])
    pairs = model.geom_bodyid[data.contact.geom]
    touching = pairs[of_arm[pairs].all(axis=1)]
    return set(names[of_arm]) - set(names[touching].ravel())


def _exclude_from_floor(spec: mujoco.MjSpec, parked: tuple[str, ...]) -> None:
    """Make bodies fall through the floor: resting on it would cost contacts."""
    for body in parked:
        spec.add_exclude(bodyname1="world", bodyname2=body)


def _add_touch_sensors(spec: mujoco.MjSpec, touch: Touch) -> int:
    """Add one contact sensor for each pair of sides; return the number of sensors."""
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
    """Names of a side; of its geoms, those that are in the physics model."""
    if side.geoms:
        return [name for name in side.geoms if spec.geom(name)]
    return [side.body or ""]
