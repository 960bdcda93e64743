"""Start an actor from a trained policy: layer by layer, inputs by their names."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from manip.agents.networks import Actor, RunningNorm, widths_of
from manip.agents.policy import Policy
from manip.errors import UserError
from manip.observation import ObservationSpec

FIRST = "body.0.weight"
"""Weights [H, D] of the first layer."""


class InitialActor(NamedTuple):
    """Weights to start from.

    Attributes:
        weights: a state_dict of the new actor.
        new: what the policy does not provide, in words; empty if all is loaded.
    """

    weights: dict[str, Tensor]
    new: list[str]


def initial_actor(
    policy: Policy, actor: Any, spec: ObservationSpec, where: str
) -> InitialActor:
    """Form the weights of a new actor from those of a trained policy.

    Inputs of the first layer are matched by the names of the observation's parts.
    Weights of parts that the policy does not know are 0: the new actor begins as the
    policy acts without them. The last layer stays new where actions have other lengths.

    Args:
        actor: the new one, of the policy's form and hidden layers.
        spec: the parts that the new actor joins.
        where: the policy's place, for errors.

    Raises:
        UserError: the policy has another form, or knows none of the parts.
    """
    _check_form(policy.actor, actor, where)
    columns, unknown = _columns(policy.card.observation_spec, spec)
    if len(unknown) == len(spec.slices):
        raise UserError(
            f"the policy in {where} sees none of the parts of this observation: "
            f"{', '.join(unknown)}"
        )
    old, weights = policy.actor.state_dict(), dict(actor.state_dict())
    fitting = {n: t for n, t in old.items() if weights[n].shape == t.shape}
    other = {} if len(old["action_scale"]) == len(actor.action_scale) else {"head"}
    weights |= fitting | {FIRST: _gather(old[FIRST], columns, 0.0)}
    if isinstance(actor.norm, RunningNorm):
        weights |= _norm(old, columns, bool(unknown))
    return InitialActor(weights, [*unknown, *other])


def network_options(actor: Actor) -> dict[str, Any]:
    """Options of an algorithm (`AgentConfig`) that build a network like the actor's."""
    scale = [float(f"{fraction:.6g}") for fraction in actor.action_scale.tolist()]
    return {
        "actor_hidden": tuple(widths_of(actor.body)[1:-1]),
        "action_scale": tuple(scale) if min(scale) < 1 else (),
        "squash": actor.squash,
        "normalise": isinstance(actor.norm, RunningNorm),
    }


def _check_form(old: Any, new: Any, where: str) -> None:
    """Raise `UserError` unless both are actors of one form and of equal layers."""
    if not isinstance(new, Actor):
        raise UserError("this algorithm has no actor that a policy could start")
    if not isinstance(old, Actor):
        raise UserError(
            f"the policy in {where} values discrete actions: it cannot start an actor; "
            "choose a policy that dqn has not trained"
        )
    expected, given = network_options(old), network_options(new)
    if len(old.action_scale) != len(new.action_scale):
        expected["action_scale"] = given["action_scale"]
    different = [
        f"{name} is {given[name]}, not {value}"
        for name, value in expected.items()
        if given[name] != value
    ]
    if different:
        raise UserError(
            f"the network differs from that of the policy in {where}: "
            f"{'; '.join(different)}. Set these options of --agent as the policy has "
            "them, or choose an algorithm with actors of its kind"
        )


def _columns(old: ObservationSpec, new: ObservationSpec) -> tuple[Tensor, list[str]]:
    """Return the old input [D] of each new one, -1 for none; and unknown parts."""
    known = {part.name: part for part in old.parts}
    columns, unknown = torch.full((new.dim,), -1), []
    for part in new.parts:
        if part.name not in new.slices:
            continue
        if known.get(part.name) == part:
            place = old.slices[part.name]
            columns[new.slices[part.name]] = torch.arange(place.start, place.stop)
        else:
            unknown.append(part.name)
    return columns, unknown


def _gather(values: Tensor, columns: Tensor, missing: float) -> Tensor:
    """Select columns [..., D] of values; `missing` where there is none."""
    return values[..., columns.clamp_min(0)].where(columns >= 0, missing)


def _norm(old: dict[str, Tensor], columns: Tensor, unknown: bool) -> dict[str, Tensor]:
    """The running statistics; they start to count anew if parts are unknown."""
    count = old["norm.count"]
    return {
        "norm.mean": _gather(old["norm.mean"], columns, 0.0),
        "norm.var": _gather(old["norm.var"], columns, 1.0),
        "norm.count": torch.zeros_like(count) if unknown else count,
    }
