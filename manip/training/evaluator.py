"""Evaluations of the policy while a run trains."""

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any, Literal

from manip.agents.agent import Agent
from manip.agents.policy import Policy
from manip.agents.policy_card import PolicyCard
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.task_batch import TaskBatch
from manip.evaluation.episodes import run_episodes
from manip.evaluation.report import summarise
from manip.training.build import curve_env, evaluation_env, host_actor, policy_of
from manip.training.config import TrainConfig

Kind = Literal["eval", "curve"]
"""eval: chooses the best policy; curve: light, for the learning curve. The columns of
metrics.csv begin with it."""


@dataclass(frozen=True)
class PolicyEvaluation:
    """A policy and its results over the evaluation's episodes.

    Attributes:
        kind: what it was for.
        policy: as it was evaluated.
        episodes: their number.
        success: share of the episodes with success_once, success_at_end, success_held.
        mean_return: mean sum of rewards of an episode.
        milestones: share of the episodes that reached each milestone.
    """

    kind: Kind
    policy: Policy
    episodes: int
    success: dict[str, float]
    mean_return: float
    milestones: dict[str, float]

    @property
    def score(self) -> list[float]:
        """Key that compares policies of a run: success_held, then the return."""
        return [self.success["success_held"], self.mean_return]

    def row(self) -> dict[str, float]:
        """The `eval/` or `curve/` columns of metrics.csv."""
        values = self.success | {"return": self.mean_return} | self.milestones
        return {f"{self.kind}/{name}": value for name, value in values.items()}

    def line(self, seconds: float) -> str:
        """Describe the results in one line; `seconds` of training have passed."""
        light = f"  ({self.episodes} episodes)" if self.kind == "curve" else ""
        shares = "  ".join(f"{n} {share:.0%}" for n, share in self.milestones.items())
        return (
            f"step {self.policy.card.env_steps:>9,}  {seconds:6.0f} s  "
            f"success_held {self.success['success_held']:4.0%}  "
            f"return {self.mean_return:5.1f}  milestones {shares}{light}"
        )


class Evaluator:
    """Evaluate policies, each over the same episodes.

    Args:
        config: options of the run.
        training: the environments that it learns from.

    Attributes:
        env: environments of the evaluations that choose the best policy: exact physics
            and the task's own length of an episode.
    """

    def __init__(self, config: TrainConfig, training: TaskBatch) -> None:
        self._config = config
        self.env = evaluation_env(config)
        self._curve_env = curve_env(config, training)
        self._card: PolicyCard | None = None

    def __call__(self, agent: Agent, env_steps: int) -> PolicyEvaluation:
        """Evaluate an agent's policy after `env_steps` control steps of training."""
        return self._evaluate("eval", agent, env_steps, self.env)

    def light(self, agent: Agent, env_steps: int) -> PolicyEvaluation | None:
        """Evaluate it in short, over few episodes; None if the run is not to."""
        env = self._curve_env
        return env and self._evaluate("curve", agent, env_steps, env)

    def _evaluate(
        self, kind: Kind, agent: Agent, env_steps: int, env: TaskEnv
    ) -> PolicyEvaluation:
        policy = self._policy(agent, env_steps)
        env.batch.restart()
        episodes = run_episodes(env, policy, env.batch.num_envs)
        result: dict[str, Any] = summarise(episodes, env.batch.task.milestone_names)
        success = {name: rate.rate for name, rate in result["success"].items()}
        mean_return = result["return_mean"]
        values = {"episodes": len(episodes), **success}
        if isfinite(mean_return):
            values["return"] = mean_return
        return PolicyEvaluation(
            kind=kind,
            policy=replace(policy, card=replace(policy.card, evaluation=values)),
            episodes=len(episodes),
            success=success,
            mean_return=mean_return,
            milestones=result["milestones"],
        )

    def _policy(self, agent: Agent, env_steps: int) -> Policy:
        """As `policy_of`; only the steps of the card change in a run."""
        if self._card is None:
            self._card = policy_of(agent, self._config, self.env, env_steps).card
        return Policy(replace(self._card, env_steps=env_steps), host_actor(agent))
