"""A trained policy as files: weights in safetensors, everything else in JSON."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from manip.agents.networks import Actor
from manip.errors import UserError, one_line
from manip.files import replace_file, write_text

FORMAT = 1
"""Version of the policy files; raised when they change incompatibly."""

WEIGHTS, CARD = "policy.safetensors", "policy.json"


@dataclass(frozen=True)
class PolicyCard:
    """What a policy was trained for: all an evaluator needs besides the weights.

    layout: observation part -> [start, stop) in the observation vector.
    env_steps: control steps of training that went into it.
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
    format: int = FORMAT

    @property
    def observation_dim(self) -> int:
        """D, the length of the observation vector."""
        return max(stop for _, stop in self.layout.values())


@dataclass(frozen=True)
class Policy:
    """A deterministic policy: observation [N, D] -> action [N, A] in [-1, 1]."""

    card: PolicyCard
    actor: Actor

    @torch.no_grad()
    def __call__(self, observation: Tensor) -> Tensor:
        """The action for each observation."""
        return self.actor.decide(observation)

    def save(self, folder: Path) -> None:
        """Write the policy's files, each whole or not at all."""
        weights = {name: t.contiguous() for name, t in self.actor.state_dict().items()}
        replace_file(folder / WEIGHTS, lambda to: save_file(weights, to))
        write_text(folder / CARD, json.dumps(asdict(self.card), indent=2) + "\n")


def load_policy(where: str | Path) -> Policy:
    """Read a policy from its folder, or from the run folder around it.

    Raises:
        UserError: nothing there, damaged, or written by an incompatible version.
    """
    folder = Path(where)
    if (folder / "policy" / CARD).is_file():
        folder = folder / "policy"
    if not (folder / CARD).is_file():
        raise UserError(f"{folder} holds no policy (no {CARD}): is it a run folder?")
    card = _card(folder / CARD)
    try:
        actor = _actor(card)
    except (AttributeError, RuntimeError, TypeError, ValueError) as error:
        raise UserError(
            f"{folder / CARD} describes no network: {one_line(error)}"
        ) from error
    try:
        actor.load_state_dict(load_file(folder / WEIGHTS))
    except (SafetensorError, RuntimeError, FileNotFoundError) as error:
        raise UserError(
            f"{folder / WEIGHTS} does not hold this policy: {one_line(error)}"
        ) from error
    return Policy(card, actor)


def _actor(card: PolicyCard) -> Actor:
    return Actor(
        card.observation_dim, card.action_dim, card.hidden, card.squash, card.normalise
    )


def _card(path: Path) -> PolicyCard:
    try:
        found: dict[str, Any] = json.loads(path.read_text())
        if found["format"] != FORMAT:
            raise UserError(
                f"{path} has format {found['format']}, this version reads {FORMAT}"
            )
        return PolicyCard(**found)
    except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not a policy card: {error}") from error
