"""Start an actor from a trained policy: layer by layer, inputs by their names."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor, RunningNorm, widths_of
from manip.agents.policy import Policy
from manip.errors import UserError
from manip.observation import ObservationSpec


class InitialActor(NamedTuple):
    """Weights to start from.

    Attributes:
        weights: a state_dict of the new actor.
        new: what the policy does not provide, in words; empty if all is loaded.
        unused: parts of the observation that the policy sees, and the new actor does
            not.
    """

    weights: dict[str, Tensor]
    new: list[str]
    unused: list[str]


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
        UserError: the policy has another form, knows none of the parts, or sees images
            of another size.
    """
    _check_form(policy.actor, actor, where)
    known = policy.card.observation_spec
    _check_images(known, spec, where)
    columns, unknown = _columns(known, spec)
    if len(unknown) == len(spec.parts):
        raise UserError(
            f"the policy in {where} sees none of the parts of this observation: "
            f"{', '.join(unknown)}"
        )
    old, weights = policy.actor.state_dict(), dict(actor.state_dict())
    weights |= {n: t for n, t in old.items() if _shape(weights.get(n)) == t.shape}
    joined = columns
    if isinstance(actor, ImageActor):
        encoders, joined = _match_cameras(actor, known, spec, columns)
        weights |= {new: old[name] for new, name in encoders.items()}
    first = next(name for name in weights if name.endswith("body.0.weight"))
    weights[first] = _gather(old[first], joined, 0.0)
    if isinstance(actor.norm, RunningNorm):
        weights |= _norm(old, columns, bool(unknown))
    other = len(policy.actor.action_scale) != len(actor.action_scale)
    unused = [name for name in known.names if name not in spec.names]
    new = [*unknown, *(["the last layer"] if other else [])]
    return InitialActor(weights, new, unused)


def _shape(tensor: Tensor | None) -> torch.Size | None:
    return None if tensor is None else tensor.shape


def network_options(actor: Actor | ImageActor) -> dict[str, Any]:
    """Options of an algorithm (`AgentConfig`) that build a network like the actor's."""
    scale = [float(f"{fraction:.6g}") for fraction in actor.action_scale.tolist()]
    options = {
        "actor_hidden": tuple(widths_of(actor.body)[1:-1]),
        "action_scale": tuple(scale) if min(scale) < 1 else (),
        "squash": actor.squash,
        "normalise": isinstance(actor.norm, RunningNorm),
    }
    if isinstance(actor, ImageActor):
        options["image_channels"] = tuple(actor.sizes.channels)
        options["image_features"] = actor.sizes.features
    return options


def _check_form(old: Any, new: Any, where: str) -> None:
    """Raise `UserError` unless both are actors of one form and of equal layers."""
    if not isinstance(new, Actor | ImageActor):
        raise UserError(
            "dqn has no actor that could start from a policy: choose another algorithm"
        )
    if not isinstance(old, Actor | ImageActor):
        raise UserError(
            f"the policy in {where} values discrete actions: it cannot start an actor; "
            "choose a policy that dqn has not trained"
        )
    if type(old) is not type(new):
        sees = "cameras" if isinstance(old, ImageActor) else "the state"
        raise UserError(
            f"the policy in {where} sees {sees}: it starts an actor that does, too "
            "(--observe)"
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


def _check_images(old: ObservationSpec, new: ObservationSpec, where: str) -> None:
    """Raise `UserError` if a camera of both has images of other shapes."""
    images = {part.name: part for part in old.parts if part.role == "camera"}
    for part in new.parts:
        if (known := images.get(part.name, part)) != part:
            raise UserError(
                f"the policy in {where} sees {part.name} of shape {[*known.shape]}, "
                f"not {[*part.shape]}: its encoder does not fit. Leave out "
                "--image-size and --frames"
            )


def _columns(old: ObservationSpec, new: ObservationSpec) -> tuple[Tensor, list[str]]:
    """Return the old input [D] of each new one, -1 for none; and unknown parts."""
    known = {part.name: part for part in old.parts}
    unknown = [part.name for part in new.parts if known.get(part.name) != part]
    columns = torch.full((new.dim,), -1)
    for name, place in new.slices.items():
        if name not in unknown:
            start, stop = old.slices[name].start, old.slices[name].stop
            columns[place] = torch.arange(start, stop)
    return columns, unknown


def _match_cameras(
    actor: ImageActor, old: ObservationSpec, new: ObservationSpec, columns: Tensor
) -> tuple[dict[str, str], Tensor]:
    """Match the encoders of equal cameras.

    Returns:
        New name -> old name of their weights; and the old input of each input of the
        head, which joins the vector, whose columns are given, and the features.
    """
    before, after = (
        [part for part in spec.parts if part.role == "camera"] for spec in (old, new)
    )
    names, joined, width = {}, [columns], actor.sizes.features
    for place, camera in enumerate(after):
        index = before.index(camera) if camera in before else None
        start = -1 if index is None else old.dim + index * width
        joined.append(start + torch.arange(width) * (start >= 0))
        for name in actor.encoders[place].state_dict() if start >= 0 else ():
            names[f"encoders.{place}.{name}"] = f"encoders.{index}.{name}"
    return names, torch.cat(joined)


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
