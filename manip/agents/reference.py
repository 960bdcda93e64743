"""Start an actor from the policy that it shall stay close to (its reference)."""

from manip.agents.networks import Actor
from manip.agents.on_policy import OnPolicy
from manip.agents.policy import load_policy
from manip.errors import UserError


def start_from_reference(agent: OnPolicy, where: str, std: float) -> None:
    """Load a trained policy into an agent's actor, which is new.

    Args:
        where: run folder or shipped name of the policy.
        std: standard deviation of the actions, as a fraction of each dimension's
            range, if the policy has squash: then its own is of another distribution.

    Raises:
        UserError: the policy has other networks than the agent.
    """
    trained = load_policy(where).actor
    own = agent.actor.state_dict()
    if not isinstance(trained, Actor) or trained.squash != agent.actor.squash:
        raise UserError(
            f"the policy in {where} has another kind of actor than this run: it must "
            "have continuous actions, and --agent.squash must be as it was trained"
        )
    weights = trained.state_dict()
    if {n: w.shape for n, w in weights.items()} != {n: w.shape for n, w in own.items()}:
        raise UserError(
            f"the policy in {where} has other networks than this run: set "
            "--agent.actor-hidden and --agent.normalise as it was trained with them"
        )
    if trained.squash:
        agent.start_from(weights, std)
    else:
        agent.actor.load_state_dict(weights)
