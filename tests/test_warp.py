"""MuJoCo Warp on the CPU device against the C engine; tolerances as in docs/gpu.md."""

import copy

import numpy as np
import pytest
from engines import close_in, random_actions, run, start

from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.robot_config import ROBOTS, RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.engine import Engine
from manip.sim.scene import Scene, load_scene

pytestmark = pytest.mark.slow

INSTALL = "the extra `gpu`: pip install --no-deps mujoco-warp==3.8.1 warp-lang==1.13.0"
wp = pytest.importorskip("warp", reason=INSTALL)
mjw = pytest.importorskip("mujoco_warp", reason=INSTALL)

from warp_inputs import torques  # noqa: E402

from manip.sim.warp.sizes import Sizes, sizes_of  # noqa: E402
from manip.sim.warp.warp_engine import WarpEngine  # noqa: E402

Array = np.ndarray

CONTROLLERS = ("OSC_POSE", "OSC_POSITION", "JOINT_POSITION")


def on_warp(scene: Scene, num_envs: int) -> WarpEngine:
    return WarpEngine(scene, num_envs, sizes_of(scene, None, None), "cpu")


def both(task: Task, scene: Scene, num_envs: int) -> tuple[BatchEngine, WarpEngine]:
    engines = BatchEngine(scene, num_envs, threads=1), on_warp(scene, num_envs)
    for engine in engines:
        start(task, engine)
    return engines


def test_two_robots_are_refused() -> None:
    scene = load_scene("TwoArmPegInHole", load_task("TwoArmPegInHole").sensors)
    with pytest.raises(UserError, match="MuJoCo Warp does not support 2 robots"):
        on_warp(scene, 1)


def assert_same(ours: WarpEngine, theirs: WarpEngine, env_ids=slice(None)) -> None:
    a, b = ours.save(env_ids), theirs.save(env_ids)
    np.testing.assert_array_equal(a.states, b.states)
    np.testing.assert_array_equal(a.readings, b.readings)


def largest(a: Engine, b: Engine, name: str, env_ids=slice(None)) -> float:
    return float(np.abs(a.read()[name][env_ids] - b.read()[name][env_ids]).max())


# The control laws


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_a_law_gives_the_torques_of_c_from_equal_inputs(controller: str) -> None:
    task = load_task("Lift")
    scene = load_scene("Lift", task.sensors, RobotConfig(controller=controller))
    ours, theirs, torque = torques(scene)
    scale = np.abs(torque).max()
    assert (np.abs(torque) < scene.layout.robots[0].arm.high).any()
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-6 * scale)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_law_gives_the_torques_of_c_on_every_arm(robot: str) -> None:
    scene = load_scene("Lift", load_task("Lift").sensors, RobotConfig(robot))
    ours, theirs, torque = torques(scene)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-6 * np.abs(torque).max())


# Physics


def test_a_reset_reads_as_in_c(lift: Task, lift_scene: Scene) -> None:
    native, warp = both(lift, lift_scene, 4)
    for name in ("qpos", "eef_pos", "eef_mat", "hand_quat", "cube_pos", "start_pos"):
        assert largest(native, warp, name) < 3e-6, name


def test_step1_computes_what_c_computes(lift: Task, lift_scene: Scene) -> None:
    native, warp = both(lift, lift_scene, 4)
    run(native, random_actions(5, 4))
    data, host = warp.on_device.data, lift_scene.physics
    import mujoco

    for env, state in enumerate(native.states):
        warp.set_state(
            np.array([env]), state[None, : host.nq],
            state[None, host.nq : host.nq + host.nv],
        )  # fmt: skip
    mjw.step1(warp.on_device.model, data)
    for env, state in enumerate(warp.states):
        ours = mujoco.MjData(host)
        ours.qpos[:], ours.qvel[:] = np.split(state[: host.nq + host.nv], [host.nq])
        mujoco.mj_step1(host, ours)
        mass = np.zeros((host.nv, host.nv))
        mujoco.mj_fullM(host, mass, ours.qM)
        arm = lift_scene.layout.robots[0].arm.dof
        block = np.ix_(arm, arm)
        assert np.abs(data.qM.numpy()[env][block] - mass[block]).max() < 2e-5
        bias = data.qfrc_bias.numpy()[env] - ours.qfrc_bias
        assert np.abs(bias[arm]).max() < 1e-4
        assert np.abs(data.cdof.numpy()[env] - ours.cdof)[arm].max() < 2e-6
        assert np.abs(data.site_xpos.numpy()[env] - ours.site_xpos).max() < 3e-6


def test_box_contacts_are_those_of_c(scene_of) -> None:
    import mujoco

    stack = load_task("Stack")
    scene = scene_of(stack)
    native, warp = both(stack, scene, 4)
    close_in(stack, native, 60)
    host, found = scene.physics, 0
    for env, state in enumerate(native.states):
        split = [host.nq, host.nq + host.nv]
        qpos, qvel, _ = np.split(state, split)
        warp.set_state(np.array([env]), qpos[None], qvel[None])
    contact, count = (
        warp.on_device.data.contact,
        int(warp.on_device.data.nacon.numpy()[0]),
    )
    kinds = contact.type.numpy()[:count]
    env_ids, geoms = contact.worldid.numpy()[:count], contact.geom.numpy()[:count]
    depths = contact.dist.numpy()[:count]
    for env, state in enumerate(warp.states):
        ours = mujoco.MjData(host)
        ours.qpos[:] = state[: host.nq]
        mujoco.mj_fwdPosition(host, ours)
        for pair in {tuple(sorted(p)) for p in ours.contact.geom}:
            if (host.geom_type[list(pair)] != mujoco.mjtGeom.mjGEOM_BOX).any():
                continue
            mine = [c.dist for c in ours.contact if {*c.geom} == {*pair}]
            here = (env_ids == env) & (kinds != 0)
            here &= (np.sort(geoms, axis=1) == pair).all(axis=1)
            np.testing.assert_allclose(np.sort(depths[here]), np.sort(mine), atol=1e-6)
            found += len(mine)
    assert found > 8


def test_random_steps_stay_near_c(lift: Task, lift_scene: Scene) -> None:
    native, warp = both(lift, lift_scene, 8)
    for step, action in enumerate(random_actions(50, 8)):
        native.step(action)
        warp.step(action)
        if step == 0:
            assert largest(native, warp, "joint_pos") < 5e-6
    joints = np.abs(native.read()["joint_pos"] - warp.read()["joint_pos"]).max(axis=1)
    assert np.median(joints) < 1e-4
    assert joints.max() < 1e-3
    assert largest(native, warp, "cube_pos") < 1e-3


@pytest.mark.parametrize(
    ("robot", "most"),
    [("Jaco", 5e-6), ("XArm7", 5e-6), ("IIWA", 5e-4), ("Kinova3", 5e-4)],
)
def test_a_random_step_of_other_arms(robot: str, most: float) -> None:
    task = load_task("Lift")
    native, warp = both(task, load_scene("Lift", task.sensors, RobotConfig(robot)), 4)
    action = random_actions(1, 4, native.scene.layout.action_dim)
    run(native, action)
    run(warp, action)
    assert largest(native, warp, "joint_pos") < most


def test_sawyer_is_near_c_without_the_contact_of_its_base() -> None:
    """Its first link touches the base, 1.7e-16 m deep."""
    task = load_task("Lift")
    scene = load_scene("Lift", task.sensors, RobotConfig("Sawyer"))
    base = scene.physics.body("robot0_right_arm_base_link").id
    of_base = scene.physics.geom_bodyid == base
    scene.physics.geom_contype[of_base] = scene.physics.geom_conaffinity[of_base] = 0
    native, warp = both(task, scene, 4)
    action = random_actions(1, 4)
    run(native, action)
    run(warp, action)
    assert largest(native, warp, "joint_pos") < 5e-6


@pytest.mark.parametrize("controller", CONTROLLERS[1:])
def test_other_laws_stay_near_c(controller: str) -> None:
    task = load_task("Reach")
    robot = RobotConfig(controller=controller)
    scene = load_scene(task.robosuite_name, task.sensors, robot)
    native, warp = both(task, scene, 4)
    actions = random_actions(10, 4, scene.layout.action_dim)
    run(native, actions)
    run(warp, actions)
    assert largest(native, warp, "joint_pos") < 1e-4


@pytest.mark.parametrize("name", ["Lift", "Stack"])
def test_one_step_of_the_expert_from_the_state_of_c(name: str, scene_of) -> None:
    task, differences = load_task(name), []
    native, warp = both(task, scene_of(task), 8)
    for step in range(40):
        if step % 4 == 3:
            warp.restore(native.save())
        action = task.expert(task.measure(native.read()))
        native.step(action)
        if step % 4 == 3:
            warp.step(action)
            joints = native.read()["joint_pos"] - warp.read()["joint_pos"]
            differences.append(np.abs(joints).max(axis=1))
    assert np.quantile(differences, 0.95) < 1e-5
    assert np.max(differences) < 1e-4  # a contact that begins a substep earlier


# The engine's contract


def test_it_is_an_engine(reach_scene: Scene) -> None:
    engine: Engine = on_warp(reach_scene, 1)
    assert isinstance(engine, Engine)


def test_worlds_do_not_depend_on_the_others(lift: Task, lift_scene: Scene) -> None:
    _, batch = both(lift, lift_scene, 3)
    single = on_warp(lift_scene, 1)
    begin, actions = batch.save(), random_actions(4, 3)
    run(batch, actions)
    for env in range(3):
        row = slice(env, env + 1)
        single.restore(type(begin)(begin.states[row], begin.readings[row]))
        run(single, actions[:, row])
        np.testing.assert_array_equal(single.states[0], batch.states[env])


def test_a_restored_world_replays_bit_for_bit(lift: Task, lift_scene: Scene) -> None:
    _, engine = both(lift, lift_scene, 2)
    close_in(lift, engine, 16)
    saved, actions = engine.save(), random_actions(4, 2)
    run(engine, actions)
    first = engine.save()
    engine.restore(saved)
    np.testing.assert_array_equal(engine.save().readings, saved.readings)
    run(engine, actions)
    np.testing.assert_array_equal(engine.states, first.states)
    np.testing.assert_array_equal(engine.save().readings, first.readings)


def test_a_copy_goes_on_alike_and_apart(reach: Task, reach_scene: Scene) -> None:
    _, engine = both(reach, reach_scene, 2)
    run(engine, random_actions(2, 2))
    twin = copy.deepcopy(engine)
    before = engine.save()
    run(twin, random_actions(3, 2))
    np.testing.assert_array_equal(engine.states, before.states)
    run(engine, random_actions(3, 2))
    assert_same(engine, twin)


def test_a_partial_reset_leaves_the_other_worlds_alone(
    lift: Task, lift_scene: Scene
) -> None:
    _, engine = both(lift, lift_scene, 3)
    _, untouched = both(lift, lift_scene, 3)
    actions = random_actions(6, 3)
    for one in (engine, untouched):
        run(one, actions[:3])
    start_qpos = lift_scene.layout.qpos[None]
    engine.reset(np.array([1]), start_qpos)
    np.testing.assert_allclose(engine.read()["qpos"][1], start_qpos[0], atol=1e-6)
    assert np.abs(engine.read()["qvel"][1]).max() == 0
    for one in (engine, untouched):
        run(one, actions[3:])
    assert_same(engine, untouched, np.array([0, 2]))


@pytest.mark.parametrize("kind", ["action", "state"])
def test_a_world_with_nan_is_isolated(kind: str, lift: Task, lift_scene: Scene) -> None:
    _, engine = both(lift, lift_scene, 3)
    _, healthy = both(lift, lift_scene, 3)
    for one in (engine, healthy):
        close_in(lift, one, 12)
    before = engine.save()
    actions = random_actions(3, 3)
    faulty = actions[0].copy()
    if kind == "action":
        faulty[1, 2] = np.nan
    else:
        qvel = before.states[[1], lift_scene.physics.nq :][:, : lift_scene.physics.nv]
        engine.set_state(
            np.array([1]), before.states[[1], : lift_scene.physics.nq], qvel + 1e6
        )
    now = engine.save()
    np.testing.assert_array_equal(engine.step(faulty), [False, True, False])
    np.testing.assert_array_equal(engine.states[1], now.states[1])
    np.testing.assert_array_equal(engine.save().readings[1], now.readings[1])
    healthy.step(actions[0])
    assert_same(engine, healthy, np.array([0, 2]))
    engine.restore(type(before)(before.states[[1]], before.readings[[1]]), [1])
    healthy.restore(type(before)(before.states[[1]], before.readings[[1]]), [1])
    run(engine, actions[1:])
    run(healthy, actions[1:])
    assert_same(engine, healthy)


@pytest.mark.parametrize("sizes", [Sizes(4, 64), Sizes(96, 2)])
def test_overflow_raises_with_the_size_to_give(
    sizes: Sizes, lift: Task, lift_scene: Scene
) -> None:
    with pytest.raises(UserError, match=r"give --(njmax|nconmax) \d+"):
        both_sizes(lift, lift_scene, sizes)


def both_sizes(task: Task, scene: Scene, sizes: Sizes) -> None:
    engine = WarpEngine(scene, 2, sizes, "cpu")
    start(task, engine)
    run(engine, random_actions(2, 2))


def test_fields_of_each_world_move_its_static_geoms(scene_of) -> None:
    door = load_task("Door")
    native, warp = both(door, scene_of(door), 3)
    for name in door.sensors.fields:
        assert largest(native, warp, name) < 1e-6, name
        assert np.ptp(warp.read()[name], axis=0).max() > 1e-3
    import mujoco

    data, host = warp.on_device.data, native.scene.physics
    for env in range(3):
        model = mujoco.MjModel.__copy__(host)
        for slot in native.scene.physics_fields:
            values = native.states[env, native.state_columns(slot.name)]
            flat = getattr(model, slot.array).reshape(-1)
            flat[slot.start : slot.start + slot.size] = values
        ours = mujoco.MjData(model)
        ours.qpos[:] = native.states[env, : host.nq]
        mujoco.mj_kinematics(model, ours)
        theirs = data.geom_xpos.numpy()[env]
        np.testing.assert_allclose(theirs, ours.geom_xpos, atol=3e-6)
        turns = data.geom_xmat.numpy()[env].reshape(-1, 9)
        np.testing.assert_allclose(turns, ours.geom_xmat, atol=3e-6)
