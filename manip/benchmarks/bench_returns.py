"""Returns that PPO and SAC reach on Pendulum-v1, beside Stable-Baselines3's.

Both learn with the same nets, options, numbers of steps and worlds, and with a new seed
(0, 1, ...) every round; what they have learned acts without noise in the same 100
episodes. A return is of 200 steps, about -1200 at first and -150 at best. Intervals are
Welch's, 95 %, of the difference of the mean returns. What stays different: our SAC's
critics have LayerNorm, and the actor that it deploys is an average.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import count

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import RescaleAction
from scipy import stats
from tensordict import TensorDict, TensorDictBase

from manip.agents.agent import Agent, Spaces
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.sac import SAC, SACConfig
from manip.benchmarks.contest import Contest, Contestant, Settings
from manip.benchmarks.peers import peer
from manip.errors import at_least

Act = Callable[[np.ndarray], np.ndarray]
"""Observations [N, 3] -> actions [N, 1] in [-1, 1]."""

HORIZON = 200
"""Control steps of an episode, as Gymnasium has it."""
EPISODES = 100

NET = (64, 64)
STEPS = {"PPO": 30_000, "SAC": 3_000}
WORLDS = {"PPO": 8, "SAC": 1}

AGENTS: Mapping[str, Callable[[], Agent]] = {
    "PPO": lambda: PPO(
        PPOConfig(
            gamma=0.9,
            learning_rate=1e-3,
            rollout_length=256,
            epochs=10,
            minibatches=32,
            entropy_coefficient=0.0,
            max_gradient=0.5,
            target_kl=None,
            normalise=False,
            actor_hidden=NET,
            critic_hidden=NET,
        ),
        Spaces(3, 1),
    ),
    "SAC": lambda: SAC(
        SACConfig(
            gamma=0.99,
            learning_rate=1e-3,
            rollout_length=1,
            n_step=1,
            tau=0.005,
            batch_size=256,
            updates_per_step=1.0,
            actor_delay=1,
            random_steps=500,
            initial_alpha=1.0,
            target_entropy=-1.0,
            actor_hidden=NET,
            critic_hidden=NET,
        ),
        Spaces(3, 1),
    ),
}


def contest(settings: Settings) -> Contest:
    """Everybody's PPO and SAC; a round is a seed.

    Raises:
        UserError: one seed has no interval; Stable-Baselines3 is not there.
    """
    at_least(2, "--rounds", settings.rounds)
    torch.set_num_threads(1)
    who = {"manip": ours, "SB3": peer("returns_sb3").learn}
    contestants = {
        f"{algo}, {name}": _seed_by_seed(partial(learn, algo))
        for algo in AGENTS
        for name, learn in who.items()
    }
    steps = ", ".join(f"{algo} {number:,} steps" for algo, number in STEPS.items())
    title = f"Return of {HORIZON} steps on Pendulum-v1; {steps}"
    return Contest(title, contestants, unit="return", warm_up=False, derive=differences)


def pendulum() -> gymnasium.Env:
    """Pendulum-v1, its torque in units of the greatest."""
    return RescaleAction(gymnasium.make("Pendulum-v1"), np.float32(-1), np.float32(1))


def ours(algo: str, seed: int) -> Act:
    """What our algorithm has learned."""
    torch.manual_seed(seed)
    agent = AGENTS[algo]()
    envs = SyncVectorEnv(
        [pendulum] * WORLDS[algo], autoreset_mode=AutoresetMode.SAME_STEP
    )
    observation, _ = envs.reset(seed=seed)
    steps = 0
    while steps < STEPS[algo]:
        batch, observation = _collect(envs, observation, agent)
        steps += batch.numel()
        agent.update(batch)
    return partial(_decide, agent)


def mean_return(act: Act) -> float:
    """Of a policy, over episodes whose starts are the same for everybody."""
    envs = SyncVectorEnv([pendulum] * EPISODES)
    observation, _ = envs.reset(seed=1_000_000)
    total = 0.0
    for _ in range(HORIZON):
        observation, reward, *_ = envs.step(act(observation))
        total += reward.mean()
    return total


def differences(rounds: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Means over seeds, and how far ours is above theirs, with its interval."""
    found: dict[str, float] = {}
    for algo in AGENTS:
        mine, other = rounds[f"{algo}, manip"], rounds[f"{algo}, SB3"]
        interval = stats.ttest_ind(mine, other, equal_var=False).confidence_interval()
        found |= {
            f"{algo}_manip": float(np.mean(mine)),
            f"{algo}_SB3": float(np.mean(other)),
            f"{algo}_difference": float(np.mean(mine) - np.mean(other)),
            f"{algo}_difference_low": float(interval.low),
            f"{algo}_difference_high": float(interval.high),
        }
    return found


def _seed_by_seed(learn: Callable[[int], Act]) -> Contestant:
    seeds = count()
    return lambda: mean_return(learn(next(seeds)))


def _collect(
    envs: SyncVectorEnv, observation: np.ndarray, agent: Agent
) -> tuple[TensorDictBase, np.ndarray]:
    """The next steps of all worlds, a batch [N, T], and what is seen after them."""
    policy, steps = agent.policy(), []
    for _ in range(agent.rollout_length):
        seen = torch.from_numpy(observation.copy())
        step = policy(TensorDict({"observation": seen}, [len(seen)]))
        observation, reward, _, truncated, info = envs.step(step["action"].numpy())
        after = np.stack(info["final_obs"]) if truncated.all() else observation
        steps.append(step.set("next", _outcome(after, reward, truncated)))
    return torch.stack(steps, 1), observation


def _outcome(
    after: np.ndarray, reward: np.ndarray, truncated: np.ndarray
) -> TensorDict:
    """What a step led to; all worlds reach the time limit together, no other end."""
    ended = torch.from_numpy(truncated).unsqueeze(-1)
    found = {
        "observation": torch.from_numpy(after.copy()),
        "reward": torch.from_numpy(reward).float().unsqueeze(-1),
        "truncated": ended,
        "terminated": torch.zeros_like(ended),
        "done": ended,
    }
    return TensorDict(found, [len(after)])


@torch.no_grad()
def _decide(agent: Agent, observation: np.ndarray) -> np.ndarray:
    return agent.actor.decide(torch.from_numpy(observation)).numpy()
