"""Score a policy by what labellers want: success, taste, learned reward, KL."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch.distributions import kl_divergence
from torchrl.modules import IndependentNormal

from manip.agents.networks import Actor
from manip.agents.policy import load_policy
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.episode_streams import EVALUATION
from manip.envs.make_batch import make_batch
from manip.errors import UserError
from manip.evaluation.episodes import Episode, EpisodeTracker
from manip.preferences.reward_model import FILE, load_reward_model
from manip.preferences.tastes import load_taste


@dataclass(frozen=True)
class PolicyScore:
    """What a policy does in the episodes that all policies of a study are scored in.

    Attributes:
        episodes: their number.
        success_held: share of the episodes with success_held.
        reward: mean task reward of a control step.
        penalty: mean penalty of the taste of a control step.
        utility: reward minus the weighted penalty: what a labeller wants.
        learned: mean learned reward of a step; None without a reward model.
        divergence: mean KL(policy || reference) of the action distributions in the
            visited states [nat per control step].
    """

    episodes: int
    success_held: float
    reward: float
    penalty: float
    utility: float
    learned: float | None
    divergence: float


@dataclass(frozen=True)
class Scorer:
    """Runs policies in the same episodes of the batch engine, in fast physics.

    The policy acts without noise, as it is deployed. The episodes are of another
    purpose than those of training.

    Attributes:
        task: name of the task.
        taste: name of the taste.
        episodes: number of episodes.
        horizon: their length [control steps].
    """

    task: str
    taste: str
    episodes: int
    horizon: int

    def __call__(
        self, policy: Path, reference: Path, labels: Path | None = None
    ) -> PolicyScore:
        """Scorer the policy in a run folder.

        Args:
            policy: run folder.
            reference: run folder of the policy that its run started from.
            labels: folder of preferences with the reward model of its run, if any.

        Raises:
            UserError: a folder has no policy, no Gaussian one, or no reward model.
        """
        actor, start = (gaussian_actor(folder) for folder in (policy, reference))
        rollout = self._rollout(actor)
        reward = rollout["next", "reward"].double().mean().item()
        measures = rollout["next", "measures"].double().numpy()
        taste = load_taste(self.task, self.taste)
        names = self._env.batch.measure_names
        penalty = float(taste.penalties(measures, names).mean())
        return PolicyScore(
            episodes=self.episodes,
            success_held=_success_held(rollout),
            reward=reward,
            penalty=penalty,
            utility=reward - taste.weight * penalty,
            learned=_learned(rollout, labels) if labels else None,
            divergence=divergence(actor, start, rollout["observation"]),
        )

    @cached_property
    def _env(self) -> TaskEnv:
        batch = make_batch(
            self.task,
            self.episodes,
            backend="native",
            fidelity="fast",
            purpose=EVALUATION,
            horizon=self.horizon,
        )
        return TaskEnv(batch, measures=True)

    @torch.no_grad()
    def _rollout(self, actor: Actor) -> TensorDictBase:
        """[episodes, horizon] steps of the first episode of each environment."""
        self._env.batch.restart()
        rollout: TensorDictBase = self._env.rollout(
            self.horizon, Decide(actor), break_when_any_done=False
        )
        return rollout


class Decide(TensorDictModuleBase):
    """Act without noise."""

    in_keys = ["observation"]
    out_keys = ["action"]

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self._actor = actor

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write `action` [N, A]."""
        action = self._actor.decide(tensordict["observation"])
        return tensordict.set("action", action)


def gaussian_actor(folder: Path) -> Actor:
    """The Gaussian actor of a run folder.

    Raises:
        UserError: there is none, or its distribution is of another form.
    """
    actor = load_policy(folder).actor
    if not isinstance(actor, Actor) or actor.squash:
        raise UserError(
            f"{folder} holds no policy with a Gaussian spread: gaussian-bc, ppo, "
            "ppo-kl, clone-best and dpo train such policies"
        )
    return actor


@torch.no_grad()
def divergence(actor: Actor, reference: Actor, observation: torch.Tensor) -> float:
    """Mean KL(actor || reference) in states [..., D], in closed form [nat]."""
    ours, others = (
        IndependentNormal(*each(observation)).base_dist for each in (actor, reference)
    )
    return kl_divergence(ours, others).sum(-1).mean().item()


def _success_held(rollout: TensorDictBase) -> float:
    """Share of success_held in the first episode of each environment."""
    tracker = EpisodeTracker(len(rollout))
    ended: dict[int, Episode] = {}
    for step in range(rollout.shape[1]):
        for episode in tracker.update(rollout["next"][:, step]):
            ended.setdefault(episode.env_id, episode)
    return sum(episode.success_held for episode in ended.values()) / len(rollout)


def _learned(rollout: TensorDictBase, labels: Path) -> float:
    return load_reward_model(labels / FILE)(rollout).mean().item()
