"""Groups of a run's environments: those of an algorithm's workers, or of collectors."""

from manip.agents.agent import Agent
from manip.agents.registry import load_algorithm
from manip.errors import UserError
from manip.training.config import TrainConfig


def groups_of(config: TrainConfig) -> int:
    """The number of groups into which the environments are split evenly.

    Raises:
        UserError: they do not split, or the algorithm cannot have several collectors.
    """
    if config.collectors > 1:
        _check_collectors(config)
    if config.engine == "warp":
        _check_one_group(config)
    groups = max(config.agent.workers, config.collectors)
    if config.num_envs % groups:
        kind = "collectors" if config.collectors > 1 else "workers"
        raise UserError(
            f"num_envs {config.num_envs} does not split evenly over {groups} {kind}: "
            f"choose a multiple of {groups}"
        )
    return groups


def _check_one_group(config: TrainConfig) -> None:
    if config.collectors > 1 or config.agent.workers > 1:
        raise UserError(
            "--engine warp steps all environments at once: leave out --collectors, and "
            "choose an algorithm without workers"
        )


def _check_collectors(config: TrainConfig) -> None:
    learns_elsewhere = (
        load_algorithm(config.algo).process_rollout is not Agent.process_rollout
    )
    if learns_elsewhere or config.agent.workers > 1:
        raise _without_use("--collectors", config)
    check_elsewhere(config, "--collectors")


def check_elsewhere(config: TrainConfig, option: str) -> None:
    """Check that the environments can be stepped apart from the rest of the run.

    Raises:
        UserError: the algorithm imitates, or the run has preferences.
    """
    if load_algorithm(config.algo).imitates:
        raise _without_use(option, config)
    if config.preferences is not None:
        raise UserError(f"{option} does not fit --preferences: leave one out")


def _without_use(option: str, config: TrainConfig) -> UserError:
    return UserError(
        f"{option} has no use with {config.algo}, whose rollouts are not its "
        "policy's alone: leave it out, or choose ppo, a2c, sac or td3"
    )
