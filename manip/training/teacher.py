"""What a run imitates or stays close to: the task's expert, or a trained policy."""

from dataclasses import replace

from manip.agents.agent import AgentConfig
from manip.agents.initial_actor import network_options
from manip.agents.networks import Actor
from manip.agents.policy import Policy, load_policy
from manip.agents.registry import load_algorithm
from manip.envs.task_batch import TaskBatch
from manip.errors import UserError
from manip.observation import check_observation
from manip.training.config import TrainConfig


def imitates(config: TrainConfig) -> bool:
    """Whether a run learns from the actions of an expert or a teacher."""
    return load_algorithm(config.algo).imitates


def check_teacher(config: TrainConfig) -> None:
    """Check that a run has an expert or a teacher, if it imitates.

    Raises:
        UserError: experts act in another action space; the algorithm does not imitate.
    """
    acts = config.teacher is None and config.dataset is None and imitates(config)
    if acts and config.controller != "OSC_POSE":
        raise UserError(
            f"experts give OSC_POSE actions, not {config.controller}: choose another "
            f"algorithm than {config.algo}, or a trained policy by --teacher"
        )
    if config.teacher is not None and not imitates(config):
        raise UserError(f"{config.algo} imitates no --teacher: choose --algo bc")


def expert_of(config: TrainConfig, batch: TaskBatch) -> Policy | bool:
    """What labels a run's steps: a policy, the task's expert (True), or none (False).

    Raises:
        UserError: there is no such policy, it does not fit the run, or sees cameras.
    """
    if config.teacher is None:
        return imitates(config) and config.dataset is None
    teacher = fitting_policy(config.teacher, config, batch)
    if teacher.card.cameras:
        raise UserError(
            f"the policy in {config.teacher} sees cameras: a teacher must see the "
            "state, so that its labels do not depend on the images of the training"
        )
    return teacher


def teacher_digest(config: TrainConfig) -> str:
    """Identify the weights of a run's teacher; empty without one."""
    return load_policy(config.teacher).digest() if config.teacher else ""


def fitting_policy(where: str, config: TrainConfig, batch: TaskBatch) -> Policy:
    """Load a policy that has a run's observations and actions.

    Raises:
        UserError: there is none, or it is of another robot, controller or observation.
    """
    policy = load_policy(where)
    for name in ("robot", "controller", "control_freq"):
        trained, wanted = getattr(policy.card, name), getattr(config, name)
        if trained != wanted:
            raise UserError(
                f"the policy in {where} was trained with {name} {trained}, not "
                f"{wanted}: it does not fit this run"
            )
    check_observation(policy.card.observation, batch.observation_spec)
    return policy


def with_reference(config: TrainConfig, batch: TaskBatch) -> AgentConfig:
    """Options of the algorithm, those of the network as its reference has them.

    Raises:
        UserError: there is no such reference, or it does not fit the run.
    """
    where = getattr(config.agent, "reference", None)
    if where is None:
        return config.agent
    policy = fitting_policy(where, config, batch)
    if not isinstance(policy.actor, Actor):
        raise UserError(
            f"the policy in {where} is no reference: it must see the state and have "
            "continuous actions; choose one that dqn has not trained"
        )
    return replace(config.agent, **network_options(policy.actor))
