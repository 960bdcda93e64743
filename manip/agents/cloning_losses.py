"""Losses of behaviour cloning: distances from the expert's actions.

TorchRL's BCLoss for actors that see a vector. Actors that see images share their
features with an auxiliary prediction of what they do not see, in one pass.
"""

import warnings
from collections.abc import Mapping

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor, nn
from torch.nn.functional import l1_loss
from torchrl.objectives import BCLoss

from manip.agents.actor_inputs import ActorInputs
from manip.agents.agent import Spaces
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import fast_precision, random_shift
from manip.agents.networks import Actor, widths_of

# BCLoss has no target networks, and warns of it.
warnings.filterwarnings("ignore", "The name target_actor_network_params")


class VectorCloning:
    """min |pi(s) - a*|, for actors that see a vector.

    Attributes:
        extra: modules that only the loss needs: none.
    """

    def __init__(self, actor: Actor) -> None:
        self.extra: Mapping[str, nn.Module] = {}
        decision = TensorDictModule(
            _Decision(actor), ["observation"], ["expert_action"]
        )
        self._loss = BCLoss(decision, loss_function="l1")
        self._loss.set_keys(action="expert_action")

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Name -> loss of labelled steps [B]; their sum is minimised."""
        return {"actor": self._loss(batch)["loss_bc"]}


class _Decision(nn.Module):
    """An actor's deterministic action."""

    def __init__(self, actor: Actor) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, observation: Tensor) -> Tensor:
        return self.actor.decide(observation)


class ImageCloning:
    """min |pi(s) - a*| + weight |f(s) - p|, for actors that see images.

    f is linear in the actor's features, and p the entries of the observation that the
    actor does not see, such as objects' poses. Images are shifted at random.

    Args:
        weight: of the prediction.
        shift: largest shift of an image [pixel].

    Attributes:
        extra: modules that only the loss needs: f.
    """

    def __init__(
        self, actor: ImageActor, spaces: Spaces, weight: float, shift: int
    ) -> None:
        self._actor, self._inputs = actor, spaces.inputs
        self._weight, self._shift = weight, shift
        self._hidden = _hidden_columns(spaces.inputs, spaces.observation_dim)
        self.extra: Mapping[str, nn.Module] = {}
        if weight and self._hidden:
            features = widths_of(actor.body)[0]
            self.extra = {"prediction": nn.Linear(features, len(self._hidden))}

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Name -> loss of labelled steps [B]; their sum is minimised."""
        vector, *images = self._inputs.of(batch)
        shifted = [random_shift(image, self._shift) for image in images]
        with fast_precision():
            features = self._actor.features(vector, *shifted)
        features = features.float()
        action = self._actor.head.decide(features)
        losses = {"actor": l1_loss(action, batch["expert_action"])}
        for name, module in self.extra.items():
            hidden = batch["observation"][..., self._hidden]
            losses[name] = self._weight * l1_loss(module(features), hidden)
        return losses


def _hidden_columns(inputs: ActorInputs, observation_dim: int) -> list[int]:
    """Columns of the joined observation that the actor does not see."""
    visible = range(observation_dim) if inputs.columns is None else inputs.columns
    return sorted(set(range(observation_dim)) - set(visible))


def cloning_losses(
    actor: Actor | ImageActor, spaces: Spaces, weight: float, shift: int
) -> VectorCloning | ImageCloning:
    """The losses of an actor; `weight` and `shift` matter to actors with images."""
    if isinstance(actor, ImageActor):
        return ImageCloning(actor, spaces, weight, shift)
    return VectorCloning(actor)
