"""The training loop, one for all algorithms: collect, learn, evaluate, save."""

import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

from manip.errors import UserError, one_line, out_of_memory
from manip.evaluation.diagnosis import diagnose
from manip.rewards.reward_function import RewardFunction
from manip.training.checkpoint import Checkpoints, SaveTimer, bytes_of
from manip.training.config import TrainConfig, to_dict
from manip.training.evaluator import PolicyEvaluation
from manip.training.experience import Experience, by_time
from manip.training.lifecycle import SignalHandler, locked
from manip.training.progress import Callback, Progress
from manip.training.resume import checkpoint_of, resume
from manip.training.run_folder import check_run_folder, prepare
from manip.training.run_logs import RunLog, check_wandb
from manip.training.run_parts import Place, build_parts, here
from manip.training.run_state import RunState
from manip.training.schedule import curve_due, extended, next_choice, row_due, rows_in


class Trainer:
    """A training run in its folder. `manip.training.run.train` is the way to run one.

    Args:
        config: options of the run.
        callback: called with a `Progress` after every rollout.
        reward: computes the reward that the agent learns from.
        stop: the run saves and ends soon after this event is set.
        place: where the training environments are stepped.

    Raises:
        UserError: the folder cannot take the run, or an option does not fit.

    Attributes:
        parts: environments, agent, collector, evaluator, guards.
        state: counters and results so far.
        stop: the event.
        waiting: what the run waits for, in a line; empty unless it ended because of it.
    """

    waiting = ""

    def __init__(
        self,
        config: TrainConfig,
        callback: Callback,
        reward: RewardFunction,
        stop: threading.Event,
        place: Place = here,
    ) -> None:
        check_run_folder(config)
        check_wandb(config.wandb)
        self.config, self.folder = config, config.folder
        self._callback, self._interrupted = callback, False
        self.parts = build_parts(config, reward, place, self._report_building)
        self.state = RunState()
        self.checkpoints = Checkpoints(self.folder)
        self.stop = stop
        self._save_timer = SaveTimer(config.checkpoint_every)

    @property
    def stopping(self) -> bool:
        """Whether a signal or the `stop` event requests the end of the run."""
        return self._interrupted or self.stop.is_set()

    def run(self) -> bool:
        """Train to the end; False if the run was stopped before (and saved).

        Raises:
            UserError: there is nothing to resume, or it was begun with other options;
                another process trains in the folder; disk or memory are full.
        """
        with locked(self.folder), SignalHandler(self._interrupt):
            self._begin()
            with self._errors_say_how_to_resume():
                prepare(self.config)
                if not self.config.resume:
                    self._save()  # from now on, a run that ends can be resumed
                options = to_dict(self.config)
                log = RunLog(self.folder, self.state.rows, options, self.config.wandb)
                with closing(log) as self._log:
                    self._train()
        return self._complete

    @property
    def _steps(self) -> int:
        """Control steps of the whole run."""
        return self.config.steps + self.state.extra_steps

    @property
    def _complete(self) -> bool:
        return self.state.env_steps >= self._steps

    def close(self) -> None:
        """End the threads that collect."""
        self.parts.collector.close()

    def _begin(self) -> None:
        if self.config.resume:
            self.state = resume(self.config, self.parts, self.checkpoints)
        self._first_step, self._began = self.state.env_steps, time.monotonic()
        self._clock = self._began - self.state.seconds

    def _train(self) -> None:
        if self.parts.notes:
            self._report(*self.parts.notes)
        if self.config.init is not None and not self.state.rows:
            self._save(best=self._evaluate())  # the initial policy may stay the best
        while not (self._complete or self.stopping or self._waits()):
            before, used = self.state.env_steps, time.process_time()
            self._advance()
            self.state.cpu_seconds += time.process_time() - used
            self.state.seconds = time.monotonic() - self._clock
            self._report(*self.parts.messages())
            self._evaluate_or_log(before)
        self._end()

    def _evaluate_or_log(self, before: int) -> None:
        """Evaluate, log and save what is due after the rollout from step `before`."""
        now, steps = self.state.env_steps, self._steps
        every = self.config.eval_every
        if now >= next_choice(before, every, steps):
            best = self._evaluate()
            self._extend()
            self._save(best)
            return
        light = curve_due(before, now, every, steps) and self.parts.evaluator.light(
            self.parts.agent, now
        )
        if light:
            self._log_evaluation(light)
        elif row_due(before, now, steps):
            self._log_row({})
        if self._save_timer.due():
            self._save()

    def _waits(self) -> bool:
        """Whether the agent waits for something that the run cannot go on without."""
        self.waiting = self.parts.agent.waiting()
        return bool(self.waiting)

    def _end(self) -> None:
        if not self._complete:
            self._save()
            steps = f"{self.state.env_steps:,}"
            reason = f": {self.waiting}" if self.waiting else ""
            self._report(f"stopped at step {steps}{reason}{self._how_to_resume()}")
        self._report(self._save_timer.describe(self.checkpoints.latest))

    def _advance(self) -> None:
        """Collect one rollout and learn from it."""
        experience = self.parts.collector.next()
        self._add(experience)
        self._set_learning_rates()
        learned = self.parts.agent.update(experience.batch)
        self.state.learned |= self.parts.guard.finite(learned)

    def _add(self, experience: Experience) -> None:
        """Add a rollout to counters and averages; log rows within it in short runs."""
        averages, begun = self.parts.averages, self.state.env_steps
        parts = rows_in(experience.steps, self._steps)
        *earlier, (_, episodes) = by_time(experience, parts)
        for steps, ended in earlier:
            averages.episodes.extend(ended)
            clocks = self._clocks(begun + steps)
            self._write_row(clocks | averages.of_episodes())
        averages.add(episodes, experience.reward_terms)
        self.state.env_steps += experience.steps

    def _set_learning_rates(self) -> None:
        """Let learning rates fall linearly to zero over the last `cool_down` share."""
        left = max(0.0, 1 - self.state.env_steps / self._steps)
        last = self.config.cool_down
        share = left / last if left < last else 1.0
        for optimiser in self.parts.agent.optimisers().values():
            for group in optimiser.param_groups:
                group["lr"] = share * group.setdefault("initial_lr", group["lr"])

    def _evaluate(self) -> bool:
        """Evaluate the policy, and save it if it is the best; return whether it is.

        With preferences or a taste the latest is: evaluations know nothing of these.
        """
        evaluation = self.parts.evaluator(self.parts.agent, self.state.env_steps)
        self._log_evaluation(evaluation)
        best = not self.state.best or evaluation.score > self.state.best
        best |= self.config.preferences is not None or bool(self.config.taste)
        if best:
            self.state.best = evaluation.score
            evaluation.policy.save(self.folder / "policy")
        return best

    def _extend(self) -> None:
        """Make the run longer if it has ended below its goal."""
        state, until = self.state, self.config.until
        extra = extended(self.config.steps, state.extra_steps)
        if not self._complete or state.best[0] >= until or extra == state.extra_steps:
            return
        state.extra_steps = extra
        self._report(
            f"success_held {state.best[0]:.1%} is below {until:.1%} (--until): "
            f"training goes on to step {self._steps:,}"
        )

    def _log_evaluation(self, evaluation: PolicyEvaluation) -> None:
        self._log_row(evaluation.row())
        milestones, steps = self.parts.milestones, self._steps
        diagnosis = diagnose(self.state.rows, milestones, steps)
        words = [diagnosis.words] if diagnosis else []
        self._report(evaluation.line(self.state.seconds), *words)

    def _log_row(self, evaluation: dict[str, float]) -> None:
        learned = self.state.learned.items()
        self._write_row(
            self._clocks(self.state.env_steps)
            | self.parts.averages.values()
            | evaluation
            | {f"learn/{name}": value for name, value in learned}
        )

    def _clocks(self, env_steps: int) -> dict[str, float]:
        return {
            "env_steps": env_steps,
            "seconds": self.state.seconds,
            "cpu_seconds": self.state.cpu_seconds,
            "steps_per_second": self._speed(),
            "faults": self.parts.faults.count(),
        }

    def _write_row(self, row: dict[str, float]) -> None:
        self.state.rows.append(row)
        self._log.write(row)

    def _save(self, best: bool = False) -> None:
        tree = checkpoint_of(self.config, self.parts, self.state)
        self._save_timer.buffer_bytes = bytes_of(tree["agent"].get("buffer"))
        with self._save_timer:
            self.checkpoints.save(tree, best)

    def _report_building(self, message: str) -> None:
        """Report before the run begins."""
        steps = self.config.steps
        self._callback(Progress(0, steps, 0.0, 0.0, messages=(message,)))

    def _report(self, *messages: str) -> None:
        state = self.state
        self._callback(
            Progress(
                env_steps=state.env_steps,
                total_steps=self._steps,
                seconds=state.seconds,
                steps_per_second=self._speed(),
                averages=self.parts.averages.values(),
                milestones=self.parts.milestones,
                messages=messages,
            )
        )

    def _speed(self) -> float:
        """Control steps a second since this process began to train."""
        seconds = max(time.monotonic() - self._began, 1e-9)
        return (self.state.env_steps - self._first_step) / seconds

    @contextmanager
    def _errors_say_how_to_resume(self) -> Iterator[None]:
        """Turn full disks and memory into `UserError`; add how to resume the run."""
        try:
            yield
        except UserError as error:
            raise UserError(f"{error}{self._how_to_resume()}") from error
        except (OSError, MemoryError, RuntimeError) as error:
            if not isinstance(error, OSError) and not out_of_memory(error):
                raise
            message = one_line(error) or "not enough memory"
            raise UserError(f"{message}{self._how_to_resume()}") from error

    def _how_to_resume(self) -> str:
        if not self.checkpoints.exist():
            return ""
        return f"; the run is saved, continue with --resume --out {self.folder}"

    def _interrupt(self) -> None:
        self._interrupted = True
