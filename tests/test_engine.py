"""The batch engine: worlds that do not feel each other, replayed bit for bit."""

import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Task
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Scene, build_scene
from manip.sim.sensors import Sensors

Array = np.ndarray


def start(task: Task, engine: BatchEngine, seed: int = 0) -> None:
    """Begin an episode in every world."""
    worlds = np.arange(engine.num_envs)
    streams = EpisodeStreams(seed, worlds, 0 * worlds)
    engine.reset(worlds, *task.sample_start(engine.scene, streams))


def started(task: Task, scene: Scene, num_envs: int, threads: int = 1) -> BatchEngine:
    engine = BatchEngine(scene, num_envs, threads)
    start(task, engine)
    return engine


def random_actions(steps: int, num_envs: int, action_dim: int = 7) -> Array:
    return np.random.default_rng(1).uniform(-1, 1, (steps, num_envs, action_dim))


def run(engine: BatchEngine, actions: Array) -> None:
    for action in actions:
        engine.step(action)


def close_in(task: Task, engine: BatchEngine, steps: int) -> None:
    """Let the script bring every world into contact."""
    for _ in range(steps):
        engine.step(task.expert(task.measure(engine.read())))


def assert_same(a: BatchEngine, b: BatchEngine, worlds=slice(None)) -> None:
    ours, theirs = a.save(worlds), b.save(worlds)
    np.testing.assert_array_equal(ours.states, theirs.states)
    np.testing.assert_array_equal(ours.readings, theirs.readings)


def forward(scene: Scene, qpos: Array) -> mujoco.MjData:
    data = mujoco.MjData(scene.physics)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.physics, data)
    return data


def tool(scene: Scene, qpos: Array) -> Array:
    return forward(scene, qpos).site_xpos[scene.layout.arm.tool]


# TaskBatch and threads


def test_a_batch_is_its_worlds_one_by_one(lift: Task, lift_scene: Scene) -> None:
    batch = started(lift, lift_scene, 3, threads=2)
    single = BatchEngine(lift_scene, 1)
    close_in(lift, batch, 8)
    begin, actions = batch.save(), random_actions(10, 3)
    run(batch, actions)
    for world in range(3):
        single.restore(batch_row(begin, world))
        run(single, actions[:, world : world + 1])
        np.testing.assert_array_equal(single.states[0], batch.states[world])
        np.testing.assert_array_equal(
            single.save().readings[0], batch.save().readings[world]
        )


def batch_row(snapshot, world: int):
    one = slice(world, world + 1)
    return type(snapshot)(snapshot.states[one], snapshot.readings[one])


@pytest.mark.parametrize("threads", [2, 3])
def test_the_number_of_threads_changes_no_bit(
    threads: int, lift: Task, lift_scene: Scene
) -> None:
    one, many = (started(lift, lift_scene, 20, n) for n in (1, threads))
    actions = random_actions(4, 20)
    run(one, actions)
    run(many, actions)
    assert many.threads == threads
    assert_same(one, many)


def test_no_more_threads_than_worlds(lift_scene: Scene) -> None:
    assert BatchEngine(lift_scene, 2, threads=7).threads == 2


# Save and restore


def test_a_restored_world_replays_bit_for_bit(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    close_in(lift, engine, 16)
    saved, actions = engine.save(), random_actions(5, 2)
    run(engine, actions)
    first = engine.save()
    engine.restore(saved)
    np.testing.assert_array_equal(engine.save().readings, saved.readings)
    run(engine, actions)
    np.testing.assert_array_equal(engine.states, first.states)
    np.testing.assert_array_equal(engine.save().readings, first.readings)


def test_worlds_move_to_other_places_and_engines(
    reach: Task, reach_scene: Scene
) -> None:
    here = started(reach, reach_scene, 3)
    there = started(reach, reach_scene, 5)
    actions = random_actions(3, 3)
    run(here, actions)
    there.restore(here.save(np.array([2, 0])), np.array([1, 4]))
    run(here, actions)
    for action in actions:
        wider = np.zeros((5, 7))
        wider[[1, 4]] = action[[2, 0]]
        there.step(wider)
    np.testing.assert_array_equal(there.states[[1, 4]], here.states[[2, 0]])


def test_hidden_controller_state_is_saved(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 1)
    begin = engine.read()["joint_pos"].copy()
    run(engine, np.full((3, 1, 7), 1.0))
    read = engine.read()
    np.testing.assert_array_equal(read["start_pos"], begin)
    np.testing.assert_allclose(read["gripper_command"], [[-0.6, 0.6]])
    engine.restore(engine.save())
    for name in "start_pos", "gripper_command":
        np.testing.assert_array_equal(engine.read()[name], read[name])


@pytest.mark.parametrize("hidden", ["start_pos", "gripper_command"])
def test_hidden_controller_state_steers(
    hidden: str, lift: Task, lift_scene: Scene
) -> None:
    """Else the test above would say nothing."""
    engine = started(lift, lift_scene, 2)
    engine.restore(engine.save([0, 0]))
    engine.states[1, engine.state_columns(hidden)] += 0.4
    run(engine, np.zeros((3, 2, 7)))
    one, other = engine.read()["qpos"]
    assert np.abs(one - other).max() > 1e-3


def test_a_reset_forgets_the_episode_before(lift: Task, lift_scene: Scene) -> None:
    used, fresh = (started(lift, lift_scene, 2) for _ in range(2))
    close_in(lift, used, 20)
    start(lift, used, seed=5)
    start(lift, fresh, seed=5)
    assert_same(used, fresh)
    actions = random_actions(3, 2)
    run(used, actions)
    run(fresh, actions)
    assert_same(used, fresh)


def test_a_partial_reset_leaves_the_other_worlds(lift: Task, lift_scene: Scene) -> None:
    reset, plain = (started(lift, lift_scene, 4, threads=2) for _ in range(2))
    actions = random_actions(6, 4)
    run(reset, actions[:3])
    run(plain, actions[:3])
    worlds = np.array([1])
    streams = EpisodeStreams(9, worlds, worlds)
    reset.reset(worlds, *lift.sample_start(lift_scene, streams))
    others = np.array([0, 2, 3])
    assert_same(reset, plain, others)
    run(reset, actions[3:])
    run(plain, actions[3:])
    assert_same(reset, plain, others)
    assert (reset.states[1] != plain.states[1]).any()


def test_fields_belong_to_a_world(reach: Task, reach_scene: Scene) -> None:
    engine = started(reach, reach_scene, 3)
    before = engine.read()["goal_pos"].copy()
    qpos = engine.read()["qpos"][[1]].copy()
    engine.reset(np.array([1]), qpos, {"goal_place": np.array([[0.1, 0.2, 1.0]])})
    run(engine, np.zeros((2, 3, 7)))
    goals = engine.read()["goal_pos"]
    np.testing.assert_array_equal(goals[[0, 2]], before[[0, 2]])
    np.testing.assert_array_equal(goals[1], [0.1, 0.2, 1.0])
    np.testing.assert_array_equal(engine.read()["goal_place"], goals)


def test_a_reset_without_fields_takes_the_models(
    reach: Task, reach_scene: Scene
) -> None:
    engine, fresh = started(reach, reach_scene, 2), BatchEngine(reach_scene, 2)
    goals = fresh.read()["goal_pos"]
    assert (engine.read()["goal_pos"] != goals).any()
    engine.reset(np.arange(2), engine.read()["qpos"])
    np.testing.assert_array_equal(engine.read()["goal_pos"], goals)


def test_pictures_show_the_fields_of_their_world(
    reach: Task, reach_scene: Scene
) -> None:
    engine = started(reach, reach_scene, 2)
    site = reach_scene.visual.site("goal").id
    before = reach_scene.visual.site_pos[site].copy()
    drawn = engine.visual_model(engine.states[1])
    np.testing.assert_array_equal(drawn.site_pos[site], engine.read()["goal_pos"][1])
    np.testing.assert_array_equal(reach_scene.visual.site_pos[site], before)
    assert drawn.ngeom == reach_scene.visual.ngeom > reach_scene.physics.ngeom


# When readings are of


def test_positions_are_one_substep_old_after_a_step(
    lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 1)
    run(engine, random_actions(4, 1))
    read = {name: values[0].copy() for name, values in engine.read().items()}
    before = read["qpos"].copy()
    mujoco.mj_integratePos(
        lift_scene.physics, before, read["qvel"], -lift_scene.physics.opt.timestep
    )
    lag = np.abs(tool(lift_scene, before) - read["eef_pos"]).max()
    ahead = np.abs(tool(lift_scene, read["qpos"]) - read["eef_pos"]).max()
    assert lag < 1e-12
    assert ahead > 1e-6


def test_positions_are_fresh_after_a_reset(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    close_in(lift, engine, 3)
    start(lift, engine, seed=1)
    for read_qpos, eef, cube in zip(
        *(engine.read()[name] for name in ("qpos", "eef_pos", "cube_pos")), strict=True
    ):
        data = forward(lift_scene, read_qpos)
        tool_site = data.site_xpos[lift_scene.layout.arm.tool]
        np.testing.assert_array_equal(eef, tool_site)
        np.testing.assert_array_equal(cube, data.body("cube_main").xpos)


def test_read_gives_what_its_docstring_says(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    widths = {name: values.shape[1:] for name, values in engine.read().items()}
    model = lift_scene.physics
    expected = {
        "qpos": (model.nq,), "qvel": (model.nv,), "qacc": (model.nv,),
        "joint_pos": (7,), "joint_vel": (7,), "start_pos": (7,), "rest_pos": (7,),
        "joint_low": (7,), "joint_high": (7,),
        "gripper_qpos": (2,), "gripper_qvel": (2,), "gripper_command": (2,),
        "gripper_closing": (), "gripper_speed": (), "gripper_narrowest": (),
        "eef_pos": (3,), "eef_mat": (9,), "hand_quat": (4,),
        "cube_pos": (3,), "cube_quat": (4,), "cube_linvel": (3,), "cube_angvel": (3,),
        "left_touch": (), "right_touch": (),
    }  # fmt: skip
    assert widths == expected


# Actions


def test_actions_are_clipped(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    engine.restore(engine.save([0, 0]))
    sign = np.array([1.0, -1, 1, -1, 1, -1, 1])
    run(engine, np.stack([sign, 9 * sign])[None])
    np.testing.assert_array_equal(engine.states[0], engine.states[1])


def test_only_the_sign_of_the_grip_counts(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 3)
    engine.restore(engine.save([0, 0, 0]))
    action = np.zeros((3, 7))
    action[:, -1] = [0.01, 1.0, -1.0]
    run(engine, np.stack([action] * 3))
    small, full, opening = engine.read()["gripper_qpos"]
    np.testing.assert_array_equal(small, full)
    assert np.ptp(full) < np.ptp(opening)


def test_the_callers_action_stays_as_it_is(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    action = 3 * random_actions(1, 2)[0]
    before = action.copy()
    engine.step(action)
    np.testing.assert_array_equal(action, before)


# TaskBatch that break


def nan_arm(engine: BatchEngine, action: Array) -> None:
    action[1, 2] = np.nan


def nan_grip(engine: BatchEngine, action: Array) -> None:
    action[1, -1] = np.nan


def exploded(engine: BatchEngine, action: Array) -> None:
    engine.states[1, engine.scene.physics.nq] = 1e12


def nan_state(engine: BatchEngine, action: Array) -> None:
    engine.states[1, 3] = np.nan


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("fault", [nan_arm, nan_grip, exploded, nan_state])
def test_a_broken_world_stays_alone(
    fault, threads: int, lift: Task, lift_scene: Scene
) -> None:
    ill, well = (started(lift, lift_scene, 4, threads) for _ in range(2))
    first, faulty, *rest = random_actions(4, 4)
    run(ill, [first])
    before = ill.save()
    healthy = faulty.copy()
    fault(ill, faulty)
    ill.step(faulty)
    np.testing.assert_array_equal(ill.broken, [False, True, False, False])
    assert ill.broken_count == 1
    np.testing.assert_array_equal(ill.save().readings[1], before.readings[1])
    start(lift, well)
    run(well, [first, healthy])
    ill.restore(batch_row(well.save(), 1), slice(1, 2))
    assert_same(ill, well)
    run(ill, rest)
    run(well, rest)
    assert_same(ill, well)
    assert (ill.broken_count, well.broken_count) == (1, 0)


@pytest.mark.parametrize("fault", [nan_arm, nan_grip])
def test_a_broken_world_keeps_the_state_from_before(
    fault, lift: Task, lift_scene: Scene
) -> None:
    engine = started(lift, lift_scene, 2)
    run(engine, random_actions(2, 2))
    before, action = engine.save(), np.ones((2, 7))
    fault(engine, action)
    engine.step(action)
    np.testing.assert_array_equal(engine.states[1], before.states[1])
    assert (engine.states[0] != before.states[0]).any()
    assert all(np.isfinite(values).all() for values in engine.read().values())


def test_a_broken_world_recovers_with_a_reset(lift: Task, lift_scene: Scene) -> None:
    engine = started(lift, lift_scene, 2)
    exploded(engine, np.zeros(0))
    engine.step(np.zeros((2, 7)))
    start(lift, engine, seed=1)
    engine.step(np.zeros((2, 7)))
    assert not engine.broken.any()
    fresh = BatchEngine(lift_scene, 2)
    start(lift, fresh, seed=1)
    fresh.step(np.zeros((2, 7)))
    assert_same(engine, fresh)


# Models


def test_the_physics_model_is_small(lift_scene: Scene) -> None:
    physics, visual = lift_scene.physics, lift_scene.visual
    assert physics.narena <= 64 << 20 < visual.narena
    assert physics.nbuffer * 10 < visual.nbuffer
    assert (physics.nmat, physics.ntex) == (0, 0)
    assert (physics.geom_contype | physics.geom_conaffinity).all()


def test_the_visual_model_is_stocks_own(lift_scene: Scene) -> None:
    stock = lift_scene.stock
    assert lift_scene.visual is stock.sim.model._model
    untouched = mujoco.MjModel.from_xml_string(stock.model.get_xml())
    sizes = "nq", "nv", "nu", "ngeom", "nsensor", "nmat", "ntex", "narena"
    for size in sizes:
        assert getattr(lift_scene.visual, size) == getattr(untouched, size), size


def test_the_physics_model_weighs_what_stock_does(lift_scene: Scene) -> None:
    physics, visual = lift_scene.physics, lift_scene.visual
    names = [visual.body(i).name for i in range(visual.nbody)]
    assert [physics.body(i).name for i in range(physics.nbody)] == names
    same = (
        "body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature",
        "dof_damping", "qpos0", "jnt_range", "actuator_gainprm", "actuator_biasprm",
        "actuator_ctrlrange",
    )  # fmt: skip
    for name in same:
        ours, theirs = getattr(physics, name), getattr(visual, name)
        np.testing.assert_array_equal(ours, theirs, err_msg=name)
    assert physics.opt.timestep == visual.opt.timestep == 0.002


def test_fidelity_sets_the_substeps(scene_of, lift: Task, lift_scene: Scene) -> None:
    fast = scene_of(lift, fidelity="fast")
    assert (lift_scene.substeps, fast.substeps) == (25, 10)
    assert lift_scene.control_dt == fast.control_dt == 0.05
    assert fast.physics.opt.timestep == 0.005
    assert fast.physics.ngeom < lift_scene.physics.ngeom
    np.testing.assert_array_equal(fast.physics.body_mass, lift_scene.physics.body_mass)


def test_fast_moves_as_exact_does(scene_of, lift: Task, lift_scene: Scene) -> None:
    fast = started(lift, scene_of(lift, fidelity="fast"), 2)
    exact = started(lift, lift_scene, 2)
    begin, actions = exact.read()["eef_pos"].copy(), random_actions(5, 2)
    run(fast, actions)
    run(exact, actions)
    gap = np.abs(fast.read()["eef_pos"] - exact.read()["eef_pos"]).max()
    moved = np.abs(exact.read()["eef_pos"] - begin).max()
    assert 0 < gap < 0.004 < moved


# What was asked, what exists


def test_the_shape_of_an_action_is_checked(lift_scene: Scene) -> None:
    engine = BatchEngine(lift_scene, 2)
    text = r"action has shape \(3, 7\), expected \(2, 7\), that is \(num_envs"
    with pytest.raises(UserError, match=text):
        engine.step(np.zeros((3, 7)))


@pytest.mark.parametrize(
    ("num_envs", "threads", "text"),
    [
        (0, 1, "num_envs must be at least 1, not 0"),
        (2, 0, "threads must be at least 1, not 0"),
    ],
)
def test_an_engine_needs_worlds_and_threads(
    num_envs: int, threads: int, text: str, lift_scene: Scene
) -> None:
    with pytest.raises(UserError, match=text):
        BatchEngine(lift_scene, num_envs, threads)


@pytest.mark.parametrize(
    ("sensors", "text"),
    [
        (Sensors(bodies={"x": "cube_man"}), "unknown body 'cube_man'.*'cube_main'"),
        (Sensors(sites={"x": "grip"}), "unknown site 'grip'.*grip_site"),
        (Sensors(joints={"x": "elbow"}), "unknown joint 'elbow'.*robot0_joint1"),
        (Sensors(touches={"x": ("pad", "cube_main")}), "unknown body 'pad'.*cube_main"),
        (
            Sensors(fields={"x": ("site_pos", "gaol")}),
            "unknown site 'gaol'.*table_top",
        ),
        (
            Sensors(fields={"x": ("site_place", "table_top")}),
            "unknown model array 'site_place'.*body_mass.*site_pos",
        ),
        (
            Sensors(fields={"x": ("geom_contype", "floor")}),
            "unknown model array 'geom_contype'.*geom_friction",
        ),
    ],
)
def test_unknown_sensors_list_what_exists(
    sensors: Sensors, text: str, lift_scene: Scene
) -> None:
    with pytest.raises(UserError, match=text):
        build_scene(lift_scene.stock, sensors)


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"name": "Lft"}, "unknown robosuite environment 'Lft': did you mean 'Lift'"),
        (
            {"robot": RobotConfig("panda7")},
            "unknown robot 'panda7'.*'Panda'.*known robots: IIWA",
        ),
        (
            {"robot": RobotConfig(controller="OSC")},
            "unknown controller 'OSC'.*JOINT_POSITION, OSC_POSE",
        ),
        (
            {"robot": RobotConfig(control_freq=30)},
            "control_freq 30 is not supported: choose one of 10, 20, 25, 50, 100 Hz",
        ),
        ({"robot": "Panda"}, r"robot must be RobotConfig\(arm, .* not 'Panda'"),
    ],
)
def test_unknown_robots_list_what_exists(asked: dict, text: str) -> None:
    with pytest.raises(UserError, match=text):
        make_stock(**({"name": "Lift"} | asked))


# Where compiled code is kept

COMPILE = """
import warnings
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    from manip import compiled
print(*(str(w.message) for w in caught))
print(compiled.jit(lambda x: x + 1)(1))
"""


def test_a_cache_that_cannot_be_written_is_a_warning() -> None:
    lines = in_python(COMPILE, NUMBA_CACHE_DIR=f"{os.devnull}/cache")
    assert f"{os.devnull}/cache/" in lines[0]
    assert "is not writable" in lines[0]
    assert "NUMBA_CACHE_DIR" in lines[0]
    assert lines[1] == "2"


def in_python(code: str, **environment: str) -> list[str]:
    found = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    return found.stdout.splitlines()


def test_importing_robosuite_leaves_the_gl_backend_open() -> None:
    lines = in_python(
        "import os; os.environ.pop('MUJOCO_GL', None);"
        "import manip.sim.robosuite_factory; print(os.environ.get('MUJOCO_GL'))"
    )
    assert lines[-1] == "None"
