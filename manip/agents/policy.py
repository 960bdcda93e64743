"""A trained policy as files: weights and card in safetensors, the card in JSON, too.

policy.safetensors is the policy, sealed by a checksum; policy.json is there to be read
by people. No file runs code when loaded.
"""

import json
import warnings
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from manip.agents.networks import Actor, BinnedActor
from manip.errors import UserError, one_line
from manip.io.atomic_files import write_text
from manip.io.dataclass_values import build
from manip.io.tensor_trees import load_tree, save_tree
from manip.robot_config import RobotConfig

FORMAT = 2
"""Version of the policy files; raised when they change incompatibly."""

WEIGHTS, CARD = "policy.safetensors", "policy.json"

SHIPPED = Path(str(files("manip.assets"))) / "policies"
"""Folder of the policies that are shipped, by their names."""


@dataclass(frozen=True)
class PolicyCard:
    """What a policy was trained for: all an evaluator needs besides the weights.

    layout: observation part -> [start, stop) in the observation vector.
    env_steps: control steps of training that went into it.
    bins: values that each dimension of the action can take; 0 if it is continuous.
    """

    task: str
    robot: str
    algo: str
    controller: str
    control_freq: int
    action_dim: int
    layout: dict[str, list[int]]
    hidden: list[int]
    squash: bool
    normalise: bool
    env_steps: int
    seed: int
    versions: dict[str, str]
    bins: int = 0
    format: int = FORMAT

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def name(self) -> str:
        """Of the policy if it is shipped: its task, and its arm if not a Panda."""
        return self.task if self.robot == "Panda" else f"{self.task}-{self.robot}"

    @property
    def observation_dim(self) -> int:
        """D, the length of the observation vector."""
        return max(stop for _, stop in self.layout.values())


@dataclass(frozen=True)
class Policy:
    """A deterministic policy: observation [N, D] -> action [N, A] in [-1, 1]."""

    card: PolicyCard
    actor: Actor | BinnedActor

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """The action for each observation."""
        return self.actor.decide(observation)

    def save(self, folder: Path) -> None:
        """Write the policy's files, each whole or not at all."""
        weights = dict(self.actor.state_dict())
        save_tree(folder / WEIGHTS, {"card": asdict(self.card), "weights": weights})
        write_text(folder / CARD, _words(self.card))


def shipped_policies() -> dict[str, Path]:
    """Name -> folder of the policies that are shipped."""
    return {
        path.parent.name: path.parent for path in sorted(SHIPPED.glob(f"*/{WEIGHTS}"))
    }


def load_policy(where: str | Path) -> Policy:
    """Read a policy from its folder, the run folder around it, or by its shipped name.

    Raises:
        UserError: nothing there, damaged, or written by an incompatible version.
    """
    path = _find(where)
    tree = load_tree(path)
    card = _card(path, tree)
    try:
        with torch.device("meta"):  # a card may ask for more memory than there is
            actor = _actor(card)
        actor.load_state_dict(tree["weights"], assign=True)
        actor.float()
    except Exception as error:  # whatever a card of no policy may lead to
        raise UserError(f"{path} holds no policy: {one_line(error)}") from error
    if not all(tensor.isfinite().all() for tensor in actor.state_dict().values()):
        raise UserError(f"{path} holds weights that are not finite")
    _compare(path.with_name(CARD), card)
    return Policy(card, actor)


def _find(where: str | Path) -> Path:
    shipped, folder = shipped_policies(), Path(where)
    for path in (folder / "policy" / WEIGHTS, folder / WEIGHTS):
        if path.is_file():
            return path
    if str(where) in shipped:
        return shipped[str(where)] / WEIGHTS
    raise UserError(
        f"{where} holds no policy (no {WEIGHTS}): is it a run folder? "
        f"shipped policies: {', '.join(shipped) or 'none'}"
    )


def _actor(card: PolicyCard) -> Actor | BinnedActor:
    if card.bins:
        return BinnedActor(
            card.observation_dim, card.action_dim, card.hidden, card.bins
        )
    return Actor(
        card.observation_dim, card.action_dim, card.hidden, card.squash, card.normalise
    )


def _card(path: Path, tree: Any) -> PolicyCard:
    found = tree.get("card") if isinstance(tree, dict) else None
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        form = found.get("format") if isinstance(found, dict) else None
        raise UserError(f"{path} has format {form}, this version reads {FORMAT}")
    try:
        return build(PolicyCard, found)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error


def _compare(path: Path, card: PolicyCard) -> None:
    if path.is_file() and path.read_text(errors="replace") != _words(card):
        warnings.warn(
            f"{path} says something else than {WEIGHTS}, which is what counts",
            stacklevel=2,
        )


def _words(card: PolicyCard) -> str:
    return json.dumps(asdict(card), indent=2) + "\n"
