"""ClipPlayer: draw clips, and repeat them on the batch engine."""

from collections.abc import Generator
from pathlib import Path

import numpy as np

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError
from manip.preferences.clip_header import ClipHeader
from manip.preferences.clips import Clip
from manip.sim.renderer import WORKSPACE, render_frames

Array = np.ndarray


class ClipPlayer:
    """Draw and repeat clips; the engine of a task is built once, at its first clip.

    Args:
        folder: the folder of preferences that holds the clips. No code in it is run.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._batches: dict[tuple[object, ...], NativeBatch] = {}

    def frames(
        self, clip: Clip, camera: str = WORKSPACE, width: int = 480, height: int = 360
    ) -> Generator[Array, None, None]:
        """Draw a clip as T + 1 frames, uint8 [height, width, 3], with the path of the
        first hand.

        They follow each other at header.control_freq frames a second.

        Raises:
            UserError: see `render_frames`; or the clip does not fit its task.
        """
        batch = self._restored(clip)
        model, robot = batch.visual_model(0), batch.scene.layout.robots[0]
        hand = batch.scene.physics.site(robot.arm.tool).name
        return render_frames(model, clip.qpos, camera, width, height, trail=hand)

    def measure_again(self, clip: Clip) -> tuple[Array, Array]:
        """Repeat a clip's actions from its start.

        Returns:
            measures [T, M] and reward terms [T, K] float32, which equal the clip's.

        Raises:
            UserError: the clip does not fit its task.
        """
        batch = self._restored(clip)
        if clip.action.shape[1] != batch.action_dim:
            raise UserError(
                f"clip {clip.id} has actions of {clip.action.shape[1]} numbers, not "
                f"{batch.action_dim}"
            )
        measures, terms = [], []
        for action in clip.action:
            time_step = batch.step(action[None])
            measures.append(batch.measures()[0])
            terms.append([time_step.reward_terms[n][0] for n in batch.reward_names])
        return np.array(measures), np.array(terms, np.float32)

    def _restored(self, clip: Clip) -> NativeBatch:
        """One environment in the state of the clip's start."""
        batch = self._batch(clip.header)
        _check_fit(clip, batch)
        zero = np.zeros(1, np.int64)
        batch.load_state(
            {
                "states": clip.states[None],
                "readings": clip.readings[None],
                "motion": clip.motion[None],
                "elapsed": zero + clip.header.step,
                "episode": zero + clip.header.episode,
                "fault_count": 0,
            }
        )
        return batch

    def _batch(self, header: ClipHeader) -> NativeBatch:
        weights = tuple(header.reward_weights.items())
        key = header.task, header.robot_config, header.fidelity, weights
        if key not in self._batches:
            self._batches[key] = NativeBatch(
                load_task_named_by(self._folder, header.task),
                1,
                robot=header.robot_config,
                fidelity=header.fidelity,
                threads=1,
                reward=header.reward_set,
                reward_weights=header.reward_weights,
            )
        return self._batches[key]


def _check_fit(clip: Clip, batch: NativeBatch) -> None:
    if batch.measure_names != clip.header.measure_names:
        raise UserError(
            f"clip {clip.id} has the measures {', '.join(clip.header.measure_names)}, "
            f"but its task {clip.header.task} has {', '.join(batch.measure_names)}"
        )
    nq = batch.scene.physics.nq
    if clip.qpos.shape[1] != nq:
        raise UserError(
            f"clip {clip.id} has {clip.qpos.shape[1]} joint coordinates, not {nq}"
        )
