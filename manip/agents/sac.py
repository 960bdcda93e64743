"""Soft actor-critic (Haarnoja et al. 2018, arXiv 1812.05905), with TorchRL's SACLoss.

    critic:      min (Q_i(s, a) - y)^2,
                 y = r + gamma r' + ... + gamma^n (1 - terminated) V(s')
                 V(s') = min_i Q'_i(s', a') - alpha log pi(a' | s'),  a' ~ pi(. | s')
    actor:       min alpha log pi(a | s) - min_i Q_i(s, a),  a ~ pi(. | s)
    temperature: min -log(alpha) (log pi(a | s) + target entropy)

s' is the state n steps later; Q' is the exponential average of Q. A time limit is no
termination: y bootstraps from the true last observation. For n > 1 the target leaves
out the entropy of steps 1 to n - 1, and the actions of those steps are older policies'
(off-policy bias, not corrected).

The deployed actor is the exponential average of the learned one (Polyak and Juditsky
1992), as the success rates of consecutive actors differ by 10 % and more.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Annotated, Any

import torch
from tensordict.nn import TensorDictModule, TensorDictModuleBase
from torch import Generator, Tensor, nn
from torch.optim import Adam
from torchrl.modules import ProbabilisticActor, TanhNormal
from torchrl.objectives import SACLoss

from manip.agents.agent import Spaces
from manip.agents.exploration import RolloutPolicy
from manip.agents.flat_parameters import flatten
from manip.agents.image_actor import ImageActor
from manip.agents.image_sac import ImageGradients, SeeingActor, actor_inputs_of
from manip.agents.kickstart import Kickstart
from manip.agents.make_actor import ImageConfig, make_actor
from manip.agents.native.gradient_check import GradientSource
from manip.agents.native.sac_gradients import Gradients, flatten_loss, sac_gradients
from manip.agents.networks import Actor
from manip.agents.off_policy import OffPolicy, OffPolicyConfig, make_critics
from manip.agents.trajectory import CPU
from manip.io.option_ranges import COUNT, NUMBER, POSITIVE, SHARE, SIGNED, WHOLE

AnyActor = Actor | ImageActor


@dataclass(frozen=True)
class SACConfig(OffPolicyConfig, ImageConfig):
    """Options of SAC; defaults suit manipulation at 20 Hz, rewards in [0, 1]."""

    actor_hidden: Annotated[tuple[int, ...], COUNT] = (128, 128)
    """Widths of the actor's hidden layers."""
    actor_delay: Annotated[int, COUNT] = 2
    """Critic updates for each update of the actor and the temperature."""
    critic_steps: Annotated[int, WHOLE] = 0
    """Control steps, after the random ones, in which only the critics learn (critic
    warm-up): an actor that starts from a policy keeps it until they are of use."""
    initial_weight: Annotated[float, NUMBER] = 0.0
    """Weight of the squared distance from the initial policy's actions in the actor's
    loss (kickstarting), with --init: larger keeps the actor nearer to it."""
    initial_steps: Annotated[int, COUNT] = 100_000
    """Control steps over which initial_weight falls linearly to 0."""
    actor_average: Annotated[float, SHARE] = 0.005
    """Fraction by which the deployed actor moves to the learned one at its updates."""
    critics: Annotated[int, COUNT] = 2
    """Number of critics; targets and actor use the lowest value."""
    initial_alpha: Annotated[float, POSITIVE] = 0.1
    """Temperature at the start (entropy coefficient): more explores more."""
    fixed_alpha: bool = False
    """Keep the temperature at its initial value."""
    target_entropy: Annotated[float, SIGNED] = -3.5
    """Entropy [nat] of actions in [-1, 1] that the temperature is adapted to."""


class SAC(OffPolicy):
    """SAC; see the module's docstring.

    Args:
        gradients: native code, checked against SACLoss, or SACLoss and autograd, which
            is the only one on other devices than the CPU.
        device: where networks, replay buffer and updates are.
    """

    name = "sac"
    Config = SACConfig
    has_native_gradients = True
    takes_device = True
    sees_images = True
    takes_datasets = True
    actor: AnyActor

    def __init__(
        self,
        config: SACConfig,
        spaces: Spaces,
        threads: int = 1,
        gradients: GradientSource = "native",
        device: torch.device = CPU,
    ) -> None:
        super().__init__(config, spaces, device)
        self.config = config
        self.explorer = make_actor(
            spaces,
            config,
            config.actor_hidden,
            squash=True,
            normalise=False,
            action_scale=config.action_scale,
        ).to(device)
        self.actor = deepcopy(self.explorer)
        self._kickstart = _kickstart(config, self.explorer)
        self._deployed = flatten([*self.actor.parameters()]).data
        self._loss = _loss(config, spaces, self.explorer)
        self._params = flatten_loss(self._loss, self.explorer)
        self._gradients = self._make_gradients(threads, gradients)
        rate = config.learning_rate
        self._critic_optim = Adam([self._params.critics], rate, fused=True)
        self._actor_optim = Adam([self._params.actor], rate, fused=True)

    def _make_gradients(self, threads: int, source: GradientSource) -> Gradients:
        """Those of the loss; always TorchRL's for an actor that sees images."""
        config, loss, params = self.config, self._loss, self._params
        if isinstance(self.explorer, ImageActor):
            dim, shift = self._spaces.observation_dim, config.image_shift
            return ImageGradients(loss, params, dim, shift)
        form = config.gamma, config.batch_size, threads, source
        return sac_gradients(loss, params, self.explorer, *form)

    def policy(self) -> TensorDictModuleBase:
        """Return uniform actions at first, later samples of the learned actor."""
        inputs, bursts = self._spaces.inputs, self.config.gripper_bursts
        return RolloutPolicy(self.explorer, inputs, _sample, self.warming_up, bursts)

    def start_from(self, weights: Mapping[str, Tensor], deviation: float) -> None:
        """See `Agent.start_from`."""
        for actor in (self.explorer, self.actor):
            actor.load_state_dict(weights)
            actor.set_deviation(deviation)
        if self._kickstart:
            self._kickstart.start_from(weights)

    def modules(self) -> dict[str, nn.Module]:
        """Return the deployed actor, the loss, and the initial policy if needed."""
        initial = {"initial": self._kickstart} if self._kickstart else {}
        return {"actor": self.actor, "loss": self._loss, **initial}

    def optimisers(self) -> dict[str, torch.optim.Optimizer]:
        """Return one for the critics, one for actor and temperature."""
        return {"critic": self._critic_optim, "actor": self._actor_optim}

    def _learn(self, rows: Any) -> dict[str, float]:
        loss = self._gradients.critic(rows)
        self._critic_optim.step()
        self._params.targets.data.lerp_(self._params.critics.data, self.config.tau)
        alone = self._critic_alone(self.config.critic_steps)
        if alone or self._updates % self.config.actor_delay:
            return {}
        return {"loss_critic": loss, **self._improve(rows)}

    def _improve(self, rows: Any) -> dict[str, float]:
        loss, log_prob = self._gradients.actor(rows)
        logged = self._stay_near_initial(rows)
        if self.config.fixed_alpha:
            self._params.gradient_of_alpha().zero_()
        self._actor_optim.step()
        latest = self._params.actor.data[:-1]
        self._deployed.lerp_(latest, self.config.actor_average)
        alpha = self._params.actor.data[-1].exp().item()
        return {"loss_actor": loss, "alpha": alpha, "entropy": -log_prob, **logged}

    def _stay_near_initial(self, rows: Any) -> dict[str, float]:
        """Add the gradient of the distance from the initial policy, if it counts."""
        if not self._kickstart or not self._kickstart.weight(self._steps):
            return {}
        inputs = actor_inputs_of(rows, self._spaces)
        return {"distance": self._kickstart.add_gradient(self._steps, *inputs)}


def _kickstart(config: SACConfig, actor: AnyActor) -> Kickstart | None:
    if not config.initial_weight:
        return None
    return Kickstart(actor, config.initial_weight, config.initial_steps)


def _sample(actor: AnyActor, inputs: tuple[Tensor, ...], draw: Generator) -> Tensor:
    loc, scale = actor(*inputs)
    noise = torch.randn(loc.shape, generator=draw, device=loc.device)
    return (loc + scale * noise).tanh()


def _loss(config: SACConfig, spaces: Spaces, actor: AnyActor) -> SACLoss:
    module: nn.Module = actor
    if isinstance(actor, ImageActor):
        module = SeeingActor(actor, spaces.inputs)
    stochastic = ProbabilisticActor(
        TensorDictModule(module, [*spaces.inputs.keys], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": -actor.action_scale, "high": actor.action_scale},
        return_log_prob=True,
    )
    loss = SACLoss(
        stochastic,
        make_critics(
            config.critics, spaces, config.critic_hidden, actor.action_scale.device
        ),
        num_qvalue_nets=config.critics,
        loss_function="l2",
        alpha_init=config.initial_alpha,
        target_entropy=config.target_entropy + actor.action_scale.log().sum().item(),
    )
    loss.make_value_estimator(gamma=config.gamma)
    return loss
