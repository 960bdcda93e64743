"""Evaluations of the policy while a run trains."""

from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

from manip.agents.agent import Agent
from manip.agents.policy import Policy
from manip.evaluation.episodes import run_episodes
from manip.evaluation.report import summarise
from manip.training.build import evaluation_env, policy_of
from manip.training.config import TrainConfig


@dataclass(frozen=True)
class PolicyEvaluation:
    """A policy and its results over the evaluation's episodes.

    Attributes:
        policy: as it was evaluated.
        success: share of the episodes with success_once, success_at_end, success_held.
        mean_return: mean sum of rewards of an episode.
        milestones: share of the episodes that reached each milestone.
    """

    policy: Policy
    success: dict[str, float]
    mean_return: float
    milestones: dict[str, float]

    @property
    def score(self) -> list[float]:
        """Key that compares policies of a run: success_held, then the return."""
        return [self.success["success_held"], self.mean_return]

    def row(self) -> dict[str, float]:
        """The `eval/` columns of metrics.csv."""
        values = self.success | {"return": self.mean_return} | self.milestones
        return {f"eval/{name}": value for name, value in values.items()}

    def line(self, seconds: float) -> str:
        """Describe the results in one line; `seconds` of training have passed."""
        shares = "  ".join(f"{n} {share:.0%}" for n, share in self.milestones.items())
        return (
            f"step {self.policy.card.env_steps:>9,}  {seconds:6.0f} s  "
            f"success held {self.success['success_held']:4.0%}  "
            f"return {self.mean_return:5.1f}  milestones {shares}"
        )


class Evaluator:
    """Evaluate policies in exact physics, each over the same episodes.

    Attributes:
        env: the evaluation's environments.
    """

    def __init__(self, config: TrainConfig) -> None:
        self._config = config
        self.env = evaluation_env(config)

    def __call__(self, agent: Agent, env_steps: int) -> PolicyEvaluation:
        """Evaluate an agent's policy after `env_steps` control steps of training."""
        policy = policy_of(agent, self._config, self.env, env_steps)
        self.env.batch.restart()
        episodes = run_episodes(self.env, policy, self._config.eval_episodes)
        milestones = self.env.batch.task.milestone_names
        result: dict[str, Any] = summarise(episodes, milestones)
        success = {kind: rate.rate for kind, rate in result["success"].items()}
        mean_return = result["return_mean"]
        values = {"episodes": len(episodes), **success}
        if isfinite(mean_return):
            values["return"] = mean_return
        return PolicyEvaluation(
            policy=replace(policy, card=replace(policy.card, evaluation=values)),
            success=success,
            mean_return=mean_return,
            milestones=result["milestones"],
        )
