"""The training loop: one for all algorithms. Collect, learn, evaluate, save."""

import signal
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import torch
import yaml

from manip.errors import UserError
from manip.evaluation.episodes import Episode, run_episodes
from manip.evaluation.report import summarise
from manip.files import write_text
from manip.training.build import (
    build_agent,
    evaluation_env,
    overlaps,
    policy_of,
    training_env,
)
from manip.training.checkpoint import load_checkpoint, save_checkpoint
from manip.training.config import TrainConfig, to_dict
from manip.training.logs import RunLog
from manip.training.progress import TrainingProgress
from manip.training.rollout import Collector
from manip.versions import versions

RECENT = 100
"""Finished training episodes that the progress line averages over."""


class Trainer:
    """A training run in a run folder.

    Attributes:
        env_steps: control steps taken so far, all worlds together.
        stopping: set by Ctrl-C or SIGTERM: the run saves and leaves.
    """

    def __init__(self, config: TrainConfig) -> None:
        torch.set_num_threads(1)
        self.config = config
        self.folder = config.folder
        self.latest = self.folder / "checkpoints" / "latest.safetensors"
        _check_folder(self.folder, self.latest, config.resume)
        self.env = training_env(config)
        self.judge = evaluation_env(config)
        self.agent = build_agent(config, self.env)
        self._collector = Collector(self.env, self.agent, overlaps(config))
        self._recent: deque[Episode] = deque(maxlen=RECENT)
        self._learned: dict[str, float] = {}
        self.env_steps = 0
        self.seconds = 0.0
        self._best = (-1.0, -np.inf)
        if config.resume:
            self._resume()
        self._log = RunLog(self.folder, self.env_steps, config.wandb)
        self.stopping = False

    def run(self) -> bool:
        """Train to the end; False if it was stopped on the way (and saved)."""
        self._write_config()
        stages = self.env.worlds.task.stages
        with (
            _Interruptible(self._stop),
            TrainingProgress(self.config.steps, self.env_steps, stages) as progress,
        ):
            self._train(progress)
        return not self.stopping

    def _train(self, progress: TrainingProgress) -> None:
        began = time.monotonic() - self.seconds
        saved = time.monotonic()
        while self.env_steps < self.config.steps and not self.stopping:
            due = self._next_evaluation()
            self._advance()
            self.seconds = time.monotonic() - began
            progress.update(self.env_steps, self._training_averages())
            if self.env_steps >= due:
                self._evaluate(progress)
            if self.env_steps >= due or time.monotonic() - saved > self._save_every:
                self._save(self.latest)
                saved = time.monotonic()
        self._save(self.latest)
        if self.stopping:
            progress.say(
                f"stopped and saved at step {self.env_steps:,}; continue with "
                f"--resume --out {self.folder}"
            )

    def _advance(self) -> None:
        found = self._collector.next()
        self.env_steps += found.batch.numel()
        self._recent.extend(found.episodes)
        self._set_learning_rates()
        self._learned |= self.agent.update(found.batch)

    def _set_learning_rates(self) -> None:
        left, last = 1 - self.env_steps / self.config.steps, self.config.cool_down
        share = left / last if left < last else 1.0
        for optimiser in self.agent.optimisers().values():
            for group in optimiser.param_groups:
                group["lr"] = share * group.setdefault("initial_lr", group["lr"])

    def _next_evaluation(self) -> int:
        every = self.config.eval_every
        return min((self.env_steps // every + 1) * every, self.config.steps)

    def _evaluate(self, progress: TrainingProgress) -> None:
        policy = policy_of(self.agent, self.config, self.env, self.env_steps)
        self.judge.worlds.restart()
        found = summarise(
            run_episodes(self.judge, policy, self.config.eval_episodes),
            self.judge.worlds.task.stages,
        )
        held, mean = found["success"]["held"].rate, found["return_mean"]
        values = {f"eval/{kind}": rate.rate for kind, rate in found["success"].items()}
        values |= {"eval/return": mean}
        values |= {f"eval/{stage}": share for stage, share in found["stages"].items()}
        self._record(values, progress)
        line = f"step {self.env_steps:>9,}  {self.seconds:6.0f} s  held {held:4.0%}"
        shares = "  ".join(f"{s} {share:.0%}" for s, share in found["stages"].items())
        progress.say(f"{line}  return {mean:5.1f}  ever {shares}")
        if (held, mean) > self._best:
            self._best = (held, mean)
            policy.save(self.folder / "policy")
            self._save(self.folder / "checkpoints" / "best.safetensors")

    def _record(self, values: dict[str, float], progress: TrainingProgress) -> None:
        speed = progress.speed(self.env_steps)
        row = {"seconds": self.seconds, "steps_per_second": speed}
        row |= {"broken_worlds": self.env.worlds.engine.broken_count}
        row |= self._training_averages() | values
        row |= {f"learn/{name}": value for name, value in self._learned.items()}
        self._log.write(self.env_steps, row)

    def _training_averages(self) -> dict[str, float]:
        if not self._recent:
            return {}
        stages = np.mean([episode.stages for episode in self._recent], axis=0)
        return {
            "train/return": float(np.mean([e.total_reward for e in self._recent])),
            "train/success": float(np.mean([e.at_end for e in self._recent])),
            **{
                f"train/{name}": float(share)
                for name, share in zip(self.env.worlds.task.stages, stages, strict=True)
            },
        }

    def _save(self, path: Path) -> None:
        progress = {
            "env_steps": self.env_steps,
            "seconds": self.seconds,
            "best": list(self._best),
            "learned": self._learned,
            "recent": [asdict(episode) for episode in self._recent],
        }
        save_checkpoint(path, self.agent, self._collector, progress)

    def _resume(self) -> None:
        progress = load_checkpoint(self.latest, self.agent, self._collector)
        try:
            self._take_up(progress)
        except (KeyError, TypeError, ValueError) as error:
            raise UserError(f"{self.latest} is damaged: {error!r}") from error

    def _take_up(self, progress: dict[str, Any]) -> None:
        self.env_steps = int(progress["env_steps"])
        self.seconds = float(progress["seconds"])
        self._best = tuple(progress["best"])
        self._learned = progress["learned"]
        self._recent.extend(Episode(**episode) for episode in progress["recent"])

    def _write_config(self) -> None:
        text = yaml.safe_dump(to_dict(self.config) | {"versions": versions()})
        write_text(self.folder / "config.yaml", text)

    def _stop(self) -> None:
        self.stopping = True

    @property
    def _save_every(self) -> float:
        return self.config.checkpoint_every


def _check_folder(folder: Path, latest: Path, resume: bool) -> None:
    if resume and not latest.is_file():
        raise UserError(f"nothing to resume: there is no {latest}")
    if not resume and latest.is_file():
        raise UserError(
            f"{folder} already holds a run: continue it with --resume, or choose "
            "another folder with --out"
        )


class _Interruptible:
    """While inside, the first Ctrl-C or SIGTERM calls `stop`; a second one kills."""

    SIGNALS: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM)

    def __init__(self, stop: Callable[[], None]) -> None:
        self._stop_run = stop

    def __enter__(self) -> None:
        self._before = {s: signal.signal(s, self._handle) for s in self.SIGNALS}

    def __exit__(self, *_: object) -> None:
        self._restore()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self._restore()
        self._stop_run()

    def _restore(self) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
