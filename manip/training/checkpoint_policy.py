"""The policy in a checkpoint of a run, which may be older than the best one."""

from dataclasses import replace
from pathlib import Path

from manip.agents.policy import Policy
from manip.envs.task import Task
from manip.envs.task_registry import load_task_named_by
from manip.errors import UserError
from manip.io.tensor_trees import load_tree
from manip.training.agent_state import unfit
from manip.training.build import build_agent, evaluation_env, policy_of
from manip.training.checkpoint import FORMAT
from manip.training.config import recorded

FOLDER = "checkpoints"


def is_checkpoint(path: Path) -> bool:
    """Whether a path is that of a checkpoint file in a run folder."""
    return path.parent.name == FOLDER and path.suffix == ".safetensors"


def policy_of_checkpoint(path: Path) -> tuple[Policy, Task]:
    """The policy of a run at the time of a checkpoint, and its task.

    Args:
        path: RUN/checkpoints/latest.safetensors, best or previous.

    Raises:
        UserError: there is no such file, or it does not fit the run's options.
    """
    if not path.is_file():
        raise UserError(f"there is no checkpoint {path}")
    run = path.parent.parent
    config = recorded(run)
    task = load_task_named_by(run, config.task)
    saved = load_tree(path)
    if not isinstance(saved, dict) or saved.get("format") != FORMAT:
        raise UserError(f"{path} is of another version of manip")
    env = evaluation_env(replace(config, eval_episodes=1))
    agent = build_agent(config, env)
    try:
        for name, module in agent.modules().items():
            module.load_state_dict(saved["modules"][name])
        steps = int(saved["progress"]["env_steps"])
    except Exception as error:  # a file can hold anything
        raise unfit(error) from error
    return policy_of(agent, config, env, steps), task
