"""A trained policy, and its files.

policy.safetensors holds weights and card, with a checksum: it is the policy.
policy.json holds the same card, and the form of the network, for people and programs
without this package (docs/numpy_policy/act.py). Loading runs no code of a file.
"""

import json
import warnings
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from manip.agents.image_actor import ImageActor
from manip.agents.network_form import network_form
from manip.agents.networks import Actor, BinnedActor
from manip.agents.policy_card import PolicyCard, read_card
from manip.errors import UserError, one_line
from manip.io.atomic_files import write_text
from manip.io.tensor_trees import load_tree, save_tree
from manip.observation import ObservationPart

WEIGHTS, CARD = "policy.safetensors", "policy.json"

SHIPPED = Path(str(files("manip.assets"))) / "policies"
"""Folder of the policies that are shipped, by their names."""

MOST_BYTES = 2**30
"""Largest policy file that is read."""

LARGEST_WEIGHT = 1e6
"""Largest weight that a policy may have: beyond, actions overflow."""


AnyActor = Actor | BinnedActor | ImageActor


@dataclass(frozen=True)
class Policy:
    """A deterministic policy: observation parts -> action [N, A] in [-1, 1]."""

    card: PolicyCard
    actor: AnyActor

    @torch.no_grad()
    def __call__(self, parts: Mapping[str, Any]) -> Tensor:
        """Return the action [N, A] of an observation.

        Args:
            parts: name -> [N, *shape], at least those that the card names; images are
                uint8.

        Raises:
            UserError: an image has another shape or type than the card says.
        """
        spec = self.card.observation_spec
        images = [_image(parts[p.name], p) for p in spec.parts if p.role == "camera"]
        vectors = [torch.as_tensor(parts[name]).flatten(1) for name in spec.slices]
        none = [image.new_zeros((len(image), 0), dtype=torch.float) for image in images]
        return self.actor.decide(torch.cat([*none, *vectors], -1), *images)

    @property
    def described(self) -> dict[str, Any]:
        """The card as plain values, with the form of the network as `network`."""
        return asdict(self.card) | {"network": network_form(self.actor)}

    def save(self, folder: Path) -> None:
        """Write the policy's files, each whole or not at all."""
        weights = dict(self.actor.state_dict())
        save_tree(folder / WEIGHTS, {"card": asdict(self.card), "weights": weights})
        write_text(folder / CARD, json.dumps(self.described, indent=2) + "\n")

    def digest(self) -> str:
        """64 hexadecimal digits that identify the weights (SHA-256)."""
        digest = sha256()
        for name, weight in sorted(self.actor.state_dict().items()):
            digest.update(name.encode() + weight.contiguous().numpy().tobytes())
        return digest.hexdigest()


def _image(value: Any, part: ObservationPart) -> Tensor:
    """An image [N, H, W, C], checked: others would be encoded to nonsense."""
    image = torch.as_tensor(value)
    if image.dtype != torch.uint8 or tuple(image.shape[1:]) != part.shape:
        raise UserError(
            f"{part.name} must be uint8 [N, {', '.join(map(str, part.shape))}], not "
            f"{image.dtype} {[*image.shape]}"
        )
    return image


def shipped_policies() -> dict[str, Path]:
    """Return the policies that are shipped: name -> folder."""
    return {
        path.parent.name: path.parent for path in sorted(SHIPPED.glob(f"*/{WEIGHTS}"))
    }


def load_policy(where: str | Path) -> Policy:
    """Read a policy from its folder, the run folder around it, or by its shipped name.

    Raises:
        UserError: there is none, it is damaged, or of an incompatible version.
    """
    path = _find(where)
    if path.stat().st_size > MOST_BYTES:
        raise UserError(f"{path} holds no policy: it is larger than {MOST_BYTES} bytes")
    tree = load_tree(path)
    try:
        card = read_card(tree.get("card") if isinstance(tree, dict) else None)
        actor = _load_actor(card, tree["weights"])
    except Exception as error:  # a file can hold anything
        raise UserError(f"{path} holds no policy: {one_line(error)}") from error
    _compare(path.with_name(CARD), card)
    return Policy(card, actor)


def _find(where: str | Path) -> Path:
    shipped, folder = shipped_policies(), Path(where)
    for path in (folder / "policy" / WEIGHTS, folder / WEIGHTS):
        if path.is_file():
            return path
    if str(where) in shipped:
        return shipped[str(where)] / WEIGHTS
    raise UserError(f"{where} holds no policy: {_why_none(folder, shipped)}")


def _why_none(folder: Path, shipped: Collection[str]) -> str:
    if (folder / "config.yaml").is_file():
        return "the run has not been evaluated yet, and saves one when it is"
    runs = sorted(path.parts[-3] for path in folder.glob(f"*/policy/{WEIGHTS}"))
    if runs:
        return f"it is a folder of runs, name one of them: {', '.join(runs)}"
    names = {name.casefold(): name for name in shipped}
    close = get_close_matches(str(folder).casefold(), names, n=1)
    hint = f"did you mean {names[close[0]]}" if close else "is it a run folder"
    return f"no {WEIGHTS}, {hint}? shipped policies: {', '.join(shipped) or 'none'}"


def _load_actor(card: PolicyCard, weights: Any) -> AnyActor:
    with torch.device("meta"):  # a card may name networks larger than the memory
        actor = _actor(card)
    _check_weights(weights, actor.state_dict())
    actor.load_state_dict(weights, assign=True)
    return actor


def _actor(card: PolicyCard) -> AnyActor:
    sizes = card.observation_dim, card.action_dim, card.hidden
    if card.bins:
        return BinnedActor(*sizes, card.bins)
    if encoders := card.encoder_sizes:
        return ImageActor(encoders, *sizes, card.squash, card.normalise)
    return Actor(*sizes, card.squash, card.normalise)


def _check_weights(weights: Any, expected: Mapping[str, Tensor]) -> None:
    """Raise `UserError` unless names, shapes, dtypes and ranges are as they must be."""
    if not isinstance(weights, Mapping) or weights.keys() != expected.keys():
        raise UserError("its weights have other names than the card's network")
    for name, tensor in weights.items():
        wanted = expected[name]
        if not isinstance(tensor, Tensor) or tensor.dtype != wanted.dtype:
            raise UserError(f"weights {name} are not a tensor of {wanted.dtype}")
        if tensor.shape != wanted.shape:
            raise UserError(
                f"weights {name} have shape {[*tensor.shape]}, not {[*wanted.shape]}"
            )
        if not tensor.isfinite().all():
            raise UserError(f"{name} holds weights that are not finite")
        if not name.startswith("norm.") and tensor.abs().max() > LARGEST_WEIGHT:
            raise UserError(f"{name} holds weights beyond {LARGEST_WEIGHT:g}")


def _compare(path: Path, card: PolicyCard) -> None:
    if path.is_file() and _from_json(path.read_text(errors="replace")) != card:
        warnings.warn(
            f"{path} differs from the card in {WEIGHTS}, which is the one that is used",
            stacklevel=2,
        )


def _from_json(text: str) -> PolicyCard | None:
    """The card in a JSON file, whose later fields may be missing; None without."""
    try:
        values = json.loads(text)
        values.pop("network", None)
        return read_card(values)
    except Exception:  # a file can hold anything
        return None
