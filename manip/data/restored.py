"""Observations and rewards of an episode from its states, on the batch engine.

Contacts and positions are those of the states; during the recording they were one step
of the simulation older (see `manip.sim.batch_engine`).
"""

from dataclasses import replace

import numpy as np

from manip.data.stored_episode import StoredEpisode
from manip.envs.backends.native_batch import NativeBatch
from manip.errors import UserError

Array = np.ndarray


def restored(batch: NativeBatch, episode: StoredEpisode) -> StoredEpisode:
    """The episode with what the task observes and pays in its states.

    Args:
        batch: environments of the task, which are set to the states.
        episode: with states of robosuite [T + 1, 1 + nq + nv] or [T, ...]; in the
            second case the last step is left out.

    Raises:
        UserError: the states are of another model, or do not determine what the task
            observes.
    """
    states = _checked_states(batch, episode)
    steps = min(episode.steps, len(states) - 1)
    episode = _cut(episode, steps)
    command = _gripper_commands(batch, episode.action)
    rows = [
        _observe(batch, states[i : i + batch.num_envs], states[0], command[i:])
        for i in range(0, steps + 1, batch.num_envs)
    ]
    observation, reward, success = (
        np.concatenate(each) for each in zip(*rows, strict=True)
    )
    return replace(
        episode, observation=observation, reward=reward[1:], success=success[1:]
    )


def _checked_states(batch: NativeBatch, episode: StoredEpisode) -> Array:
    model, sensors = batch.scene.physics, batch.task.sensors
    width = 1 + model.nq + model.nv
    states = episode.states
    if states is None or states.shape[1] != width or len(states) < 2:
        shape = None if states is None else states.shape
        raise UserError(
            f"states have shape {shape}, expected [T, {width}] of {batch.task.name} "
            f"with {batch.robot.arm}"
        )
    if not np.isfinite(states).all():
        raise UserError("states hold numbers that are not finite")
    if sensors.fields or sensors.memory or sensors.forces:
        raise UserError(
            f"states of {batch.task.name} do not say where its goal or what is left to "
            "do is: use a data set that `manip record` wrote"
        )
    if episode.action.shape[1] != batch.action_dim:
        raise UserError(
            f"actions have {episode.action.shape[1]} numbers, not {batch.action_dim}"
        )
    return states


def _cut(episode: StoredEpisode, steps: int) -> StoredEpisode:
    return replace(
        episode,
        observation=episode.observation[: steps + 1],
        action=episode.action[:steps],
        label=episode.label[:steps],
        reward=episode.reward[:steps],
        success=episode.success[:steps],
    )


def _gripper_commands(batch: NativeBatch, action: Array) -> Array:
    """[T + 1, k]: the grippers' commands before each step and after the last."""
    speed = np.array([robot.gripper.speed for robot in batch.scene.layout.robots])
    command = np.zeros((len(action) + 1, *speed.shape))
    size = action.shape[1] // len(speed)
    for t, sign in enumerate(np.sign(action[:, size - 1 :: size, None])):
        command[t + 1] = np.clip(command[t] + speed * sign, -1, 1)
    return command.reshape(len(command), -1)


def _observe(
    batch: NativeBatch, states: Array, first: Array, command: Array
) -> tuple[Array, Array, Array]:
    """Observation [n, D], reward [n] and success [n] in states [n, 1 + nq + nv]."""
    count, nq = len(states), batch.scene.physics.nq
    joints = batch.scene.layout.joint_qpos
    batch.engine.set_state(
        np.arange(count),
        states[:, 1 : 1 + nq],
        states[:, 1 + nq :],
        start_pos=np.tile(first[1 : 1 + nq][joints], (count, 1)),
        gripper_command=command[:count],
    )
    now = batch.observe()
    return now.observation[:count], now.reward[:count], now.success[:count]
