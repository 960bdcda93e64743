"""A policy's network in words and numbers: what to compute with its weights.

It is part of a policy's JSON file and of exported policies, so that they can be run
without this package; `manip.deploy.exported_policy.network_action` is an example.
"""

from collections.abc import Iterator
from typing import Any

from torch import nn

from manip.agents.image_actor import ImageActor
from manip.agents.networks import (
    NORM_CLIP,
    NORM_EPSILON,
    Actor,
    BinnedActor,
    RunningNorm,
)


def network_form(actor: Actor | BinnedActor | ImageActor) -> dict[str, Any]:
    """Describe an actor as plain values.

    Returns:
        normaliser: epsilon and clip of y = clip((x - mean) / sqrt(var + epsilon)),
            where x is the joined observation, and mean and var the weights norm.mean
            and norm.var; None without.
        encoders: for each camera the layers that encode its image, whose outputs are
            appended to y; pixels / 255 - 0.5 is their input, channels first.
        layers: of the network, in order: kind (linear, layer_norm, relu, tanh, conv),
            prefix `name` of its weights, and its constants.
        head: of the outputs x, with a the weights `action_scale` and A the length of
            the action: "tanh": a tanh(x[:A]); "clip": clip(a x, -1, 1); "best bin": x
            is a value, then `bins` advantages for each number of the action; the index
            i of the largest one means a (2 i / (bins - 1) - 1).
        action_scale: name of the weights a.
    """
    encoders = actor.encoders if isinstance(actor, ImageActor) else nn.ModuleList()
    prefix = "head." if isinstance(actor, ImageActor) else ""
    normalised = isinstance(actor.norm, RunningNorm)
    return {
        "normaliser": {"epsilon": NORM_EPSILON, "clip": [-NORM_CLIP, NORM_CLIP]}
        if normalised
        else None,
        "encoders": [
            [*_layers(encoder, f"encoders.{index}")]
            for index, encoder in enumerate(encoders)
        ],
        "layers": [*_layers(actor.body, f"{prefix}body")],
        "head": "best bin" if actor.bins else "tanh" if actor.squash else "clip",
        "bins": actor.bins,
        "action_scale": f"{prefix}action_scale",
    }


def _layers(network: nn.Module, prefix: str) -> Iterator[dict[str, Any]]:
    for name, layer in network.named_modules(prefix=prefix):
        match layer:
            case nn.Linear():
                yield {"kind": "linear", "name": name}
            case nn.LayerNorm():
                yield {"kind": "layer_norm", "name": name, "epsilon": layer.eps}
            case nn.Conv2d():
                form = {"stride": layer.stride[0], "padding": layer.padding[0]}
                yield {"kind": "conv", "name": name, **form}
            case nn.ReLU():
                yield {"kind": "relu"}
            case nn.Tanh():
                yield {"kind": "tanh"}
