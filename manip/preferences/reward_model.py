"""A learned reward: what it sees of a step, its network, and its file.

It is a RewardFunction (see manip.rewards.reward_function): rollout -> rewards. The file
holds a card and the weights, with a checksum; reading it runs no code of the file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor

from manip.agents.networks import MOST_NEURONS
from manip.errors import DamagedError, UserError, one_line
from manip.io.dataclass_values import build
from manip.io.option_ranges import COUNT, SHARE, WHOLE, Range, check_options
from manip.io.tensor_trees import load_tree, save_tree
from manip.preferences.label_options import Inputs
from manip.preferences.reward_network import RewardNetwork

FILE = "reward_model.safetensors"
"""Name of the file in a folder of preferences."""

FORMAT = 1
"""Version of the file; raised when it changes incompatibly."""

MOST_BYTES = 2**28
"""Largest file that is read."""

HIDDEN = [64, 64]
"""Widths of the hidden layers of a learned reward."""

LARGEST_WEIGHT = 1e6
"""Largest weight that is accepted."""


@dataclass(frozen=True)
class RewardCard:
    """What a learned reward is for, and from how much it was learned.

    Attributes:
        task, robot: of the clips.
        inputs: what it sees of a step; see `Inputs`.
        names: of the F numbers that describe a step.
        hidden: widths of its networks' hidden layers.
        members: number of networks.
        clip_steps: length of the clips [control steps].
        labels: comparisons that it was fitted to, without skipped ones.
        accuracy, held_out: share of predicted answers among the held-out pairs, and
            their number (see `FitResult`).
    """

    task: str
    robot: str
    inputs: Inputs
    names: Annotated[list[str], Range(1, MOST_NEURONS)]
    hidden: Annotated[list[int], Range(1, MOST_NEURONS)]
    members: Annotated[int, Range(1, 100)]
    clip_steps: Annotated[int, COUNT]
    labels: Annotated[int, WHOLE] = 0
    accuracy: Annotated[float, SHARE] = 0.0
    held_out: Annotated[int, WHOLE] = 0
    format: int = field(default=FORMAT)


@dataclass(frozen=True)
class RewardModel:
    """A learned reward: rollout [N, T] -> rewards [N, T, 1]."""

    card: RewardCard
    network: RewardNetwork

    @torch.no_grad()
    def __call__(self, rollout: TensorDictBase) -> Tensor:
        """Rewards [N, T, 1] of a rollout [N, T] (see `step_inputs`)."""
        return self.network.paid(step_inputs(rollout, self.card.inputs))[..., None]

    def save(self, path: Path) -> None:
        """Write the file, atomically."""
        weights = dict(self.network.state_dict())
        save_tree(path, {"card": asdict(self.card), "weights": weights})


def step_inputs(rollout: TensorDictBase, inputs: Inputs) -> Tensor:
    """[N, T, F]: what a learned reward sees of the steps of a rollout [N, T]."""
    if inputs == "measures":
        measures: Tensor = rollout["next", "measures"]
        return measures
    return torch.cat([rollout["observation"], rollout["action"]], -1)


def clip_inputs(clips: TensorDictBase, inputs: Inputs) -> Tensor:
    """[C, L, F]: what a learned reward sees of the steps of clips (see `ClipPool`)."""
    if inputs == "measures":
        measures: Tensor = clips["measures"]
        return measures
    return torch.cat([clips["observation"], clips["action"]], -1)


def input_names(
    inputs: Inputs, measures: Sequence[str], observation_dim: int, action_dim: int
) -> list[str]:
    """Names of the F numbers of `step_inputs`."""
    if inputs == "measures":
        return [*measures]
    entries = [f"observation {i}" for i in range(observation_dim)]
    return entries + [f"action {i}" for i in range(action_dim)]


def load_reward_model(path: Path) -> RewardModel:
    """Read a learned reward.

    Raises:
        UserError: there is no such file, or it is of another version.
        DamagedError: it was changed, or is of another kind.
    """
    if path.is_file() and path.stat().st_size > MOST_BYTES:
        raise UserError(f"{path} holds no reward model: it is larger than {MOST_BYTES}")
    tree = load_tree(path)
    try:
        card = _card(tree["card"])
        network = _network(card, tree["weights"])
    except Exception as error:  # a file can hold anything
        raise DamagedError(
            f"{path} holds no reward model: {one_line(error)}"
        ) from error
    return RewardModel(card, network)


def _card(values: Any) -> RewardCard:
    card = build(RewardCard, values)
    if card.format != FORMAT:
        raise UserError(f"it has format {card.format}, expected {FORMAT}")
    check_options(card)
    if not card.names or not all(name.isprintable() for name in card.names):
        raise UserError("names must be text without control characters")
    if card.inputs not in get_args(Inputs):
        raise UserError(f"inputs must be one of {', '.join(get_args(Inputs))}")
    return card


def _network(card: RewardCard, weights: Mapping[str, Tensor]) -> RewardNetwork:
    with torch.device("meta"):  # a card may name networks larger than the memory
        network = RewardNetwork(len(card.names), card.members, card.hidden)
    _check_weights(weights, network.state_dict())
    network.load_state_dict(weights, assign=True)
    return network


def _check_weights(weights: Any, expected: Mapping[str, Tensor]) -> None:
    if not isinstance(weights, Mapping) or weights.keys() != expected.keys():
        raise UserError("its weights have other names than the card's network")
    for name, tensor in weights.items():
        form = expected[name].shape, expected[name].dtype
        if not isinstance(tensor, Tensor) or (tensor.shape, tensor.dtype) != form:
            raise UserError(f"weights {name} have another shape or type")
        if not tensor.isfinite().all() or tensor.abs().max() > LARGEST_WEIGHT:
            raise UserError(f"weights {name} are not finite or too large")
    for name in ("std", "scale"):
        if not (weights[name] > 0).all():
            raise UserError(f"{name} must be more than 0")
