"""Train from Python: one call, in any thread or process.

`recipe` gives tuned options, and `train` a `RunResult`:

    from manip.training.recipes import recipe
    from manip.training.run import train

    result = train(recipe("Lift", "sac"), callback=print)
"""

import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import torch

from manip.errors import UserError, shown
from manip.rewards.reward_function import EnvironmentReward, RewardFunction
from manip.training.checkpoint import Checkpoints
from manip.training.config import TrainConfig
from manip.training.memory import memory_errors
from manip.training.progress import Callback, ignore
from manip.training.run_parts import Place, here
from manip.training.trainer import Trainer


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes:
        folder: the run folder.
        env_steps: control steps taken, over all processes of the run.
        seconds: wall time of training and evaluation [s].
        finished: False if the run was stopped before its last step; it can be resumed.
        success: success_once, success_at_end and success_held of the best evaluation;
            empty before the first.
        policy: folder of the best policy; it exists from the first evaluation on.
        waiting: what the run waits for, in a line, such as answers of people; empty
            unless it ended because of it.
    """

    folder: Path
    env_steps: int
    seconds: float
    finished: bool
    success: dict[str, float]
    policy: Path
    waiting: str = ""


def train(
    config: TrainConfig,
    *,
    callback: Callback | None = None,
    reward: RewardFunction | None = None,
    stop: threading.Event | None = None,
    place: Place = here,
) -> RunResult:
    """Train a policy.

    On the main thread, Ctrl-C, SIGTERM and SIGHUP save the run and end it. On other
    threads signals keep their meaning: use `stop`. While the run goes on, torch uses
    one thread, as the sums of several would differ, and its global random generator
    belongs to the run; both are restored afterwards. Two runs at a time in one process
    share that generator and do not repeat bit for bit: use processes.

    Args:
        config: options of the run; `manip.training.recipes.recipe` gives tuned ones.
        callback: called with a `Progress` after every rollout and evaluation, on this
            thread. What it raises ends the run.
        reward: computes the reward that the agent learns from, for each rollout; the
            environment's reward by default. Called on the threads that collect.
        stop: set it to have the run save and end after its current update.
        place: where the training environments are stepped, threads of this process
            unless given. It does not change the run.

    Raises:
        UserError: an option does not fit, the folder holds another run or other files,
            or disk or memory are full.
    """
    if not isinstance(config, TrainConfig):
        raise UserError(
            f"config must be a TrainConfig, as recipe(task, algo) gives it, not "
            f"{shown(config)}"
        )
    with _torch_settings(), memory_errors():
        trainer = Trainer(
            config,
            callback or ignore,
            reward or EnvironmentReward(),
            stop or threading.Event(),
            place,
        )
        with closing(trainer):
            finished = trainer.run()
            _draw_learning_curve(trainer)
    return _result(trainer, finished)


def train_or_resume(
    config: TrainConfig,
    *,
    callback: Callback | None = None,
    stop: threading.Event | None = None,
) -> RunResult:
    """Train, or resume the run in the folder if there is one."""
    resume = Checkpoints(config.folder).exist()
    return train(replace(config, resume=resume), callback=callback, stop=stop)


def _result(trainer: Trainer, finished: bool) -> RunResult:
    folder, state = trainer.folder, trainer.state
    return RunResult(
        folder=folder,
        env_steps=state.env_steps,
        seconds=state.seconds,
        finished=finished,
        success=_success(state.rows, state.best),
        policy=folder / "policy",
        waiting=trainer.waiting,
    )


def _draw_learning_curve(trainer: Trainer) -> None:
    from manip.evaluation.learning_curve import plot_learning_curve  # matplotlib

    config, rows = trainer.config, trainer.state.rows
    title = f"{config.task}, {config.robot}, {config.method}, seed {config.seed}"
    plot_learning_curve(rows, title, trainer.folder / "learning_curve.png")


def _success(rows: Sequence[dict[str, float]], best: list[float]) -> dict[str, float]:
    """Success of the evaluation with the best score."""
    kinds = ("success_once", "success_at_end", "success_held")
    for row in rows:
        if [row.get("eval/success_held"), row.get("eval/return")] == best:
            return {kind: row[f"eval/{kind}"] for kind in kinds}
    return {}


@contextmanager
def _torch_settings() -> Iterator[None]:
    """Have torch use one thread; restore threads and random numbers afterwards."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            yield
    finally:
        torch.set_num_threads(threads)
