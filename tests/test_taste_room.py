"""Shipped tastes can be heeded: scripts that do succeed, and pay much less."""

from collections.abc import Callable

import numpy as np
import pytest
import torch

from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task
from manip.preferences.tastes import load_taste
from manip.tasks.experts import pick_place_expert

Array = np.ndarray
Act = Callable[[NativeBatch], Array]

NUM_ENVS = 16


def penalty(task: str, taste: str, act: Act) -> float:
    """Mean penalty of a step; at least 13 of 16 episodes succeed to their end."""
    batch = NativeBatch(load_task(task), NUM_ENVS, threads=1, seed=3)
    env = TaskEnv(batch, measures=True)
    state, steps = env.reset(), []
    for _ in range(batch.horizon):
        state["action"] = torch.from_numpy(act(batch).astype(np.float32))
        step, state = env.step_and_maybe_reset(state)
        steps.append(step["next"])
    rollout = torch.stack(steps)
    held = rollout["success"][-10:].all(0).sum()
    assert held >= 13
    measures = rollout["measures"].numpy()
    penalties = load_taste(task, taste).penalties(measures, batch.measure_names)
    return float(penalties.mean())


def expert(batch: NativeBatch) -> Array:
    return batch.expert()


def slow_and_upright(batch: NativeBatch) -> Array:
    action = batch.expert().copy()
    action[:, :3] *= 0.5
    axis = batch.read()["eef_mat"][:, [2, 5, 8]]
    action[:, 3:6] = np.clip(4 * np.cross(axis, [0, 0, -1]), -1, 1)
    return action


def x_then_y(batch: NativeBatch) -> Array:
    m = dict(batch.task.measure(batch.read()))
    along_x = np.abs(m["to_goal"][:, 0]) > 0.008
    m["to_goal"] = m["to_goal"] * np.column_stack([np.ones(NUM_ENVS), ~along_x])
    return batch.task.expert(m)


def higher(m) -> Array:
    """As the expert's `_across`, 20 cm instead of 12 cm high."""
    there = np.linalg.norm(m["to_place"], axis=1) < 0.05
    clear = there | (m["height"] > 0.17)
    down = np.where(there, 0.0, 0.2) - m["height"]
    return np.column_stack([m["to_place"] * clear[:, None], down])


@pytest.mark.slow
@pytest.mark.parametrize("taste", ["gentle", "upright"])
def test_lift_can_be_gentle_and_upright(taste: str) -> None:
    heeding = penalty("Lift", taste, slow_and_upright)
    assert heeding < 0.3 * penalty("Lift", taste, expert)


@pytest.mark.slow
def test_push_can_follow_the_edges() -> None:
    assert penalty("Push", "edge", x_then_y) < 0.2 * penalty("Push", "edge", expert)


@pytest.mark.slow
def test_the_can_can_be_carried_high_or_low(monkeypatch) -> None:
    low, high = (penalty("PickPlaceCan", taste, expert) for taste in ("low", "high"))
    monkeypatch.setattr(pick_place_expert, "_across", higher)
    heeding = penalty("PickPlaceCan", "high", expert)
    assert heeding < 0.6 * high
    assert low < 0.1 * penalty("PickPlaceCan", "low", expert)
