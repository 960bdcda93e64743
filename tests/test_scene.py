"""Scene and readings of the batch engine, compared with the compiled models."""

import mujoco
import numpy as np
import pytest
from engines import close_in, random_actions, run, start, started

from manip.envs.task import Task
from manip.errors import UserError
from manip.robot_config import RobotConfig
from manip.sim.batch_engine import BatchEngine
from manip.sim.robosuite_factory import make_stock
from manip.sim.scene import Scene, build_scene
from manip.sim.sensors import Sensors

Array = np.ndarray


def forward(scene: Scene, qpos: Array) -> mujoco.MjData:
    data = mujoco.MjData(scene.physics)
    data.qpos[:] = qpos
    mujoco.mj_forward(scene.physics, data)
    return data


def tool(scene: Scene, qpos: Array) -> Array:
    return forward(scene, qpos).site_xpos[scene.layout.robots[0].arm.tool]


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
        tool_site = data.site_xpos[lift_scene.layout.robots[0].arm.tool]
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
        "gripper_widest": (),
        "eef_pos": (3,), "eef_mat": (9,), "hand_quat": (4,),
        "cube_pos": (3,), "cube_quat": (4,), "cube_linvel": (3,), "cube_angvel": (3,),
        "left_touch": (), "right_touch": (),
    }  # fmt: skip
    assert widths == expected


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


# Arguments and names that do not exist


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
def test_an_engine_needs_environments_and_threads(
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
    ("options", "text"),
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
def test_unknown_robots_list_what_exists(options: dict, text: str) -> None:
    with pytest.raises(UserError, match=text):
        make_stock(**({"name": "Lift"} | options))
