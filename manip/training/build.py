"""From options to the parts of a run."""

from dataclasses import replace
from typing import Any

import torch

from manip.agents.a2c import A2C, A2CConfig
from manip.agents.a3c import A3C, A3CConfig
from manip.agents.agent import Agent, Spaces
from manip.agents.bc import BC, BCConfig
from manip.agents.dqn import DQN, DQNConfig
from manip.agents.networks import RunningNorm, widths_of
from manip.agents.policy import Policy, PolicyCard, load_policy
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.ppo_kl import PPOKL, PPOKLConfig
from manip.agents.reinforce import Reinforce, ReinforceConfig
from manip.agents.sac import SAC, SACConfig
from manip.agents.td3 import TD3, TD3Config
from manip.agents.trpo import TRPO, TRPOConfig
from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.external_batch import ExternalTask
from manip.envs.make_batch import make_batch
from manip.envs.task_registry import load_task
from manip.errors import UserError
from manip.training.config import TrainConfig
from manip.versions import versions

AGENTS: dict[type, Any] = {
    ReinforceConfig: Reinforce,
    A2CConfig: A2C,
    A3CConfig: A3C,
    TRPOConfig: TRPO,
    PPOConfig: PPO,
    PPOKLConfig: PPOKL,
    DQNConfig: DQN,
    TD3Config: TD3,
    SACConfig: SAC,
    BCConfig: BC,
}
"""Options of an algorithm -> its agent."""

EVAL_SEED = 1_000_000
"""Added to a run's seed for its evaluations: episodes it never trains on."""

WORKER_SEED = 10_000_000
"""Added to a run's seed for each worker after the first: episodes of its own."""


def training_envs(config: TrainConfig) -> list[TaskEnv]:
    """The worlds that a run learns from: a share of them for each of its workers.

    Raises:
        UserError: a script is to be imitated in another action space than its own;
            workers cannot share the worlds evenly.
    """
    if imitates(config) and config.controller != "OSC_POSE":
        raise UserError(
            f"scripts give OSC_POSE actions, not {config.controller}: choose another "
            f"algorithm than {config.algo}"
        )
    workers = getattr(config.agent, "workers", 1)
    if config.num_envs % workers:
        raise UserError(
            f"num_envs is {config.num_envs}, which {workers} workers cannot share "
            "evenly"
        )
    return [_training_env(config, worker, workers) for worker in range(workers)]


def imitates(config: TrainConfig) -> bool:
    """Whether a run learns from a task's script."""
    return bool(AGENTS[type(config.agent)].imitates)


def _training_env(config: TrainConfig, worker: int, workers: int) -> TaskEnv:
    env = _env(
        config,
        config.num_envs // workers,
        expert=imitates(config),
        fidelity=config.fidelity,
        threads=max(1, share_threads(config)[0] // workers),
        horizon=config.horizon,
        reward=config.reward,
        seed=config.seed + worker * WORKER_SEED,
        stagger=True,
        restart_fraction=config.restart_fraction,
    )
    env.batch.stop_at_faults = config.faults == "stop"
    return env


def evaluation_env(config: TrainConfig) -> TaskEnv:
    """The worlds that a run is judged in: exact physics, the task's own horizon."""
    seed = config.seed + EVAL_SEED
    return _env(config, config.eval_episodes, threads=config.threads, seed=seed)


def _env(
    config: TrainConfig, num_envs: int, expert: bool = False, **options: Any
) -> TaskEnv:
    task = load_task(config.task)
    if not isinstance(task, ExternalTask):
        options["dumps"] = config.folder / "dumps"
    batch = make_batch(task, num_envs, robot=config.robot_config, **options)
    return TaskEnv(batch, expert)


def build_agent(config: TrainConfig, env: TaskEnv) -> Agent:
    """The algorithm, with networks that fit the environment."""
    torch.manual_seed(config.seed)
    spaces = Spaces(
        env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
    )
    options = config.agent
    if config.controller != "OSC_POSE" and not isinstance(options, BCConfig):
        options = replace(options, action_scale=())
    if isinstance(options, PPOKLConfig) and options.reference is not None:
        _check_reference(options.reference, config, env)
    algorithm = AGENTS[type(options)]
    native = algorithm.has_native_gradients
    source = {"gradients": config.gradients} if native else {}
    agent: Agent = algorithm(options, spaces, share_threads(config)[1], **source)
    return agent


def _check_reference(folder: str, config: TrainConfig, env: TaskEnv) -> None:
    """A reference acts where the run does: it sees and moves the same."""
    card = load_policy(folder).card
    env.batch.check_layout(card.layout)
    for name in ("robot", "controller", "control_freq"):
        theirs, mine = getattr(card, name), getattr(config, name)
        if theirs != mine:
            raise UserError(
                f"the policy in {folder} was trained with {name} {theirs}, not {mine}: "
                "it is no reference for this run"
            )


def overlaps(config: TrainConfig) -> bool:
    """Whether simulation and learning run at the same time."""
    return config.overlap and bool(AGENTS[type(config.agent)].off_policy)


def share_threads(config: TrainConfig) -> tuple[int, int]:
    """Threads of the training worlds and of the learner.

    Half each where both run at the same time: on two cores, splitting every batch over
    two threads that compete with the simulation's takes 1.2 times as long.
    """
    threads = config.threads or usable_cpus()
    if not overlaps(config):
        return threads, threads
    return -(-threads // 2), max(1, threads // 2)


def policy_of(agent: Agent, config: TrainConfig, env: TaskEnv, steps: int) -> Policy:
    """The agent's policy as it is now, with all that an evaluator needs."""
    layout = env.batch.layout
    card = PolicyCard(
        task=config.task,
        robot=config.robot,
        algo=config.algo,
        controller=config.controller,
        control_freq=config.control_freq,
        action_dim=env.action_spec.shape[-1],
        layout={name: [part.start, part.stop] for name, part in layout.items()},
        hidden=widths_of(agent.actor.body)[1:-1],
        squash=agent.actor.squash,
        bins=agent.actor.bins,
        normalise=isinstance(agent.actor.norm, RunningNorm),
        env_steps=steps,
        seed=config.seed,
        versions=versions(),
    )
    return Policy(card, agent.actor)
