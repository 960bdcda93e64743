"""Build the parts of a run from its options: environments, agent, policy."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import torch

from manip.agents.actor_inputs import seen_parts
from manip.agents.agent import Agent
from manip.agents.image_actor import ImageActor
from manip.agents.networks import RunningNorm, widths_of
from manip.agents.policy import AnyActor, Policy
from manip.agents.policy_card import PolicyCard
from manip.agents.registry import load_algorithm
from manip.agents.trajectory import CPU
from manip.cpus import usable_cpus
from manip.envs.adapters.torchrl import TaskEnv
from manip.envs.backends.native_batch import NativeBatch
from manip.envs.episode_streams import CHOICE
from manip.envs.interface import interface_of
from manip.envs.make_batch import make_batch
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.training.config import SCALE, TrainConfig
from manip.training.groups import groups_of
from manip.training.inputs import cameras_of, spaces_of
from manip.training.placement import learns_on_gpu
from manip.training.randomisation import load_randomisation
from manip.training.reward_weights import parse_weights
from manip.training.schedule import has_curve
from manip.training.teacher import check_teacher, expert_of, with_reference
from manip.versions import versions


def training_envs(config: TrainConfig) -> list[TaskEnv]:
    """Build the environments that a run learns from, in their groups.

    Raises:
        UserError: there is no expert or teacher for the run; num_envs does not split
            evenly over the groups; a rollout does not fit the replay buffer.
    """
    check_teacher(config)
    groups = groups_of(config)
    _check_buffer(config)
    return [training_env(config, group, groups) for group in range(groups)]


def _check_buffer(config: TrainConfig) -> None:
    capacity = getattr(config.agent, "buffer_size", None)
    length = getattr(config.agent, "rollout_length", 1)
    if capacity is not None and capacity < config.num_envs * length:
        raise UserError(
            f"agent.buffer_size {capacity} is smaller than a rollout of "
            f"{config.num_envs} environments x {length} steps: set it to "
            f"{config.num_envs * length} or more"
        )


def training_env(config: TrainConfig, group: int, groups: int) -> TaskEnv:
    """Build one of the equal groups of a run's environments."""
    num_envs = config.num_envs // groups
    batch = _batch(
        config,
        num_envs,
        cameras=cameras_of(config),
        looks=config.looks,
        perturbations=load_randomisation(config.randomise),
        fidelity=config.fidelity,
        threads=max(1, share_threads(config)[0] // groups),
        horizon=config.horizon,
        reward=config.reward,
        reward_weights=parse_weights(config.reward_weights),
        first_env=group * num_envs,
        stagger=True,
        restart_fraction=config.restart_fraction,
        **_engine_options(config),
    )
    batch.stop_at_faults = config.faults == "stop"
    clips = config.preferences is not None
    measures = clips or bool(config.taste)
    return TaskEnv(batch, expert_of(config, batch), measures=measures, states=clips)


def _engine_options(config: TrainConfig) -> dict[str, Any]:
    """The options of `make_batch` for the engine of the training environments."""
    chosen = {name: getattr(config, name) for name in ("device", "njmax", "nconmax")}
    if config.engine == "warp":
        tensors = learns_on_gpu(config) and not config.taste
        return {"backend": "warp", "tensors": tensors, **chosen}
    if any(value is not None for value in chosen.values()):
        raise UserError("--device, --njmax and --nconmax are options of --engine warp")
    return {}


def evaluation_env(config: TrainConfig) -> TaskEnv:
    """Build the environments of evaluations: exact physics, the task's own horizon.

    Images are of the quality and the looks of training, and what is randomised in
    training is so here: the best policy is chosen for what it was trained for.
    Their episodes serve to choose the best checkpoint (purpose CHOICE): the run never
    trains on them, and `manip evaluate` reports on others.
    """
    batch = _batch(
        config,
        config.eval_episodes,
        cameras=cameras_of(config),
        looks=config.looks,
        perturbations=load_randomisation(config.randomise),
        threads=config.threads,
        purpose=CHOICE,
    )
    return TaskEnv(batch)


def curve_env(config: TrainConfig, training: TaskBatch) -> TaskEnv | None:
    """Build the environments of light evaluations: physics and length of training.

    Their episodes begin as those of `evaluation_env`, and share the scene of the
    environments that the run trains in. None if the run has no light evaluations.
    """
    if not (config.curve_episodes and has_curve(config.eval_every, config.steps)):
        return None
    shared = {"scene": training.scene} if isinstance(training, NativeBatch) else {}
    batch = _batch(
        config,
        config.curve_episodes,
        cameras=cameras_of(config),
        fidelity=config.fidelity,
        threads=config.threads,
        horizon=config.horizon,
        purpose=CHOICE,
        **shared,
    )
    return TaskEnv(batch)


def _batch(config: TrainConfig, num_envs: int, **options: Any) -> TaskBatch:
    batch = make_batch(
        config.task, num_envs, robot=config.robot_config, seed=config.seed, **options
    )
    batch.dump_folder = config.folder / "dumps"
    return batch


def build_agent(config: TrainConfig, env: TaskEnv, device: torch.device = CPU) -> Agent:
    """Build the algorithm, with networks that fit the environment.

    Args:
        device: where it learns; only some algorithms take another than the CPU.

    Raises:
        UserError: an option does not fit the environment.
    """
    torch.manual_seed(config.seed)
    config = replace(config, agent=with_reference(config, env.batch))
    spaces = spaces_of(config, env)
    _check_scale(config, spaces.action_dim)
    algorithm = load_algorithm(config.algo)
    native = algorithm.has_native_gradients
    options: dict[str, Any] = {"gradients": config.gradients} if native else {}
    if algorithm.takes_device:
        options["device"] = device
    return algorithm(config.agent, spaces, share_threads(config)[1], **options)


def _check_scale(config: TrainConfig, action_dim: int) -> None:
    scale = getattr(config.agent, SCALE, ())
    if len(scale) not in (0, action_dim):
        raise UserError(
            f"agent.action_scale has {len(scale)} numbers, but {config.controller} of "
            f"{config.robot} has actions of {action_dim}: give {action_dim}, or none"
        )


def overlaps(config: TrainConfig) -> bool:
    """Whether simulation and learning run at the same time."""
    return config.overlap and load_algorithm(config.algo).off_policy


def share_threads(config: TrainConfig) -> tuple[int, int]:
    """Return the number of threads of the training environments and of the learner.

    Half each where both run at the same time: on two cores, splitting each batch over
    two threads that compete with the simulation's takes 1.2 times as long.
    """
    threads = config.threads or usable_cpus()
    if not overlaps(config):
        return threads, threads
    return -(-threads // 2), max(1, threads // 2)


def host_actor(agent: Agent) -> AnyActor:
    """The agent's actor if it is on the CPU, else a copy there: policies act there."""
    actor = agent.actor
    return actor if actor.action_scale.is_cpu else deepcopy(actor).cpu()


def policy_of(agent: Agent, config: TrainConfig, env: TaskEnv, steps: int) -> Policy:
    """Return the agent's present policy, with all that an evaluator needs."""
    actor, inputs = host_actor(agent), spaces_of(config, env).inputs
    encoders = actor.sizes if isinstance(actor, ImageActor) else None
    spec = seen_parts(env.batch.observation_spec, inputs)
    card = PolicyCard(
        task=config.task,
        robot=config.robot,
        algo=config.algo,
        controller=config.controller,
        control_freq=config.control_freq,
        action_dim=env.action_spec.shape[-1],
        observation=spec.to_dict(),
        hidden=widths_of(actor.body)[1:-1],
        squash=actor.squash,
        bins=actor.bins,
        normalise=isinstance(actor.norm, RunningNorm),
        image_channels=list(encoders.channels) if encoders else [],
        image_features=encoders.features if encoders else 0,
        image_quality=config.image_quality if encoders else "",
        looks=config.looks,
        randomised=[each.to_dict() for each in load_randomisation(config.randomise)],
        waypoint_fraction=config.waypoint_fraction,
        env_steps=steps,
        seed=config.seed,
        versions=versions(),
        horizon=env.batch.horizon,
        fidelity=config.fidelity,
        **vars(interface_of(env.batch, spec.names)),
    )
    return Policy(card, actor)
