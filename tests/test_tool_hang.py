"""ToolHang: its tests of success, and the numbers of its docstrings."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from manip.envs.episode_streams import EpisodeStreams
from manip.rewards.compose import weighted_sum
from manip.sim.stock_reader import stock_reader
from manip.tasks.tool_hang import ToolHang
from manip.tasks.tool_hang_measures import FINGERS

Array = np.ndarray

UPRIGHT = np.array([-0.08, 0.0, 0.881]), Rotation.identity()
LYING = np.array([-0.04, -0.24, 0.8415]), Rotation.from_euler("ZX", [1.2, np.pi / 2])
STANDING = np.array([-0.03625, 0.045, 0.9455]), Rotation.from_euler("z", np.pi)
ON_TABLE = np.array([0.04, -0.2, 0.841]), Rotation.from_euler("z", -1.9)
HANGING = np.array([-0.0005, 0.045, 0.932]), Rotation.from_euler("y", np.pi / 2)


@pytest.fixture(scope="module")
def stock(scene_of) -> Any:
    stock = scene_of(ToolHang()).stock
    stock.reset()
    return stock


def place(stock: Any, **poses: tuple[Array, Rotation]) -> None:
    for name, (position, turn) in poses.items():
        pose = np.concatenate([position, turn.as_quat(scalar_first=True)])
        stock.sim.data.set_joint_qpos(f"{name}_joint0", pose)
    stock.sim.forward()


def shaken(pose: tuple[Array, Rotation], rng: np.random.Generator):
    position, turn = pose
    shake = Rotation.from_rotvec(rng.normal(0, 0.07, 3))
    return position + rng.normal(0, 0.0025, 3), shake * turn


def test_it_stands_and_hangs_where_it_does_in_stock(stock: Any) -> None:
    task, rng = ToolHang(), np.random.default_rng(0)
    read, results = stock_reader(stock, task.sensors), []
    for _ in range(150):
        poses = {"frame": STANDING, "tool": HANGING, "stand": UPRIGHT}
        place(stock, **{name: shaken(pose, rng) for name, pose in poses.items()})
        m = task.measure(read())
        ours = m["assembled"][0], m["hung"][0], task.success(m)[0]
        parts = stock._check_frame_assembled(), stock._check_tool_on_frame()
        assert ours == (*parts, stock._check_success())
        results.append(ours)
    share = np.mean(results, axis=0)
    assert ((share > 0.02) & (share < 0.98)).all()


def measure(stock: Any, frame, tool, at: Array, closing: float, touch: str = ""):
    """Measures with the gripper at `at`.

    touch: "frame" or "tool", if both finger pads touch one of them.
    """
    place(stock, stand=UPRIGHT, frame=frame, tool=tool)
    task = ToolHang()
    read = stock_reader(stock, task.sensors)()
    pads = {f"frame_{side}": float(touch == "frame") for side in ("left", "right")}
    pads |= {f"tool_{finger}": float(touch == "tool") for finger in FINGERS}
    hand = {"eef_pos": at[None], "gripper_closing": np.array([closing])}
    return task.measure({**read, **pads, **hand, "hole_touch": np.ones(1)})


def test_it_pays_as_documented_and_more_each_stage(stock: Any) -> None:
    def grip(frame: tuple[Array, Rotation]) -> Array:
        return frame[0] + frame[1].apply([0.04375, 0, 0.0525])

    up, (place, turn) = np.array([0, 0, 1.0]), STANDING
    above, half = ((place + (0.15 - z) * up, turn) for z in (0.0, 0.075))
    aside = above[0] + 0.1 * np.array([1.0, 0, 0]), turn
    raised = ON_TABLE[0] + 0.1 * up, ON_TABLE[1]
    ms = [
        measure(stock, LYING, ON_TABLE, grip(LYING) + 0.2 * up, -1),
        measure(stock, LYING, ON_TABLE, grip(LYING), -1),
        measure(stock, LYING, ON_TABLE, grip(LYING), 1, "frame"),
        measure(stock, aside, ON_TABLE, grip(aside), 1, "frame"),
        measure(stock, above, ON_TABLE, grip(above), 1, "frame"),
        measure(stock, half, ON_TABLE, grip(half), 1, "frame"),
        measure(stock, STANDING, ON_TABLE, grip(STANDING), 1, "frame"),
        measure(stock, STANDING, ON_TABLE, ON_TABLE[0], -1),
        measure(stock, STANDING, raised, raised[0], 1, "tool"),
        measure(stock, STANDING, HANGING, HANGING[0], 1, "tool"),
        measure(stock, STANDING, HANGING, HANGING[0], 0, "tool"),
        measure(stock, STANDING, HANGING, HANGING[0], -1),
    ]
    task = ToolHang()
    terms = [task.reward_terms(m, "shaped") for m in ms]
    reward = [weighted_sum(each, task.weights["shaped"])[0] for each in terms]
    length = {name: [np.linalg.norm(m[name]) for m in ms] for name in ms[0]}
    reach = 0.05 * (1 - np.tanh(5 * length["tool_distance"][6]))
    carry = 0.15 * (1 - np.tanh(5 * length["to_hook"][8]))
    over = 0.1 * (0.8 + 1 - np.tanh(2)) / 2
    frame = [0.05 * (1 - np.tanh(1)), 0.05, 0.1, 0.25 + over, 0.35, 0.425, 0.5 + reach]
    np.testing.assert_allclose(reward[:7], frame, atol=1e-4)
    tool = [0.6, 0.7 + carry, 0.9, 0.925, 1]
    np.testing.assert_allclose(reward[7:], tool, atol=1e-4)
    assert (np.diff(reward) > 0).all()
    assert [bool(task.success(m)[0]) for m in ms] == [False] * 11 + [True]


def test_parts_start_where_documented(scene_of) -> None:
    task, env_ids = ToolHang(), np.arange(500)
    scene = scene_of(task)
    qpos = task.sample_start(scene, EpisodeStreams(0, env_ids, env_ids)).qpos
    stand, frame, tool = (
        qpos[:, scene.free_qpos(f"{name}_root")] for name in ("stand", "frame", "tool")
    )
    assert np.ptp(stand, axis=0).max() == 0
    for pose, mean in (frame, [-0.04, -0.24]), (tool, [0.04, -0.2]):
        assert np.abs(pose[:, :2] - mean).max() <= 0.02
        np.testing.assert_allclose(np.ptp(pose[:, :2], axis=0), 0.04, atol=1e-3)
    turn = Rotation.from_quat(frame[:, 3:], scalar_first=True)
    flat = turn.apply([0, 1, 0])
    np.testing.assert_allclose(np.abs(flat[:, 2]), 1, atol=1e-12)
    for quat in frame[:, 3:], tool[:, 3:]:
        turn = Rotation.from_quat(quat, scalar_first=True)
        apart = (turn * turn.mean().inv()).magnitude()
        np.testing.assert_allclose(apart.max(), np.pi / 18, atol=0.01)
