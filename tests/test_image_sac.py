"""SAC with an actor that sees images: losses by hand, what sees what, resume."""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from sameness import assert_same
from test_image_runs import options
from test_sac import shake
from torch import Tensor
from torch.distributions import Normal
from toy_images import (
    CAMERA,
    QUICK_IMAGE_SAC,
    SPACES,
    ImagePoints,
    image_agent,
    image_of,
    learn,
    mean_return,
)
from training_runs import assert_equal_runs, new_trainer, stop_after

from manip.agents.image_sac import ImageGradients, actor_inputs_of
from manip.agents.policy import load_policy
from manip.agents.replay import ImageTransitions
from manip.agents.sac import SAC
from manip.training.collector import Rollout
from manip.training.config import TrainConfig
from manip.training.initial_policy import starting_from


def batch_of(count: int = 16, seed: int = 0) -> ImageTransitions:
    """Random transitions: x, action, x', reward, one to three steps, terminated."""
    draw = torch.Generator().manual_seed(seed)
    x, action, after, reward = torch.rand(4, count, 1, generator=draw) * 2 - 1
    steps = torch.arange(count)[:, None] % 3 + 1.0
    terminated = (torch.arange(count)[:, None] % 5 == 0).float()
    rows = torch.cat([x, action, after, reward, steps, terminated], 1)
    return ImageTransitions(
        rows, {CAMERA.name: image_of(x)}, {CAMERA.name: image_of(after)}
    )


def shaken_agent(**changes: Any) -> SAC:
    agent = image_agent(replace(QUICK_IMAGE_SAC, **changes))
    shake(agent.modules()["loss"])
    return agent


def sampled(agent: SAC, images: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions a = tanh(u), and log pi(a) = log N(u) - log(1 - a^2)."""
    loc, scale = agent.explorer(torch.zeros(len(images), 0), images)
    raw = loc + scale * noise
    action = raw.tanh()
    log_prob = Normal(loc, scale).log_prob(raw) - (1 - action.square()).log()
    return action, log_prob


def values(agent: SAC, params: Any, x: Tensor, action: Tensor) -> Tensor:
    """Values [C, B, 1] of all critics."""
    loss: Any = agent.modules()["loss"]
    critic = loss.qvalue_network.module
    results = []
    for index in range(2):
        with params[index].to_module(loss.qvalue_network):
            results.append(critic(x, action))
    return torch.stack(results)


def test_the_losses_equal_those_computed_by_hand() -> None:
    """The target's action comes from the successor's image, Q from the places."""
    agent, batch = shaken_agent(), batch_of()
    loss: Any = agent.modules()["loss"]
    gradients = agent._gradients
    assert isinstance(gradients, ImageGradients)
    torch.manual_seed(3)
    numbers = [gradients.critic(batch), *gradients.actor(batch)]
    torch.manual_seed(3)
    x, action, after, reward, steps, terminated = batch.rows.split(1, 1)
    alpha = loss.log_alpha.exp().detach()
    future, log_prob = sampled(agent, batch.successors[CAMERA.name], torch.randn(16, 1))
    q = values(agent, loss.target_qvalue_network_params, after, future).amin(0)
    gamma = agent.config.gamma**steps
    target = reward + gamma * (1 - terminated) * (q - alpha * log_prob)
    critics = values(agent, loss.qvalue_network_params, x, action)
    expected = [(critics - target).square().mean((1, 2)).sum().item()]
    new, log_prob = sampled(agent, batch.images[CAMERA.name], torch.randn(16, 1))
    q = values(agent, loss.qvalue_network_params, x, new).amin(0)
    expected += [(alpha * log_prob - q).mean().item(), log_prob.mean().item()]
    assert numbers == pytest.approx(expected, rel=2e-2, abs=2e-2)  # bfloat16


def gradients_of(agent: SAC, batch: ImageTransitions) -> dict[str, Tensor]:
    torch.manual_seed(0)
    agent._gradients.critic(batch)
    agent._gradients.actor(batch)
    return {k: v.clone() for k, v in agent._params.gradients.items()}


def test_the_encoder_learns_from_the_actors_loss_only() -> None:
    agent, batch = shaken_agent(), batch_of()
    agent._params.actor.grad.zero_()
    agent._gradients.critic(batch)
    assert not agent._params.actor.grad.any()
    agent._gradients.actor(batch)
    found = {k: v.any() for k, v in agent._params.gradients.items()}
    assert any("encoders" in name for name in found)
    assert all(found.values())


def test_the_critic_sees_the_whole_state_and_the_actor_only_its_inputs() -> None:
    agent, batch = shaken_agent(), batch_of()
    before = gradients_of(agent, batch)
    rows = batch.rows.clone()
    rows[:, 0] = 0.5  # the place, which the images still show elsewhere
    after = gradients_of(agent, batch._replace(rows=rows))
    name = next(name for name in before if name.startswith("critic"))
    assert not torch.equal(before[name], after[name])
    seen_by_actor = actor_inputs_of(batch, SPACES)
    assert seen_by_actor[0].shape == (16, 0)
    assert torch.equal(seen_by_actor[1], batch.images[CAMERA.name])


def test_images_are_shifted_in_targets_and_in_the_actors_loss() -> None:
    plain = gradients_of(shaken_agent(), batch_of())
    shifted = gradients_of(shaken_agent(image_shift=2), batch_of())
    for kind in ("critic", "encoders"):
        names = [name for name in plain if name.startswith(kind)]
        assert any(not torch.equal(plain[name], shifted[name]) for name in names)


def test_a_restored_agent_goes_on_bit_for_bit() -> None:
    config = replace(QUICK_IMAGE_SAC, updates_per_step=0.05)
    agents, ends = [image_agent(config), image_agent(config, seed=1)], []
    learn(agents[0], Rollout(ImagePoints([20] * 16)), rollouts=4)
    for name, module in agents[1].modules().items():
        module.load_state_dict(agents[0].modules()[name].state_dict())
    for name, optimiser in agents[1].optimisers().items():
        optimiser.load_state_dict(deepcopy(agents[0].optimisers()[name].state_dict()))
    agents[1].load_extra_state(agents[0].extra_state())
    for agent in agents:
        torch.manual_seed(5)
        learn(agent, Rollout(ImagePoints([20] * 16, seed=2)), rollouts=2)
        modules = {name: m.state_dict() for name, m in agent.modules().items()}
        ends.append({"modules": modules, "agent": agent.extra_state()})
    assert_same(*ends)


def run_of(folder: Path, **changes: Any) -> TrainConfig:
    agent = {
        "rollout_length": 4,
        "batch_size": 16,
        "buffer_size": 48,
        "actor_hidden": [16],
        "critic_hidden": [16],
        "random_steps": 16,
        "updates_per_step": 0.5,
        "image_channels": [4, 8],
        "image_features": 8,
        "image_shift": 1,
    }
    return options(folder, algo="sac", teacher=None, agent=agent, **changes)


@pytest.mark.slow
def test_a_run_resumes_bit_for_bit_and_its_policy_starts_another(
    tmp_path: Path,
) -> None:
    """The second run fine-tunes the first one's policy, in one piece and in two."""
    first = run_of(tmp_path)
    assert new_trainer(first).run()
    where = str(first.folder)
    whole = starting_from(run_of(tmp_path, out=str(tmp_path / "whole")), where)
    trainer = new_trainer(whole)
    loaded, gradients = trainer.parts.notes
    assert "layers loaded; new: the critics" in loaded
    assert "TorchRL's losses" in gradients
    policy, actor = load_policy(where).actor, trainer.parts.agent.actor
    state = torch.ones(3, 7), torch.full((3, 16, 16, 6), 9, dtype=torch.uint8)
    assert torch.equal(policy.decide(*state), actor.decide(*state))
    assert trainer.run()
    parts = replace(whole, out=tmp_path / "parts")
    stopped = new_trainer(parts)
    stop_after(stopped, 2)
    assert not stopped.run()
    assert new_trainer(replace(parts, resume=True)).run()
    assert_equal_runs(whole.folder, parts.folder)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_learns_to_go_to_the_goal_from_images(seed: int) -> None:
    agent = image_agent(seed=seed)
    learn(agent, Rollout(ImagePoints([20] * 16, seed)), rollouts=12)
    assert mean_return(agent) > 15.5
