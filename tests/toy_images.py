"""The toy problem with images: the actor sees an image of the point, not its place."""

from collections.abc import Sequence

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Unbounded
from toy import Points

from manip.agents.actor_inputs import ActorInputs
from manip.agents.agent import Spaces
from manip.agents.sac import SAC, SACConfig
from manip.evaluation.episodes import run_episodes
from manip.observation import ObservationPart
from manip.training.collector import Rollout

CAMERA = ObservationPart("eye_image", (8, 8, 3), "uint8", "camera")

SPACES = Spaces(1, 1, ActorInputs(columns=(), cameras=(CAMERA,)))
"""The critic sees the place x; the actor sees the image only."""

QUICK_IMAGE_SAC = SACConfig(
    learning_rate=3e-3,
    actor_average=0.05,
    batch_size=64,
    actor_hidden=(32,),
    critic_hidden=(32,),
    image_channels=(8,),
    image_features=16,
    target_entropy=-1.0,
    buffer_size=5_000,
    random_steps=320,
)


def image_of(x: Tensor) -> Tensor:
    """Images [N, 8, 8, 3] of points x [N, 1]: a bright stripe where the point is."""
    columns = torch.linspace(-1, 1, 8)
    stripe = (255 * torch.exp(-20 * (columns - x).square())).to(torch.uint8)
    return stripe[:, None, :, None].expand(-1, 8, 8, 3).contiguous()


class ImagePoints(Points):
    """`Points` that also gives an image of each point."""

    def __init__(self, limits: Sequence[int], seed: int = 0) -> None:
        super().__init__(limits, seed)
        shape = (len(limits), *CAMERA.shape)
        self.observation_spec[CAMERA.name] = Unbounded(shape, dtype=torch.uint8)

    def _tensors(self, truncated: Tensor) -> TensorDict:
        return super()._tensors(truncated).set(CAMERA.name, image_of(self.x))

    def parts(self, state: TensorDictBase) -> dict[str, Tensor]:
        return super().parts(state) | {CAMERA.name: state[CAMERA.name]}


def image_agent(config: SACConfig = QUICK_IMAGE_SAC, seed: int = 0) -> SAC:
    torch.manual_seed(seed)
    return SAC(config, SPACES)


def learn(agent: SAC, rollout: Rollout, rollouts: int) -> None:
    for _ in range(rollouts):
        agent.update(rollout.collect(agent.policy(), agent.rollout_length).batch)


def mean_return(agent: SAC) -> float:
    """Return of the deterministic policy, mean of 100 episodes of 20 steps."""

    def act(parts: dict[str, Tensor]) -> Tensor:
        image = parts[CAMERA.name]
        return agent.actor.decide(torch.zeros(len(image), 0), image)

    episodes = run_episodes(ImagePoints([20] * 100, seed=123), act, 100)
    return sum(episode.total_reward for episode in episodes) / len(episodes)
