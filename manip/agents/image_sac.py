"""Gradients of SAC's losses for an actor that sees images (asymmetric actor-critic).

The critics see the whole joined observation (privileged information, which only a
simulator has), the actor images and the entries that a real arm knows (Pinto et al.
2017, arXiv 1710.06542). The critics are discarded after training. The encoders learn
from the actor's loss only, and images are shifted at random in it and in the targets
(DrQ, Kostrikov et al. 2020, arXiv 2004.13649).
"""

from torch import Tensor, nn
from torchrl.objectives import SACLoss

from manip.agents.actor_inputs import ActorInputs
from manip.agents.agent import Spaces
from manip.agents.flat_parameters import zero_gradient
from manip.agents.image_actor import ImageActor
from manip.agents.image_encoder import fast_precision, random_shift
from manip.agents.native.sac_gradients import FlatParams
from manip.agents.off_policy import transitions_of
from manip.agents.replay import ImageTransitions


class SeeingActor(nn.Module):
    """An actor as losses call it: with the whole joined observation, and images."""

    def __init__(self, actor: ImageActor, inputs: ActorInputs) -> None:
        super().__init__()
        self.actor, self._inputs = actor, inputs

    def forward(self, observation: Tensor, *images: Tensor) -> tuple[Tensor, Tensor]:
        """Return mean and standard deviation [B, A] of observations [B, D]."""
        with fast_precision():
            features = self.actor.features(self._inputs.vector(observation), *images)
        loc, scale = self.actor.head(features.float())
        return loc, scale


class ImageGradients:
    """TorchRL's SACLoss and autograd; there is no native code for images.

    Args:
        loss: its actor is a `SeeingActor`.
        params: the loss's, flat.
        observation_dim: D.
        shift: largest shift of the images [pixel].
    """

    def __init__(
        self, loss: SACLoss, params: FlatParams, observation_dim: int, shift: int
    ) -> None:
        self._loss, self._params = loss, params
        self._states, self._shift = observation_dim, shift

    def critic(self, batch: ImageTransitions) -> float:
        """Write the critics' gradients; return the sum of their losses."""
        transitions = transitions_of(batch.rows, self._states)
        transitions["next"].update(self._shifted(batch.successors))
        zero_gradient(self._params.critics)
        loss, _ = self._loss.qvalue_v2_loss(transitions)
        loss.backward()
        return float(loss.detach())

    def actor(self, batch: ImageTransitions) -> tuple[float, float]:
        """Write the gradients of actor and temperature.

        Returns:
            The actor's loss and the mean of log pi(a | s).
        """
        transitions = transitions_of(batch.rows, self._states)
        transitions.update(self._shifted(batch.images))
        zero_gradient(self._params.actor)
        loss, outputs = self._loss.actor_loss(transitions)
        log_prob = outputs["log_prob"]
        (loss + self._loss.alpha_loss(log_prob).mean()).backward()
        return float(loss.detach()), float(log_prob.mean())

    def _shifted(self, images: dict[str, Tensor]) -> dict[str, Tensor]:
        return {
            name: random_shift(image, self._shift) for name, image in images.items()
        }


def actor_inputs_of(
    batch: Tensor | ImageTransitions, spaces: Spaces
) -> tuple[Tensor, ...]:
    """What the actor sees at the beginning of transitions: vector and images [B, ...].

    Args:
        batch: rows (see `rows_of`), or rows with images.
    """
    rows, images = (batch, {}) if isinstance(batch, Tensor) else batch[:2]
    vector = spaces.inputs.vector(rows[:, : spaces.observation_dim])
    return vector, *images.values()
