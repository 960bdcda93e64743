"""`manip clips`: record clips of a policy, to be compared by people."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import tyro

from manip.agents.policy import Policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.external_task import ExternalTask
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_registry import load_task
from manip.errors import UserError, at_least
from manip.io.output_paths import check_output_folder
from manip.io.printable import printable
from manip.preferences.clip_header import ClipHeader
from manip.preferences.clip_recorder import Act, Variety, record_clips
from manip.preferences.clip_source import ClipSource, not_recordable
from manip.preferences.clips import MOST_STEPS, Clip, clip_ids, load_clip, save_clip
from manip.programs import cli
from manip.robot_config import RobotConfig
from manip.training.final_evaluation import load_run

MOST_CLIPS = 10_000


@dataclass(frozen=True)
class Clips:
    """Record clips of a policy on the batch engine, to be compared with `manip label`.

    Each clip is a file in DIR/clips that can be drawn and repeated. The episodes are
    cut into clips one after the other, and each environment acts a little differently
    (see --variety), so that there is something to compare.
    """

    policy: Annotated[str, tyro.conf.Positional]
    """Run folder, policy folder, or name of a shipped policy (see `manip list`); with
    --expert, the name of a task."""
    out: Path = Path("preferences")
    """Folder of preferences; clips that it holds already are kept."""
    expert: bool = False
    """Have the task's expert act, instead of a policy."""
    count: int = 200
    """Number of clips."""
    steps: int = 20
    """Length of a clip [control steps]: 20 are a second."""
    variety: float = 0.5
    """Largest disturbance: standard deviation of the noise on actions in -1..1, and
    fraction by which the arm is slowed down. It grows over the environments from 0. A
    larger value gives clips that differ more, and fail more often."""
    seed: int = 0
    """Seed of the episodes and of the disturbances."""


def main(arguments: Sequence[str]) -> int:
    """Record the clips and print where they are."""
    options = cli.parse(Clips, arguments, "manip clips")
    torch.set_num_threads(1)
    ids = {save_clip(options.out, clip) for clip in record(options)}
    print(printable(f"{len(ids)} clips in {options.out / 'clips'}"))
    return 0


def record(options: Clips) -> list[Clip]:
    """Record the clips that the options describe.

    Raises:
        UserError: an option is out of range, or there is no such policy or expert, or
            the task does not run on the batch engine.
    """
    _check(options)
    policy, task, name = _actor(options)
    if isinstance(task, ExternalTask):
        raise not_recordable(name)
    robot = policy.card.robot_config if policy else RobotConfig()
    num_envs = max(2, -(-options.count // max(1, task.horizon // options.steps)))
    batch = make_batch(
        task,
        num_envs,
        robot=robot,
        seed=options.seed,
        cameras=policy.card.cameras if policy else None,
    )
    source = ClipSource.of(batch, name)
    _check_alike(options, source.header)
    env = TaskEnv(batch, expert=policy is None, measures=True, states=True)
    act = Variety(_act(env, policy), num_envs, options.variety, options.seed)
    clips = record_clips(env, act, source, options.steps, _words(policy))
    return _drawn(clips, options)


def _check(options: Clips) -> None:
    cli.check_range("--count", options.count, 2, MOST_CLIPS)
    cli.check_range("--steps", options.steps, 2, MOST_STEPS)
    at_least(0, "--seed", options.seed)
    if not 0 <= options.variety <= 1:
        raise UserError(f"--variety must be from 0 to 1, not {options.variety}")
    check_output_folder(options.out, "--out")


def _check_alike(options: Clips, header: ClipHeader) -> None:
    """Refuse a folder with clips that cannot be compared with those to be recorded.

    Raises:
        UserError: a clip in the folder is of another task, arm or length.
    """
    for clip_id in clip_ids(options.out)[:1]:
        clip = load_clip(options.out, clip_id)
        given = clip.header.task, *clip.header.robot_config, clip.steps
        wanted = header.task, *header.robot_config, options.steps
        if given != wanted:
            raise UserError(
                f"{options.out} holds clips of {_listed(given)}, which cannot be "
                f"compared with clips of {_listed(wanted)}: name another folder by "
                "--out"
            )


def _listed(kind: tuple[object, ...]) -> str:
    *names, frequency, steps = map(str, kind)
    return f"{', '.join(names)}, {frequency} Hz, {steps} steps"


def _actor(options: Clips) -> tuple[Policy | None, Task, str]:
    """The policy, or None for the expert; the task and its name."""
    if options.expert:
        return None, load_task(options.policy), options.policy
    policy, task = load_run(Path(options.policy))
    return policy, task, policy.card.task


def _act(env: TaskEnv, policy: Policy | None) -> Act:
    if policy is None:
        return lambda state: state["expert_action"]
    return lambda state: policy(env.parts(state))


def _words(policy: Policy | None) -> str:
    if policy is None:
        return "expert"
    card = policy.card
    return f"{card.algo} policy after {card.env_steps} steps, seed {card.seed}"


def _drawn(clips: list[Clip], options: Clips) -> list[Clip]:
    """The requested number of the clips, drawn at random without replacement."""
    rows = np.random.default_rng(options.seed).permutation(len(clips))
    return [clips[row] for row in rows[: options.count]]
