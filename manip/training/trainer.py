"""The training loop: one for all algorithms. Collect, learn, evaluate, save."""

import time
import warnings
from collections import deque
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from manip.errors import UserError, one_line
from manip.evaluation.episodes import Episode, run_episodes
from manip.evaluation.report import summarise
from manip.io.atomic_files import remove_partial, write_text
from manip.training.build import (
    build_agent,
    evaluation_env,
    overlaps,
    policy_of,
    training_envs,
)
from manip.training.checkpoint import Checkpoints, Saving, restore, size_of, state_of
from manip.training.collector import Collector
from manip.training.config import TrainConfig, check_lasting, lasting, to_dict
from manip.training.lifecycle import Interruptible, locked
from manip.training.nan_guard import NanGuard
from manip.training.progress import TrainingProgress
from manip.training.run_logs import Row, RunLog, check_wandb
from manip.versions import versions

RECENT = 100
"""Finished training episodes that the progress line averages over."""

MOST_TOLD = 20
"""Faults that a run tells of, one by one; metrics.csv counts them all."""


class Trainer:
    """A training run in a run folder.

    Attributes:
        env_steps: control steps taken so far, all worlds together.
        seconds: wall time so far, with evaluations.
        cpu_seconds: computing time so far, without evaluations, of all threads.
        stopping: set by Ctrl-C or SIGTERM: the run saves and leaves.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.set_num_threads(1)
        self.config = config
        self.folder = config.folder
        self.checkpoints = Checkpoints(self.folder)
        _check_folder(self.folder, self.checkpoints, config.resume)
        check_wandb(config.wandb)
        self.envs = training_envs(config)
        self.judge = evaluation_env(config)
        self.agent = build_agent(config, self.judge)
        self._guard = NanGuard(self.agent.optimisers(), config.faults == "stop")
        self._collector = Collector(self.envs, self.agent, overlaps(config))
        self._recent: deque[Episode] = deque(maxlen=RECENT)
        self._learned: dict[str, float] = {}
        self.env_steps = 0
        self.seconds = 0.0
        self.cpu_seconds = 0.0
        self._best = (-1.0, -np.inf)
        self._saving = Saving(config.checkpoint_every)
        self._told = 0
        self.stopping = False

    def run(self) -> bool:
        """Train to the end; False if it was stopped on the way (and saved).

        Raises:
            UserError: there is nothing to resume, or it was begun with other options;
                another process is at work in the folder; disk or memory are full.
        """
        milestones = self.judge.batch.task.milestone_names
        with locked(self.folder), Interruptible(self._stop):
            rows = self._resume() if self.config.resume else []
            remove_partial(self.folder)
            try:
                self._write_config()
                with (
                    RunLog(self.folder, rows, self.config.wandb) as self._log,
                    TrainingProgress(
                        self.config.steps, self.env_steps, milestones
                    ) as bar,
                ):
                    self._train(bar)
            except (OSError, MemoryError) as error:
                told = one_line(error) or "not enough memory"
                raise UserError(f"{told}{self._how_to_go_on()}") from error
            except UserError as error:
                raise UserError(f"{error}{self._how_to_go_on()}") from error
        return not self.stopping

    def _train(self, progress: TrainingProgress) -> None:
        began = time.monotonic() - self.seconds
        while self.env_steps < self.config.steps and not self.stopping:
            due = self._next_evaluation()
            used = time.process_time()
            self._advance()
            self.cpu_seconds += time.process_time() - used
            self._tell_faults(progress)
            self.seconds = time.monotonic() - began
            progress.update(self.env_steps, self._training_averages())
            if self.env_steps >= due:
                self._save(best=self._evaluate(progress))
            elif self._saving.due():
                self._save()
        if self.stopping:
            self._save()
            progress.say(f"stopped at step {self.env_steps:,}{self._how_to_go_on()}")
        progress.say(self._saving.cost(self.checkpoints.latest))

    def _advance(self) -> None:
        found = self._collector.next()
        self.env_steps += found.steps
        self._recent.extend(found.episodes)
        self._set_learning_rates()
        self._learned |= self._guard.finite(self.agent.update(found.batch))

    def _set_learning_rates(self) -> None:
        left = max(0.0, 1 - self.env_steps / self.config.steps)
        last = self.config.cool_down
        share = left / last if left < last else 1.0
        for optimiser in self.agent.optimisers().values():
            for group in optimiser.param_groups:
                group["lr"] = share * group.setdefault("initial_lr", group["lr"])

    def _tell_faults(self, progress: TrainingProgress) -> None:
        """Say what went wrong since the last call, as long as that is news."""
        faults, lost = [env.batch.faults for env in self.envs], self._guard.lost
        notes = [
            f"{queue.popleft()}: its episode is lost"
            for queue in faults
            for _ in range(len(queue))
        ]
        notes += [f"{lost.popleft()}: the update is lost" for _ in range(len(lost))]
        for note in notes[: MOST_TOLD - self._told]:
            progress.say(note)
            self._told += 1

    def _next_evaluation(self) -> int:
        every = self.config.eval_every
        return min((self.env_steps // every + 1) * every, self.config.steps)

    def _evaluate(self, progress: TrainingProgress) -> bool:
        """Judge the policy, and keep it if it is the best so far; whether it is."""
        policy = policy_of(self.agent, self.config, self.judge, self.env_steps)
        self.judge.batch.restart()
        found = summarise(
            run_episodes(self.judge, policy, self.config.eval_episodes),
            self.judge.batch.task.milestone_names,
        )
        held, mean = found["success"]["success_held"].rate, found["return_mean"]
        values = {f"eval/{kind}": rate.rate for kind, rate in found["success"].items()}
        values |= {"eval/return": mean}
        values |= {
            f"eval/{stage}": share for stage, share in found["milestones"].items()
        }
        self._record(values, progress)
        line = f"step {self.env_steps:>9,}  {self.seconds:6.0f} s  held {held:4.0%}"
        shares = "  ".join(
            f"{s} {share:.0%}" for s, share in found["milestones"].items()
        )
        progress.say(f"{line}  return {mean:5.1f}  ever {shares}")
        best = (held, mean) > self._best
        if best:
            self._best = (held, mean)
            policy.save(self.folder / "policy")
        return best

    def _record(self, values: dict[str, float], progress: TrainingProgress) -> None:
        speed = progress.speed(self.env_steps)
        row = {"seconds": self.seconds, "cpu_seconds": self.cpu_seconds}
        lost = sum(env.batch.fault_count for env in self.envs)
        row |= {"steps_per_second": speed, "faults": lost + self._guard.count}
        row |= self._training_averages() | values
        row |= {f"learn/{name}": value for name, value in self._learned.items()}
        self._log.write(self.env_steps, row)

    def _training_averages(self) -> dict[str, float]:
        if not self._recent:
            return {}
        names = self.judge.batch.task.milestone_names
        milestones = np.mean([episode.milestones for episode in self._recent], axis=0)
        return {
            "train/return": float(np.mean([e.total_reward for e in self._recent])),
            "train/success": float(np.mean([e.success_at_end for e in self._recent])),
            **{
                f"train/{name}": float(share)
                for name, share in zip(names, milestones, strict=True)
            },
        }

    def _save(self, best: bool = False) -> None:
        progress = {
            "env_steps": self.env_steps,
            "seconds": self.seconds,
            "cpu_seconds": self.cpu_seconds,
            "best": list(self._best),
            "lost_updates": self._guard.count,
            "learned": self._learned,
            "recent": [asdict(episode) for episode in self._recent],
            "rows": self._log.rows,
        }
        state = state_of(self.agent, self._collector, self.config.save_buffer)
        state |= {"config": lasting(self.config), "versions": versions()}
        self._saving.buffer = size_of(state["agent"].get("buffer"))
        with self._saving:
            self.checkpoints.save(state | {"progress": progress}, best)

    def _resume(self) -> list[Row]:
        """Go back to where the run was last saved; what it had logged till then."""
        state = self.checkpoints.load()
        try:
            check_lasting(state["config"], self.config)
            _compare_versions(state["versions"])
            restore(state, self.agent, self._collector)
            _compare_buffer(state["agent"])
            return self._take_up(state["progress"])
        except UserError:
            raise
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise UserError(
                f"the checkpoint in {self.folder} is damaged: {error!r}"
            ) from error

    def _take_up(self, progress: dict[str, Any]) -> list[Row]:
        self.env_steps = int(progress["env_steps"])
        self.seconds = float(progress["seconds"])
        self.cpu_seconds = float(progress["cpu_seconds"])
        self._best = tuple(progress["best"])
        self._guard.count = int(progress["lost_updates"])
        self._learned = progress["learned"]
        self._recent.extend(Episode(**episode) for episode in progress["recent"])
        rows: list[Row] = progress["rows"]
        return rows

    def _how_to_go_on(self) -> str:
        if not self.checkpoints.exist():
            return ""
        return f"; the run is saved, continue with --resume --out {self.folder}"

    def _write_config(self) -> None:
        text = yaml.safe_dump(to_dict(self.config) | {"versions": versions()})
        write_text(self.folder / "config.yaml", text)

    def _stop(self) -> None:
        self.stopping = True


def begin_or_resume(config: TrainConfig) -> Trainer:
    """A new run, or the one that its folder holds."""
    resume = Checkpoints(config.folder).exist()
    return Trainer(replace(config, resume=resume))


def _check_folder(folder: Path, checkpoints: Checkpoints, resume: bool) -> None:
    if resume and not checkpoints.exist():
        raise UserError(f"nothing to resume: there is no {checkpoints.latest}")
    if not resume and checkpoints.exist():
        raise UserError(
            f"{folder} already holds a run: continue it with --resume, or choose "
            "another folder with --out"
        )


def _compare_buffer(state: dict[str, Any]) -> None:
    """Say that the agent's replay buffer was not saved, if it has one."""
    if "buffer" in state and state["buffer"] is None:
        warnings.warn(
            "the checkpoint holds no replay buffer: it is filled anew, and the run "
            "does not go on bit for bit",
            stacklevel=2,
        )


def _compare_versions(recorded: dict[str, str]) -> None:
    """Say what the run was saved by, if by something else."""
    changed = [
        f"{package} was {recorded.get(package)}, is {now}"
        for package, now in versions().items()
        if recorded.get(package) != now
    ]
    if changed:
        warnings.warn(
            f"{'; '.join(changed)}: the run goes on, but not as it would have bit for "
            "bit",
            stacklevel=2,
        )
