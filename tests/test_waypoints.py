"""Waypoints: generated states in the middle of a task, and the starts from them."""

from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest
from sameness import assert_same
from training_runs import assert_equal_runs, new_trainer, stop_after, tiny

from manip.agents.policy import load_policy
from manip.envs import RobotConfig, make_batch, waypoint_states
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Start, Waypoint
from manip.envs.task_registry import load_task
from manip.envs.waypoint_starts import NONE, WaypointStarts, WaypointStates
from manip.envs.waypoint_states import WaypointMaker, make_waypoint_states
from manip.errors import UserError
from manip.sim.batch_engine import BatchEngine
from manip.sim.inverse_kinematics import InverseKinematics
from manip.sim.placed_states import penetration, weightless
from manip.sim.scene import Scene
from manip.tasks.cube import grasp_cube
from manip.tasks.lift import Lift
from manip.tasks.rotations import tool_rotation

Array = np.ndarray
FREE = mujoco.mjtJoint.mjJNT_FREE
DOWN = tool_rotation(np.array([np.pi / 2]), np.zeros((1, 2)))


class Held(Lift):
    """Lift with the cube in the hand: on the table, or in the air."""

    milestone_names = ("near", "air", "lift")
    waypoint_names = ("near", "air")
    low: ClassVar[float] = 0.83

    def milestones(self, m):
        near, air = m["distance"] < 0.03, m["grasped"] & (m["height"] > 0.025)
        return {"near": near, "air": air, "lift": self.success(m)}

    def sample_waypoint(self, milestone, scene, streams) -> Waypoint:
        start = self.sample_start(scene, streams)
        cube = start.qpos[:, scene.free_qpos("cube_main")]
        cube[:, 2] = self.low if milestone == "air" else 0.8215
        return grasp_cube(scene, streams, start)


@pytest.fixture(autouse=True)
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(waypoint_states, "CANDIDATES", 8)
    monkeypatch.setattr(waypoint_states, "STATES", 6)


@pytest.fixture(scope="module")
def scene(scene_of) -> Scene:
    return scene_of(Held(), fidelity="fast")


def poses(scene: Scene, position: list[float]) -> tuple[Array, bool]:
    qpos = scene.layout.qpos[None].copy()
    solved = InverseKinematics(scene).solve(qpos, np.array([position]), DOWN)
    return qpos, bool(solved[0])


@pytest.mark.parametrize("y", [-0.3, 0.0, 0.2])
def test_inverse_kinematics_bring_the_tool_to_its_pose(scene: Scene, y: float) -> None:
    qpos, solved = poses(scene, [0.1, y, 0.95])
    engine = BatchEngine(scene, 1, threads=1)
    engine.reset(np.arange(1), qpos)
    read = engine.read()
    assert solved
    np.testing.assert_allclose(read["eef_pos"], [[0.1, y, 0.95]], atol=1e-3)
    np.testing.assert_allclose(read["eef_mat"], DOWN, atol=6e-3)
    joints = read["joint_pos"]
    assert ((joints >= read["joint_low"]) & (joints <= read["joint_high"])).all()


def test_a_pose_out_of_reach_is_not_solved(scene: Scene) -> None:
    assert not poses(scene, [2.0, 0.0, 1.0])[1]


def test_penetration_is_the_depth_of_the_deepest_contact(scene: Scene) -> None:
    qpos = np.tile(scene.layout.qpos, (2, 1))
    body, half = scene.free_qpos("cube_main"), scene.geom_size("cube_g0")[2]
    qpos[:, body] = [0, 0, 0, 1, 0, 0, 0]
    qpos[:, body.start + 2] = [0.8 + half - 0.004, 0.9]
    depth = penetration(scene, qpos, {})
    np.testing.assert_allclose(depth, [0.004, 0], atol=1e-5)
    parked = replace(scene, parked=("cube_main",))
    assert (penetration(parked, qpos, {}) == 0).all()


def test_without_gravity_an_object_stays_in_the_air(scene: Scene) -> None:
    engine = BatchEngine(weightless(scene), 1, threads=1)
    qpos = scene.layout.qpos[None].copy()
    qpos[:, scene.free_qpos("cube_main")] = [0.2, 0.2, 1.3, 1, 0, 0, 0]
    engine.reset(np.arange(1), qpos)
    for _ in range(10):
        engine.step(np.zeros((1, 7)))
    assert engine.read()["cube_pos"][0, 2] == pytest.approx(1.3, abs=1e-6)
    assert scene.physics.opt.gravity[2] == mujoco.MjOption().gravity[2]


def test_without_gravity_a_pushed_object_stops(scene: Scene) -> None:
    engine = BatchEngine(weightless(scene), 1, threads=1)
    qpos, qvel = scene.layout.qpos[None].copy(), np.zeros((1, scene.physics.nv))
    qpos[:, scene.free_qpos("cube_main")] = [0.2, 0.2, 1.3, 1, 0, 0, 0]
    qvel[0, scene.physics.jnt_dofadr[scene.physics.jnt_type == FREE]] = 0.1
    engine.set_state(np.arange(1), qpos, qvel)
    for _ in range(20):
        engine.step(np.zeros((1, 7)))
    read = engine.read()
    assert 0 < read["cube_pos"][0, 0] - 0.2 < 0.006
    assert np.abs(read["cube_linvel"]).max() < 1e-3


def test_states_hold_the_object_and_depend_on_the_seed_alone(scene: Scene) -> None:
    lines: list[str] = []
    first = make_waypoint_states(Held(), scene, 3, 1, lines.append)
    again = make_waypoint_states(Held(), scene, 3, 2)
    assert_same(first._asdict(), again._asdict())
    other = make_waypoint_states(Held(), scene, 4, 1)
    assert (first.states != other.states).any()
    assert first.states.shape[:2] == (2, 6)
    assert [line.split(":")[0] for line in lines] == ["waypoint near", "waypoint air"]
    batch = NativeBatch(Held(), 6, scene=scene, threads=1)
    batch.begin(np.arange(6))
    batch.engine.states[:] = first.states[1]
    for _ in range(10):
        step = batch.step(np.tile([0.0] * 6 + [1.0], (6, 1)))
        assert step.milestones["air"].all()


class Buried(Held):
    """The cube is in the table."""

    low = 0.78


class Successful(Held):
    """The waypoint is the task's success."""

    low = 0.9


class Named(Held):
    """The waypoint is no milestone."""

    waypoint_names = ("nera",)


class Shapeless(Held):
    """The tool's position is that of one episode."""

    def sample_waypoint(self, milestone, scene, streams) -> Waypoint:
        waypoint = super().sample_waypoint(milestone, scene, streams)
        return waypoint._replace(tool_pos=waypoint.tool_pos[0])


class Plain(Held):
    """A task without waypoints."""

    waypoint_names = ()


class Bare(Held):
    """sample_waypoint returns a start alone."""

    def sample_waypoint(self, milestone, scene, streams) -> Start:
        return self.sample_start(scene, streams)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        (Plain, "task 'Plain' has no waypoints: define waypoint_names"),
        (Named, "unknown waypoint 'nera': did you mean 'near'"),
        (Shapeless, r"sample_waypoint\(\) tool_pos has shape \(3,\), not \(8, 3\)"),
        (Bare, r"sample_waypoint\(\) returns Start, not Waypoint"),
        (Buried, r"'air' gives too few states, 6 are needed: 0 of 16 candidates"),
        (Successful, r"do not penetrate, and 0 of these last\. Mend sample_waypoint"),
    ],
)
def test_a_mistake_is_one_line(
    task, message: str, scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waypoint_states, "ROUNDS", 2)
    with pytest.raises(UserError, match=message):
        make_waypoint_states(task(), scene, 0, 1)


def states(scene: Scene, number: int = 3) -> WaypointStates:
    """Two waypoints of a few states, which the height of the cube identifies."""
    engine = BatchEngine(scene, number, threads=1)
    snapshots = []
    for first in (1.0, 2.0):
        qpos = np.tile(scene.layout.qpos, (number, 1))
        heights = first + np.arange(number) / 10
        qpos[:, scene.free_qpos("cube_main").start + 2] = heights
        engine.reset(np.arange(number), qpos)
        snapshots.append(engine.save())
    return WaypointStates(
        ("near", "air"),
        np.stack([s.states for s in snapshots]),
        np.stack([s.readings for s in snapshots]),
    )


def started(scene: Scene, fraction: float, success: list[float]) -> Array:
    """Heights [400] m of the cube in episodes that have begun from waypoints."""
    engine, ids = BatchEngine(scene, 400, threads=1), np.arange(400)
    starts = WaypointStarts(states(scene), fraction, 400)
    starts.success[:] = success
    starts.begin(engine, ids, EpisodeStreams(0, ids, ids))
    return engine.read()["cube_pos"][:, 2]


def test_the_share_of_waypoints_falls_as_they_succeed(scene: Scene) -> None:
    shares = [
        (started(scene, 0.8, [success, success]) > 0.95).mean()
        for success in (0.0, 0.5, 1.0)
    ]
    np.testing.assert_allclose(shares, [0.8, 0.4, 0.08], atol=0.06)


def test_a_waypoint_that_succeeds_is_drawn_less(scene: Scene) -> None:
    heights = started(scene, 1.0, [0.0, 0.75])
    assert (heights > 0.95).mean() == pytest.approx(0.625, abs=0.08)
    assert (heights > 1.9).sum() / (heights > 0.95).sum() == pytest.approx(0.2, abs=0.1)
    assert len(np.unique(heights.round(3))) == 7


def test_success_is_counted_for_the_start_of_the_episode(scene: Scene) -> None:
    starts = WaypointStarts(states(scene), 0.5, 4)
    starts._begun_at[:] = NONE, 0, 1, 0
    starts.end(np.array([True, True, False, True]), np.ones(4, bool))
    np.testing.assert_allclose(starts.success, [1 - 0.95**2, 0])


def run(batch: NativeBatch, steps: int) -> Array:
    """Step with changing actions; cube and tool of each step [steps, N, 6]."""
    draw, rows = np.random.default_rng(0), []
    for _ in range(steps):
        done = batch.step(draw.uniform(-1, 1, (batch.num_envs, 7))).done
        batch.begin(np.flatnonzero(done))
        read = batch.read()
        rows.append(np.hstack([read["cube_pos"], read["eef_pos"]]))
    return np.array(rows)


def batch_of(scene: Scene, fraction: float) -> NativeBatch:
    batch = NativeBatch(
        Held(), 16, scene=scene, threads=1, horizon=4, restart_fraction=0.5
    )
    if fraction:
        batch.waypoints = WaypointStarts(states(scene), fraction, 16)
    batch.begin(np.arange(16))
    return batch


def test_other_episodes_are_those_without_waypoints(scene: Scene) -> None:
    plain, mixed = batch_of(scene, 0.0), batch_of(scene, 0.5)
    kind = mixed.waypoints._begun_at
    assert 3 < (kind >= 0).sum() < 13
    both = [run(batch, 3)[:, kind < 0] for batch in (plain, mixed)]
    np.testing.assert_array_equal(*both)


def test_the_waypoints_are_part_of_the_saved_state(scene: Scene) -> None:
    first, second = (batch_of(scene, 0.7) for _ in range(2))
    first.waypoints.success[:] = 0.1, 0.2
    run(first, 6)
    second.load_state(first.save_state())
    np.testing.assert_array_equal(run(first, 12), run(second, 12))
    assert_same(first.save_state(), second.save_state())


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        (
            "waypoint_begun_at",
            2,
            "waypoint_begun_at of the saved state names no waypoint",
        ),
        ("waypoint_success", 1.5, "waypoint_success of the saved state is not from 0"),
    ],
)
def test_an_impossible_state_is_refused(name, value, message, scene: Scene) -> None:
    batch = batch_of(scene, 0.5)
    saved = batch.save_state()
    saved[name][0] = value
    with pytest.raises(UserError, match=message):
        batch.load_state(saved)


SHIPPED = [
    (name, waypoint)
    for name in (
        *("Lift", "NutAssembly", "NutAssemblySquare", "PickGoal", "PickPlace"),
        *("PickPlaceMilk", "Push", "Stack", "ToolHang"),
    )
    for waypoint in load_task(name).waypoint_names
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "waypoint"), SHIPPED)
def test_most_states_of_the_package_s_tasks_are_valid(
    name: str, waypoint: str, scene_of, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(waypoint_states, "CANDIDATES", 64)
    task = load_task(name)
    maker = WaypointMaker(task, scene_of(task, fidelity="fast"), 1)
    assert maker.measure(waypoint, 1).valid > 20


@pytest.mark.parametrize("robot", ["IIWA", "Kinova3"])
def test_links_of_a_gripper_may_overlap_and_joints_turn_freely(robot: str) -> None:
    """Robotiq grippers' links overlap; four of the Kinova3's joints have no limits."""
    batch = make_batch("Lift", num_envs=1, robot=RobotConfig(robot), fidelity="fast")
    counts = WaypointMaker(Lift(), batch.scene, 0, 1).try_out("grasp", 0).counts
    assert counts.reached == counts.free == waypoint_states.CANDIDATES
    assert counts.valid > waypoint_states.CANDIDATES / 2


def test_a_run_starts_from_waypoints_and_resumes_bit_for_bit(tmp_path: Path) -> None:
    options = {"task": "test_waypoints:Held", "waypoint_fraction": 0.8}
    options |= {"steps": 256, "eval_every": 256, "curve_episodes": 0}
    config = tiny("sac", tmp_path / "whole", **options)
    whole = new_trainer(config)
    assert whole.run()
    assert (whole.parts.envs[0].batch.waypoints._begun_at >= 0).any()
    assert whole.parts.evaluator.env.batch.waypoints is None
    assert load_policy(config.folder).card.waypoint_fraction == 0.8
    config = replace(config, out=tmp_path / "parts")
    first = new_trainer(config)
    stop_after(first, 5)
    assert not first.run()
    assert new_trainer(replace(config, resume=True)).run()
    assert_equal_runs(whole.folder, config.folder)


def test_a_run_needs_waypoints_on_the_batch_engine(tmp_path: Path) -> None:
    for task, message in (
        ("Reach", "task 'Reach' has no waypoints"),
        ("dm_control/lift_brick_features", "is not on the batch engine"),
    ):
        options = {"task": task, "waypoint_fraction": 0.5}
        if "/" in task:
            options |= {"fidelity": "exact", "reward": "stock", "robot": "Jaco"}
            options |= {"controller": "JOINT_VELOCITY", "control_freq": 25}
        with pytest.raises(UserError, match=message):
            new_trainer(tiny("sac", tmp_path / "none", **options))
