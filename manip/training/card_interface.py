"""Complete the card of a policy of an earlier version, which lacks the interface."""

from dataclasses import replace

from manip.agents.policy import Policy
from manip.envs.interface import interface_of
from manip.envs.make_batch import make_batch
from manip.envs.task import Task


def with_interface(policy: Policy, task: Task) -> Policy:
    """The policy, with measurements, formulas and control in its card.

    They are computed from the task unless the card has them.
    """
    card = policy.card
    if card.control:
        return policy
    batch = make_batch(task, 1, robot=card.robot_config)
    interface = interface_of(batch, card.observation_spec.names)
    horizon = card.horizon or batch.horizon
    return replace(policy, card=replace(card, horizon=horizon, **vars(interface)))
