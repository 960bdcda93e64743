"""Model fields: right by name in the physics model, in images and against stock."""

from collections.abc import Mapping

import mujoco
import numpy as np
import pytest

from manip.errors import UserError
from manip.sim.batch_engine import BatchEngine
from manip.sim.fields import field_slots
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Scene, build_scene, load_scene
from manip.sim.sensors import Sensors
from manip.sim.stock_reader import stock_reader

Array = np.ndarray
SLIDE = 0.5
"""Speed [m/s] of the cube along the table at the start."""

SENSORS = Sensors(
    bodies={"cube": "cube_main"},
    sites={"top": "table_top"},
    joints={"elbow": "robot0_joint4"},
    fields={
        "colour": ("geom_rgba", "cube_g0_vis"),  # a geom that physics lacks
        "slip": ("geom_friction", "cube_g0"),
        "table_slip": ("geom_friction", "table_collision"),
        "weight": ("body_mass", "cube_main"),
        "cube_damping": ("dof_damping", "cube_joint0"),
        "armature": ("dof_armature", "robot0_joint4"),
        "stiffness": ("jnt_stiffness", "robot0_joint4"),
        "gear": ("actuator_gear", "robot0_torq_j4"),
        "lens": ("cam_fovy", "frontview"),
        "shine": ("mat_specular", "table_ceramic"),
        "mark": ("site_pos", "table_top"),
    },
)
CHANGES: Mapping[str, list[float]] = {
    "colour": [0.1, 0.9, 0.2, 1.0],
    "slip": [0.05, 0.005, 0.0001],
    "table_slip": [0.05, 0.005, 0.0001],
    "weight": [1.5],
    "cube_damping": [0.2, 0.1, 0.1, 0.01, 0.01, 0.01],
    "armature": [4.0],
    "stiffness": [30.0],
    "gear": [0.4, 0, 0, 0, 0, 0],
    "lens": [71.0],
    "shine": [0.75],
    "mark": [0.0, 0.01, -0.02],
}
IMAGES = {"colour", "lens", "shine"}


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("Lift", SENSORS, seed=3)


def owner(scene: Scene, name: str) -> tuple[Array, slice]:
    """The row of the stock model that a field names, found by MuJoCo itself."""
    array, target = SENSORS.fields[name]
    model, kind = scene.visual, array.split("_")[0]
    rows = getattr(model, array)
    if kind == "dof":
        joint = model.joint(target)
        count = 6 if joint.type[0] == mujoco.mjtJoint.mjJNT_FREE else 1
        return rows, slice(joint.dofadr[0], joint.dofadr[0] + count)
    index = getattr(model, kind)(target).id
    return rows, slice(index, index + 1)


def start(scene: Scene) -> tuple[Array, Array]:
    qpos, qvel = scene.layout.qpos.copy(), np.zeros(scene.physics.nv)
    cube = scene.free_qpos("cube_main")
    qpos[cube] = [0.0, 0.1, 0.82, 1, 0, 0, 0]
    qvel[scene.physics.joint("cube_joint0").dofadr[0] + 1] = SLIDE
    return qpos, qvel


def in_engine(scene: Scene, fields: Mapping[str, list[float]]) -> dict[str, Array]:
    """Readings after a few steps of environment 1 of 2, with fields set there only."""
    engine = BatchEngine(scene, 2, threads=1)
    qpos, qvel = start(scene)
    rows = {name: np.array([values]) for name, values in fields.items()}
    engine.reset(np.array([1]), qpos[None], rows)
    engine.set_state(np.array([1]), qpos[None], qvel[None])
    for _ in range(4):
        engine.step(np.full((2, 7), 0.3))
    return {name: values[-1:].copy() for name, values in engine.read().items()}


def in_stock(scene: Scene, fields: Mapping[str, list[float]]) -> dict[str, Array]:
    """The same in robosuite."""
    stock = scene.stock
    stock.reset()
    before = {}
    for name, values in fields.items():
        rows, index = owner(scene, name)
        before[name] = rows[index].copy()
        rows[index] = np.reshape(values, rows[index].shape)
    data = stock.sim.data._data
    data.qpos[:], data.qvel[:] = start(scene)
    data.qacc_warmstart[:], data.ctrl[:] = 0, 0
    stock.sim.forward()
    for part in stock.robots[0].part_controllers.values():
        part.initial_joint = data.qpos[scene.layout.robots[0].arm.qpos].copy()
        part.new_update = True
    for _ in range(4):
        stock.step(np.full(7, 0.3))
    read = stock_reader(stock, SENSORS)()
    for name, values in before.items():
        rows, index = owner(scene, name)
        rows[index] = values
    return read


MOTION = ("qpos", "qvel", "cube_pos", "top_pos")


@pytest.mark.parametrize("name", CHANGES)
def test_a_field_acts_as_in_stock(name: str, scene: Scene) -> None:
    field = {name: CHANGES[name]}
    if name == "slip":  # friction of a pair is the larger of the two
        field["table_slip"] = CHANGES["table_slip"]
    ours, theirs, plain = in_engine(scene, field), in_stock(scene, field), None
    for reading in MOTION:
        np.testing.assert_allclose(ours[reading], theirs[reading], atol=1e-5)
    np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-7)
    plain = in_engine(scene, {})
    changed = max(np.abs(ours[r] - plain[r]).max() for r in MOTION)
    assert (changed > 1e-4) == (name not in IMAGES | {"table_slip"}), changed


def test_fields_do_not_shift_one_another(scene: Scene) -> None:
    read = in_engine(scene, CHANGES)
    for name, values in CHANGES.items():
        np.testing.assert_allclose(read[name], [values], rtol=1e-6, err_msg=name)
    theirs = in_stock(scene, CHANGES)
    for reading in MOTION:
        np.testing.assert_allclose(read[reading], theirs[reading], atol=1e-5)


def test_fields_are_the_models_until_they_are_set(scene: Scene) -> None:
    read = BatchEngine(scene, 2, threads=1).read()
    for name in CHANGES:
        rows, index = owner(scene, name)
        expected = np.tile(rows[index].reshape(1, -1), (2, 1))
        np.testing.assert_allclose(read[name], expected, err_msg=name)


def test_fields_that_a_start_does_not_set_go_back(scene: Scene) -> None:
    used, fresh = (BatchEngine(scene, 2, threads=1) for _ in range(2))
    qpos = np.tile(scene.layout.qpos, (2, 1))
    changes = {name: np.tile(values, (2, 1)) for name, values in CHANGES.items()}
    used.reset(np.arange(2), qpos, changes)
    used.reset(np.arange(2), qpos, {"weight": changes["weight"]})
    fresh.reset(np.arange(2), qpos, {"weight": changes["weight"]})
    for engine in (used, fresh):
        engine.step(np.full((2, 7), 0.3))
    np.testing.assert_array_equal(used.states, fresh.states)


def test_images_show_every_field(scene: Scene) -> None:
    engine = BatchEngine(scene, 1)
    rows = {name: np.array([values]) for name, values in CHANGES.items()}
    engine.reset(np.array([0]), scene.layout.qpos[None], rows)
    drawn = engine.visual_model(engine.states[0])
    np.testing.assert_allclose(drawn.geom("cube_g0_vis").rgba, CHANGES["colour"])
    assert drawn.geom("cube_g0").friction[0] == CHANGES["slip"][0]
    assert drawn.cam("frontview").fovy[0] == CHANGES["lens"][0]
    assert drawn.mat("table_ceramic").specular[0] == CHANGES["shine"][0]


@pytest.mark.parametrize(
    ("field", "text"),
    [
        (("geom_contype", "cube_g0"), "unknown model array.*geom_friction"),
        (("body_subtreemass", "cube_main"), "unknown model array.*body_mass"),
        (("geom_rbound", "cube_g0"), "unknown model array.*geom_"),
        (("opt_gravity", "cube_main"), "unknown model array.*geom_friction"),
        (("tendon_range", "cube_main"), "unknown model array.*jnt_range"),
        (("dof_damping", "robot0_j4"), "unknown joint 'robot0_j4'.*robot0_joint4"),
        (("cam_fovy", "front"), "unknown camera 'front'.*frontview"),
        (("mat_rgba", "ceramic"), "unknown material 'ceramic'.*table_ceramic"),
        (("site_pos", "gripper0_right_grip_site"), "site and body share a frame"),
        (("geom_quat", "floor"), "share a frame"),
        (("light_pos", "sun"), "unknown light 'sun'"),
        (("actuator_gear", "motor"), "unknown actuator 'motor'.*robot0_torq_j4"),
    ],
)
def test_a_field_that_does_not_exist_is_refused(field, text: str, scene: Scene) -> None:
    with pytest.raises(UserError, match=text):
        build_scene(scene.stock, Sensors(fields={"x": field}))


def test_in_the_fast_fidelity_a_field_of_a_geom_it_lacks_is_for_images() -> None:
    stock = make_stock("Lift", seed=3)
    name = next(
        stock.sim.model._model.geom(i).name
        for i in range(stock.sim.model._model.ngeom)
        if stock.sim.model._model.geom(i).name.startswith("robot0_link5")
    )
    fields = {"link": ("geom_friction", name), "slip": ("geom_friction", "cube_g0")}
    engine = BatchEngine(build_scene(stock, Sensors(fields=fields), 20, "fast"), 1)
    values = {"link": np.array([[0.1, 0.2, 0.3]]), "slip": np.array([[0.4, 0.5, 0.6]])}
    engine.reset(np.array([0]), engine.scene.layout.qpos[None], values)
    engine.step(np.zeros((1, 7)))
    for field, expected in values.items():
        np.testing.assert_array_equal(engine.read()[field], expected)


@pytest.mark.parametrize("target", [None, 3, b"cube_g0"])
def test_an_object_that_is_no_name_is_refused(target, lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="unknown geom"):
        field_slots(lift_scene.visual, {"a": ("geom_friction", target)})


def test_an_unknown_array_lists_the_arrays(lift_scene: Scene) -> None:
    with pytest.raises(UserError, match="known model arrays: "):
        field_slots(lift_scene.visual, {"a": ("geom_type", "cube_g0")})
