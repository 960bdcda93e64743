"""Save a run to a checkpoint, and restore it."""

import warnings
from typing import Any

from manip.errors import UserError
from manip.training.agent_state import restore, state_of
from manip.training.checkpoint import Checkpoints
from manip.training.config import TrainConfig, check_lasting, lasting
from manip.training.resume_check import ResumeCheck
from manip.training.run_parts import RunParts
from manip.training.run_state import RunState, run_state
from manip.versions import versions


def checkpoint_of(
    config: TrainConfig, parts: RunParts, state: RunState
) -> dict[str, Any]:
    """State of the run as plain values and tensors, with its options and versions."""
    averages = parts.averages
    state.lost_updates = parts.guard.count
    state.episodes, state.reward_terms = [*averages.episodes], [*averages.terms]
    return {
        **state_of(parts.agent, parts.collector, config.save_buffer),
        "config": lasting(config),
        "teacher": parts.teacher,
        "versions": versions(),
        "progress": state.to_dict(),
    }


def resume(config: TrainConfig, parts: RunParts, checkpoints: Checkpoints) -> RunState:
    """Restore the newest checkpoint into the parts of a run just built.

    Raises:
        UserError: there is none, it is damaged, or of a run with other options.
    """
    saved = checkpoints.load()
    _check_options(saved, config)
    _check_teacher(saved, config, parts)
    env = parts.evaluator.env
    ResumeCheck(config, env, parts.agent, parts.collector)(saved)
    state = _run_state(saved, parts)
    restore(saved, parts.agent, parts.collector)
    parts.guard.count = state.lost_updates
    parts.averages.episodes.extend(state.episodes)
    parts.averages.terms.extend(state.reward_terms)
    _warn_of_versions(saved["versions"])
    if config.engine == "warp":
        warnings.warn(
            "--engine warp: the run continues from the saved states, not bit for bit",
            stacklevel=2,
        )
    if state.env_steps:
        _warn_of_buffer(saved["agent"])
    return state


def _check_options(saved: dict[str, Any], config: TrainConfig) -> None:
    for name in ("config", "versions"):
        if not isinstance(saved.get(name), dict):
            raise UserError(f"the checkpoint in {config.folder} is damaged: no {name}")
    check_lasting(saved["config"], config)


def _check_teacher(saved: dict[str, Any], config: TrainConfig, parts: RunParts) -> None:
    """Refuse another teacher; older checkpoints do not say which one they had."""
    if saved.get("teacher", parts.teacher) != parts.teacher:
        raise UserError(
            f"the teacher {config.teacher} has other weights than when the run was "
            "saved: restore its folder, or start another run with another --out"
        )


def _run_state(saved: dict[str, Any], parts: RunParts) -> RunState:
    terms = len(parts.envs[0].batch.reward_names)
    try:
        return run_state(saved.get("progress"), len(parts.milestones), terms)
    except UserError as error:
        raise UserError(f"the checkpoint is damaged: {error}") from error


def _warn_of_buffer(agent: dict[str, Any]) -> None:
    """Warn that the agent's replay buffer was not saved, if it has one."""
    if "buffer" in agent and agent["buffer"] is None:
        warnings.warn(
            "the checkpoint holds no replay buffer: it is filled anew, and the run "
            "does not continue bit for bit",
            stacklevel=3,
        )


def _warn_of_versions(saved: dict[str, str]) -> None:
    """Warn of packages that have other versions than when the run was saved."""
    changed = [
        f"{package} was {saved.get(package)}, is {version}"
        for package, version in versions().items()
        if saved.get(package) != version
    ]
    if changed:
        warnings.warn(
            f"{'; '.join(changed)}: the run continues, but not bit for bit as it would "
            "have",
            stacklevel=3,
        )
