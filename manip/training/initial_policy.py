"""Start a run's actor from a trained policy (`--init`)."""

from dataclasses import fields, replace
from typing import Any

from manip.agents.actor_inputs import seen_parts
from manip.agents.agent import Agent
from manip.agents.initial_actor import initial_actor, network_options
from manip.agents.networks import BinnedActor
from manip.agents.policy import load_policy
from manip.agents.policy_card import Observe, PolicyCard
from manip.envs.adapters.torchrl import TaskEnv
from manip.errors import UserError
from manip.training.config import TrainConfig
from manip.training.inputs import spaces_of

CAREFUL = {
    "random_steps": 0,
    "critic_steps": 8_000,
    "critic_rollouts": 5,
    "initial_alpha": 0.01,
    "initial_weight": 20.0,
}
"""Options of --agent with which an initial policy is not lost at once: it collects from
the first step, the critics learn before the actor does, entropy counts little, and the
actor of SAC stays near the policy at first."""


def starting_from(config: TrainConfig, where: str) -> TrainConfig:
    """Return the options of a run that starts from a policy.

    The network is the policy's. If it is of the same task, the start is careful; see
    `CAREFUL`.

    Raises:
        UserError: there is no such policy.
    """
    policy = load_policy(where)
    options: dict[str, Any] = dict(CAREFUL) if policy.card.task == config.task else {}
    if not isinstance(policy.actor, BinnedActor):
        options |= network_options(policy.actor)
    names = {field.name for field in fields(config.agent)}
    fitting = {name: value for name, value in options.items() if name in names}
    agent = replace(config.agent, **fitting)
    sees = _camera_options(policy.card, config.task)
    return replace(config, init=where, agent=agent, **sees)


def _camera_options(card: PolicyCard, task: str) -> dict[str, Any]:
    """Options of what a policy with cameras sees; none if it sees the state.

    On another task the parts besides the images are that task's.
    """
    if (cameras := card.cameras) is None:
        return {}
    options: dict[str, Any] = {
        "observe": "cameras",
        "cameras": cameras.names,
        "image_size": cameras.size,
        "image_quality": card.image_quality or "lean",
        "frames": cameras.frames,
    }
    if card.task == task:
        options["parts"] = tuple(card.observation_spec.slices)
    return options


def observation_of(where: str) -> Observe:
    """What a policy sees, as `--observe` names it.

    Raises:
        UserError: there is no such policy.
    """
    return "cameras" if load_policy(where).card.cameras else "state"


def start_agent(config: TrainConfig, agent: Agent, env: TaskEnv) -> tuple[str, ...]:
    """Start the agent's actor from the policy of `--init`, if there is one.

    Returns:
        A line that says what was loaded and what is new.

    Raises:
        UserError: the policy does not fit the run.
    """
    if config.init is None or config.resume:
        return ()
    policy, where = load_policy(config.init), config.init
    _check_actions(policy.card, config, where)
    spec = seen_parts(env.batch.observation_spec, spaces_of(config, env).inputs)
    initial = initial_actor(policy, agent.actor, spec, where)
    agent.start_from(initial.weights, config.init_std)
    trained = f"{policy.card.task}, {policy.card.robot}, {policy.card.algo}"
    new = ", ".join([*initial.new, "the critics"])
    unused = f"; unused: {', '.join(initial.unused)}" if initial.unused else ""
    return (f"actor from {where} ({trained}): layers loaded; new: {new}{unused}",)


def _check_actions(card: PolicyCard, config: TrainConfig, where: str) -> None:
    for name in ("controller", "control_freq"):
        trained, expected = getattr(card, name), getattr(config, name)
        if trained != expected:
            raise UserError(
                f"the policy in {where} was trained with {name} {trained}, not "
                f"{expected}: its actions mean something else in this run"
            )
