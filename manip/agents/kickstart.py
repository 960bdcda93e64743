"""Keep a learning actor near the policy that it started from, less and less.

    actor loss + weight(t) mean (pi(s) - pi_0(s))^2

pi and pi_0 are the deterministic actions of the actor and of the initial policy. The
weight falls linearly to 0. A distillation loss of falling weight is called kickstarting
(Schmitt et al. 2018, arXiv 1803.03835); the squared distance is that of TD3+BC
(Fujimoto and Gu 2021, arXiv 2106.06860). Without it, a critic that knows little beyond
the actions of the initial policy leads the actor away from it at once.
"""

from collections.abc import Mapping
from copy import deepcopy

from torch import Tensor, nn

from manip.agents.image_actor import ImageActor
from manip.agents.networks import Actor


class Kickstart(nn.Module):
    """Distance from the initial policy, with a weight that falls to 0.

    Args:
        actor: the network that learns.
        weight: of the distance at the start.
        steps: control steps after which the weight is 0.
    """

    def __init__(self, actor: Actor | ImageActor, weight: float, steps: int) -> None:
        super().__init__()
        self._learned = [actor]  # no submodule: others save and train it
        self.initial = deepcopy(actor).requires_grad_(False)
        self._weight, self._steps = weight, steps

    def start_from(self, weights: Mapping[str, Tensor]) -> None:
        """Set the initial policy."""
        self.initial.load_state_dict(weights)

    def weight(self, steps: int) -> float:
        """The weight after so many control steps."""
        return self._weight * max(0.0, 1 - steps / self._steps)

    def add_gradient(self, steps: int, *inputs: Tensor) -> float:
        """Add the gradient of the weighted distance to those of the actor.

        Args:
            steps: control steps so far.
            inputs: of the actor, a batch of states.

        Returns:
            The distance, without its weight.
        """
        actor = self._learned[0]
        distance = actor.decide(*inputs) - self.initial.decide(*inputs)
        loss = distance.square().mean()
        (self.weight(steps) * loss).backward()
        return float(loss.detach())
