"""Cut the rollouts of a run into clips, and keep the latest of them."""

from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from manip.preferences.clip_source import ClipSource
from manip.preferences.clips import Clip

STEP_KEYS = ("observation", "action")
"""Keys of a step that a clip keeps for each of its steps."""

AFTER_KEYS = ("measures", "reward_terms")
"""Keys of what follows a step, kept for each step."""

START_KEYS = ("states", "readings", "motion", "elapsed", "episode")
"""Keys of a step that a clip keeps for its first one (see `TaskBatch.record`)."""


class ClipPool:
    """The latest clips of a run, cut side by side from the rollouts of N environments.

    Every L steps a clip begins in all environments. Clips in which an episode ends
    before their last step are dropped, as they would show a jump.

    Args:
        example: a rollout [N, T] of zeros with the keys, shapes and dtypes of those
            that follow: STEP_KEYS, START_KEYS, ("next", AFTER_KEYS or "states").
        length: L, steps of a clip.
        capacity: most clips that are kept.
        positions: nq, the first columns of `states` [.., S], which are the positions.
    """

    def __init__(
        self, example: TensorDictBase, length: int, capacity: int, positions: int
    ) -> None:
        self._length, self._capacity, self._positions = length, capacity, positions
        steps = self._steps(example)[:, :1]
        num_envs = len(example)
        self._open = steps.expand(num_envs, length).clone().zero_()
        self._open_steps = 0
        self._clips = _as_clips(self._open[:1]).expand(capacity).clone()
        self._added = 0

    def __len__(self) -> int:
        """Number of clips."""
        return min(self._added, self._capacity)

    @property
    def clips(self) -> TensorDictBase:
        """The clips [C], oldest first.

        STEP_KEYS and AFTER_KEYS are [C, L, ...], `qpos` [C, L + 1, nq], START_KEYS
        [C, ...], `env` [C].
        """
        first = self._added - len(self)
        rows = torch.arange(first, self._added) % self._capacity
        clips: TensorDictBase = self._clips[rows]
        return clips

    def add(self, rollout: TensorDictBase) -> None:
        """Continue the clips with a rollout [N, T] that continues the last one."""
        steps = torch.cat(
            [self._open[:, : self._open_steps], self._steps(rollout)], dim=1
        )
        whole = steps.shape[1] // self._length * self._length
        for first in range(0, whole, self._length):
            self._store(steps[:, first : first + self._length])
        self._open_steps = steps.shape[1] - whole
        self._open[:, : self._open_steps] = steps[:, whole:]

    def _steps(self, rollout: TensorDictBase) -> TensorDict:
        """What clips need of the steps [N, T] of a rollout."""
        keep = {key: rollout[key] for key in (*STEP_KEYS, *START_KEYS)}
        keep |= {key: rollout["next", key] for key in AFTER_KEYS}
        keep["qpos"] = rollout["states"][..., : self._positions]
        keep["qpos_after"] = rollout["next", "states"][..., : self._positions]
        keep["done"] = rollout["next", "done"].squeeze(-1)
        count, length = rollout.shape
        keep["env"] = torch.arange(count)[:, None].expand(count, length)
        return TensorDict(keep, rollout.shape)

    def _store(self, window: TensorDict) -> None:
        """Keep the clips among windows [N, L] that no end of an episode interrupts."""
        clips = _as_clips(window[~window["done"][:, :-1].any(1)])
        rows = (torch.arange(len(clips)) + self._added) % self._capacity
        self._clips[rows] = clips
        self._added += len(clips)

    def state(self) -> dict[str, Any]:
        """Everything that later clips depend on; of fixed shapes."""
        return {
            "clips": self._clips.to_dict(),
            "added": self._added,
            "open": self._open.to_dict(),
            "open_steps": self._open_steps,
        }

    def load_state(self, state: dict[str, Any]) -> None:
        """Restore what `state` returned.

        Raises:
            ValueError: it is of other clips, or damaged.
        """
        for own, name in ((self._clips, "clips"), (self._open, "open")):
            saved = state[name]
            if saved.keys() != own.to_dict().keys():
                raise ValueError(f"{name} hold {', '.join(saved)}")
            for key, value in saved.items():
                _copy(own[key], value, f"{name}/{key}")
        self._added, self._open_steps = state["added"], state["open_steps"]
        if self._added < 0 or not 0 <= self._open_steps < self._length:
            raise ValueError("the counters of the clips are out of range")


def _as_clips(windows: TensorDictBase) -> TensorDict:
    """Clips [C] of windows [C, L] of steps."""
    many = {key: windows[key] for key in (*STEP_KEYS, *AFTER_KEYS)}
    first = {key: windows[key][:, 0] for key in (*START_KEYS, "env")}
    qpos = torch.cat([windows["qpos"], windows["qpos_after"][:, -1:]], 1)
    return TensorDict({**many, **first, "qpos": qpos}, windows.shape[:1])


def clip_of(row: TensorDictBase, source: ClipSource, actor: str) -> Clip:
    """Make one of `ClipPool.clips` a clip to be stored.

    Args:
        source: what all clips of the run have in common.
        actor: who acted, in words.
    """
    arrays = {key: value.numpy() for key, value in row.items()}
    header = replace(
        source.header,
        env=source.first_env + int(arrays.pop("env")),
        episode=int(arrays.pop("episode")),
        step=int(arrays.pop("elapsed")),
        actor=actor,
    )
    return Clip(header, **arrays)


def cut_clips(
    rollout: TensorDictBase, length: int, source: ClipSource, actor: str
) -> list[Clip]:
    """Cut a rollout [N, T], T >= length, into clips of `length` steps.

    Args:
        rollout: see `ClipPool`.
        length: of a clip [control steps].
        source: what all clips have in common.
        actor: who acted, in words.
    """
    num_envs, steps = rollout.shape
    pool = ClipPool(rollout, length, num_envs * (steps // length), source.nq)
    pool.add(rollout)
    return [clip_of(row, source, actor) for row in pool.clips]


def _copy(own: Tensor, saved: Tensor, name: str) -> None:
    if saved.shape != own.shape or saved.dtype != own.dtype:
        raise ValueError(f"{name} are {saved.dtype} {[*saved.shape]}")
    own.copy_(saved)
