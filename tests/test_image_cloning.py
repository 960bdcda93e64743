"""Behaviour cloning from images: the losses by hand, and learning in seconds."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch.nn.functional import l1_loss

from manip.agents.actor_inputs import ActorInputs
from manip.agents.agent import Spaces
from manip.agents.bc import BC, BCConfig
from manip.observation import ObservationPart

CAMERA = ObservationPart("front_image", (16, 16, 3), "uint8", "camera")
SPACES = Spaces(3, 2, ActorInputs((0,), (CAMERA,)))
"""The actor sees the gripper's opening; the two coordinates of a ball are hidden."""

QUICK = BCConfig(
    actor_hidden=(32,),
    image_channels=(8, 16),
    image_features=32,
    batch_size=64,
    learning_rate=3e-3,
    updates_per_step=0.25,
    buffer_size=4_096,
)


def drawn(ball: torch.Tensor) -> torch.Tensor:
    """Images [N, 16, 16, 3] of a bright disc at places [N, 2] from -1 to 1."""
    grid = torch.linspace(-1, 1, 16)
    rows = grid[None, :, None] - ball[:, 1, None, None]
    columns = grid[None, None, :] - ball[:, 0, None, None]
    bright = 255 * (1 - (rows**2 + columns**2) * 6).clamp(0, 1)
    return bright[..., None].expand(-1, -1, -1, 3).byte()


def labelled(count: int, seed: int = 0) -> TensorDict:
    """Steps [1, count] of an expert that moves towards the ball if it is open."""
    generator = torch.Generator().manual_seed(seed)
    vector = torch.rand(count, 3, generator=generator) * 2 - 1
    ball, open_ = vector[:, 1:], (vector[:, :1] > 0).float()
    steps = {
        "observation": vector,
        "expert_action": 0.8 * ball * open_,
        "front_image": drawn(ball),
    }
    return TensorDict(steps, count)[None]


def agent_of(config: BCConfig = QUICK) -> BC:
    torch.manual_seed(0)
    return BC(config, SPACES)


def missed(agent: BC) -> float:
    """Mean distance of actions from the expert's, on steps that were not trained on."""
    test = labelled(500, seed=99).squeeze(0)
    action = agent.actor.decide(*SPACES.inputs.of(test))
    return l1_loss(action, test["expert_action"]).item()


def test_it_learns_from_images_what_the_expert_does_with_the_state() -> None:
    agent = agent_of()
    before = missed(agent)
    for seed in range(4):
        losses = agent.update(labelled(256, seed))
    assert before > 0.25
    assert missed(agent) < 0.1
    assert losses["loss_prediction"] < 0.2


def test_the_losses_are_distances_of_actions_and_of_hidden_entries() -> None:
    config = replace(QUICK, batch_size=4_096, updates_per_step=1 / 512, auxiliary=0.5)
    agent, batch = agent_of(config), labelled(512)
    actor, predict = agent.actor, agent.modules()["prediction"]
    with torch.no_grad():
        features = actor.features(*SPACES.inputs.of(batch))
        action = l1_loss(actor.head.decide(features), batch["expert_action"])
        hidden = l1_loss(predict(features), batch["observation"][..., 1:])
    losses = agent.update(batch)  # drawn with repeats, and of less precision
    assert losses["loss_actor"] == pytest.approx(action.item(), rel=0.05)
    assert losses["loss_prediction"] == pytest.approx(0.5 * hidden.item(), rel=0.05)


def test_images_are_shifted_in_updates_only() -> None:
    plain, shifted = (agent_of(replace(QUICK, image_shift=shift)) for shift in (0, 4))
    batch = labelled(256)
    losses = [agent.update(batch)["loss_actor"] for agent in (plain, shifted)]
    assert losses[0] != losses[1]
    again = agent_of(replace(QUICK, image_shift=4))
    again.actor.load_state_dict(plain.actor.state_dict())
    assert missed(again) == missed(plain)


def test_a_weight_of_zero_leaves_the_prediction_out() -> None:
    agent = agent_of(replace(QUICK, auxiliary=0.0))
    assert agent.modules().keys() == {"actor"}
    assert agent.update(labelled(64)).keys() == {"loss_actor"}


def test_the_student_acts_from_images_in_the_last_environments() -> None:
    agent = agent_of(replace(QUICK, noise=0.0, clones=0.5))
    now = labelled(6).squeeze(0)
    assert torch.equal(agent.policy()(now.clone())["action"], now["expert_action"])
    agent.update(labelled(64))
    action = agent.policy()(now.clone())["action"]
    own = agent.actor.decide(*SPACES.inputs.of(now[3:]))
    assert torch.equal(action[:3], now["expert_action"][:3])
    assert torch.equal(action[3:], own)
    assert not torch.equal(action[3:], now["expert_action"][3:])
