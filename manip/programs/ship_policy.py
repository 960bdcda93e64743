"""Ship the policy of a recipe's best seed: copy it to assets/policies."""

from collections.abc import Mapping
from pathlib import Path

from manip.agents.policy import SHIPPED, load_policy, shipped_policies
from manip.agents.policy_card import PolicyCard
from manip.evaluation.shipped_results import Result, Results, Run

WORTH = 0.9
"""Rate of success_held from which a policy is shipped."""


def ship_policy(result: Result, folders: Mapping[int, Path], stored: Results) -> None:
    """Ship the policy of the best seed, if it is good.

    It replaces the policy of another algorithm only if the 95 % interval of its rate
    begins above the other's rate. So a clone of an expert, whose actions change less
    from step to step, stays shipped where other policies succeed as often.

    Args:
        result: of the recipe; seeds are compared by their `choice_rate`, which was
            measured in other episodes than the result.
        folders: training seed -> run folder.
        stored: the results of the policies that are shipped now.
    """
    best = max(result.runs, key=choice_or_result)
    policy = load_policy(folders[best.seed])
    better = best.rate.low > _rate_to_beat(policy.card, stored)
    if choice_or_result(best) >= WORTH and better:
        policy.save(SHIPPED / policy.card.name)


def choice_or_result(run: Run) -> float:
    """The rate by which a seed is chosen; that of the result, if none was measured."""
    return run.rate.rate if run.choice_rate is None else run.choice_rate


def _rate_to_beat(card: PolicyCard, stored: Results) -> float:
    """The rate of the shipped policy, if it is of another algorithm; else 0."""
    folder = shipped_policies().get(card.name)
    shipped = load_policy(folder).card if folder else card
    run = stored.run((shipped.task, shipped.robot, shipped.method), shipped.seed)
    return run.rate.rate if run and shipped.algo != card.algo else 0.0
