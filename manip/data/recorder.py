"""Record whole episodes of a policy or an expert."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase

from manip.agents.demonstration import LastingNoise
from manip.data.stored_episode import StoredEpisode
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.sim.episode_model import episode_model

Array = np.ndarray

NOISE_STEPS = 10
"""Mean number of control steps for which a noise sample is used, as in `--algo bc`."""


@torch.no_grad()
def record_round(env: TaskEnv, noise: float = 0.0) -> Iterator[StoredEpisode]:
    """Record one episode of each environment.

    Args:
        env: environments that give `expert_action`: what the actor chooses.
        noise: standard deviation of the actions' noise in the last environment; it is 0
            in the first.
    """
    disturbed = LastingNoise(noise, NOISE_STEPS)
    state, steps = env.reset(), []
    before = [
        "observation",
        "expert_action",
        *(p.name for p in env.batch.cameras.parts),
    ]
    states = [_states(env)]
    fields = _fields(env)
    for _ in range(env.batch.horizon):
        action = disturbed(state["expert_action"]).clamp(-1, 1)
        step = env.step(state.select(*before).set("action", action))
        steps.append(step)
        state = step["next"]
        states.append(_states(env))
    rollout = torch.stack(steps, 1)
    for env_id in range(len(rollout)):
        rows = [row[env_id] for row in states] if states[0] is not None else None
        model_fields = {name: values[env_id] for name, values in fields.items()}
        yield _episode(env, rollout[env_id], rows, model_fields)


def _states(env: TaskEnv) -> Any:
    """[N, 1 + nq + nv]: time, qpos and qvel of all environments, or None."""
    batch = env.batch
    if not isinstance(batch, NativeBatch):
        return None
    rows, columns = batch.engine.states, batch.engine.state_columns
    time = batch.elapsed[:, None] * batch.engine.control_dt
    return np.hstack([time, rows[:, columns("qpos")], rows[:, columns("qvel")]])


def _fields(env: TaskEnv) -> dict[str, Array]:
    """Model fields of all environments' episodes: name -> [N, k]."""
    batch = env.batch
    if not isinstance(batch, NativeBatch):
        return {}
    rows, engine = batch.engine.states, batch.engine
    return {
        n: rows[:, engine.state_columns(n)].copy() for n in batch.task.sensors.fields
    }


def _episode(
    env: TaskEnv, rollout: TensorDictBase, states: Any, fields: dict[str, Array]
) -> StoredEpisode:
    """The steps [T] of one environment up to the end of its episode."""
    after = rollout["next"]
    ends = after["done"].squeeze(-1).nonzero()
    length = int(ends[0]) + 1 if len(ends) else len(rollout)
    batch = env.batch

    def with_last(name: str) -> Array:
        first, last = rollout[name][:length], after[name][length - 1 : length]
        return torch.cat([first, last]).numpy()

    return StoredEpisode(
        observation=with_last("observation"),
        action=rollout["action"][:length].numpy(),
        label=rollout["expert_action"][:length].clamp(-1, 1).numpy(),
        reward=after["reward"][:length, 0].numpy(),
        success=after["success"][:length, 0].numpy(),
        terminated=bool(after["terminated"][length - 1]),
        images={part.name: with_last(part.name) for part in batch.cameras.parts},
        states=None if states is None else np.stack(states[: length + 1]),
        fields=fields,
        model=_model(env, fields),
    )


def _model(env: TaskEnv, fields: dict[str, Array]) -> str:
    batch = env.batch
    if not isinstance(batch, NativeBatch):
        return ""
    return episode_model(batch.scene, batch.task.sensors.fields, fields)
