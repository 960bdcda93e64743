"""PPO: advantages and objective by hand, epochs, log-probabilities, learning."""

from copy import deepcopy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.distributions import Normal
from torchrl.modules import ValueOperator
from torchrl.objectives import PPOLoss
from torchrl.objectives.value import GAE
from toy import (
    QUICK_PPO,
    SPACES,
    make_agent,
    mean_return,
    rollout_of,
    three_steps,
    train,
)

from manip.agents.agent import Agent, Spaces
from manip.agents.native.ppo_gradients import AutogradGradients, NativeGradients
from manip.agents.ppo import PPO, PPOConfig
from manip.agents.value_targets import add_values


def loss_of(agent: Agent) -> PPOLoss:
    loss = agent.modules()["loss"]
    assert isinstance(loss, PPOLoss)
    return loss


@pytest.mark.parametrize(
    ("terminated", "advantage"),
    [
        # d = [1 + .9 * 1 - .5, 2 + .9 * 4 - 1, 3 + .9 * 2.5 - 1.5]; A0 = d0 + .72 d1
        (False, [1.4 + 0.72 * 4.6, 4.6, 3.75]),
        # d1 = 2 - 1: nothing is expected after a termination
        (True, [1.4 + 0.72 * 1.0, 1.0, 3.75]),
    ],
)
def test_advantages_of_three_steps(terminated: bool, advantage: list[float]) -> None:
    values = ValueOperator(nn.Identity(), in_keys=["observation"])
    batch = add_values(three_steps(terminated), values)
    GAE(gamma=0.9, lmbda=0.8, value_network=None)(batch)
    expected = torch.tensor(advantage).view(1, 3, 1)
    torch.testing.assert_close(batch["advantage"], expected)
    torch.testing.assert_close(batch["value_target"], expected + batch["observation"])


def advantage_by_hand(batch: TensorDictBase, gamma: float, decay: float) -> Tensor:
    """A_t = d_t + gamma lambda A_t+1 within an episode, by loops."""
    value, following = batch["state_value"], batch["next", "state_value"]
    after, advantage = batch["next"], torch.zeros_like(value)
    for world in range(value.shape[0]):
        later = 0.0
        for t in reversed(range(value.shape[1])):
            alive = not after["terminated"][world, t]
            future = gamma * alive * following[world, t]
            delta = after["reward"][world, t] + future - value[world, t]
            ended = bool(after["done"][world, t])
            later = delta + (0.0 if ended else gamma * decay * later)
            advantage[world, t] = later
    return advantage


def test_an_update_estimates_advantages_by_the_recursion() -> None:
    agent = make_agent(QUICK_PPO, seed=0)
    batch = rollout_of(agent)
    batch["next", "terminated"][1] = batch["next", "done"][1]
    assert batch["next", "done"].sum() == 4 + 2
    agent.update(batch)
    expected = advantage_by_hand(batch, QUICK_PPO.gamma, QUICK_PPO.gae_lambda)
    torch.testing.assert_close(batch["advantage"], expected)
    torch.testing.assert_close(batch["value_target"], expected + batch["state_value"])


def test_every_step_is_followed_by_the_value_of_its_true_successor() -> None:
    critic = ValueOperator(nn.Linear(1, 1), in_keys=["observation"])
    batch = add_values(rollout_of(make_agent(QUICK_PPO, seed=0)), critic)
    after = critic(batch["next"].select("observation"))["state_value"]
    torch.testing.assert_close(batch["next", "state_value"], after.detach())


def learnable(agent: Agent) -> TensorDictBase:
    """A batch whose policy has moved since, some ratios beyond the clip range."""
    batch = rollout_of(agent).reshape(-1)
    draw = torch.Generator().manual_seed(0)
    for name in ("advantage", "value_target"):
        batch[name] = torch.randn(len(batch), 1, generator=draw)
    for parameter in agent.actor.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=draw)
    return batch


@pytest.mark.parametrize("clip", [0.2, None])
def test_losses_are_the_clipped_objective_and_the_squared_error(clip) -> None:
    agent = make_agent(replace(QUICK_PPO, clip=clip), seed=0)
    batch = learnable(agent)
    distribution = Normal(*agent.actor(batch["observation"]))
    log_prob = distribution.log_prob(batch["action"]).sum(-1)
    ratio = (log_prob - batch["action_log_prob"]).exp()
    assert ((ratio - 1).abs() > 0.2).any()
    assert ((ratio - 1).abs() < 0.2).any()
    advantage = batch["advantage"].squeeze(-1)
    advantage = (advantage - advantage.mean()) / advantage.std()
    gain = ratio * advantage
    if clip:
        gain = torch.minimum(gain, ratio.clamp(1 - clip, 1 + clip) * advantage)
    loss = loss_of(agent)
    with loss.critic_network_params.to_module(loss.critic_network):
        value = loss.critic_network(batch.clone())["state_value"]
    error = (value - batch["value_target"]).square().mean()
    entropy = distribution.entropy().sum(-1).mean()
    found = loss(batch)
    torch.testing.assert_close(found["loss_objective"], -gain.mean())
    torch.testing.assert_close(found["loss_critic"], 0.5 * error)
    torch.testing.assert_close(found["loss_entropy"], -0.002 * entropy)


def native_and_torchrl(config: PPOConfig, spaces: Spaces) -> tuple[PPO, PPO]:
    """Return two agents of equal weights; the second learns by TorchRL's losses."""
    torch.manual_seed(0)
    native = PPO(config, spaces, threads=2)
    torchrl = PPO(config, spaces, gradients="torchrl")
    draw = torch.Generator().manual_seed(1)
    native._params.data += 0.1 * torch.randn(native._params.shape, generator=draw)
    native.actor.norm.update(3 * torch.randn(50, spaces.observation_dim) + 1)
    loss_of(torchrl).load_state_dict(loss_of(native).state_dict())
    return native, torchrl


@pytest.mark.parametrize("size", [40, 128, 300])
@pytest.mark.parametrize(
    ("scale", "clip"), [((), 0.2), ((1.0, 0.5, 0.1), 0.2), ((), None)]
)
def test_native_gradients_are_those_of_torchrls_loss(size, scale, clip) -> None:
    config = replace(QUICK_PPO, action_scale=scale, clip=clip, critic_hidden=(16, 24))
    both = native_and_torchrl(config, Spaces(5, 3))
    assert isinstance(both[0]._gradients.in_use, NativeGradients)
    assert isinstance(both[1]._gradients, AutogradGradients)
    state = torch.randn(size, 5)
    mean, std = both[0].actor(state)
    action = (mean + std * torch.randn_like(mean)).detach()
    log_prob = Normal(mean, std).log_prob(action).sum(-1, keepdim=True).detach()
    old = log_prob + 0.3 * torch.randn(size, 1)
    rows = torch.cat([state, action, old, torch.randn(size, 2)], -1)
    native, expected = [agent._gradients(rows)._asdict() for agent in both]
    if clip:
        assert 0.1 < native["clip_fraction"] < 0.9
    ratio = (log_prob - old).exp()
    kl = (ratio - 1 - ratio.log()).mean().item()
    assert native["kl"] == pytest.approx(kl, rel=1e-4)
    assert native == pytest.approx(expected, rel=1e-4)
    gradients = [agent._params.grad for agent in both]
    assert gradients[1].abs().max() > 0
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-6)


def test_a_minibatch_of_one_has_gradients_too() -> None:
    """TorchRL leaves the advantage of one sample as it is, without a deviation."""
    both = native_and_torchrl(QUICK_PPO, Spaces(5, 3))
    row = torch.randn(1, 5 + 3 + 3)
    row[:, 8] = Normal(*both[0].actor(row[:, :5])).log_prob(row[:, 5:8]).sum().detach()
    for agent in both:
        agent._gradients(row)
    gradients = [agent._params.grad for agent in both]
    assert gradients[1].abs().max() > 0
    torch.testing.assert_close(*gradients, rtol=1e-4, atol=1e-6)


def test_an_agent_learns_alike_with_native_and_torchrl_gradients() -> None:
    both, logged = native_and_torchrl(QUICK_PPO, SPACES), []
    batches = [rollout_of(both[0]) for _ in range(3)]
    for agent in both:
        torch.manual_seed(0)
        logged.append([agent.update(batch.clone()) for batch in batches])
    for mine, expected in zip(*logged, strict=True):
        assert mine == pytest.approx(expected, rel=1e-3, abs=1e-5)
    native, expected = [loss_of(agent).state_dict() for agent in both]
    for name, value in native.items():
        torch.testing.assert_close(value, expected[name], rtol=1e-3, atol=1e-5)


def test_native_and_torchrl_gradients_stop_at_the_same_kl_divergence() -> None:
    config = replace(QUICK_PPO, epochs=20, learning_rate=0.01, target_kl=0.02)
    steps = []
    for gradients in ("native", "torchrl"):
        torch.manual_seed(0)
        agent = PPO(config, SPACES, gradients=gradients)
        agent.update(rollout_of(agent))
        steps.append(steps_of(agent))
    assert steps[0] == steps[1]
    assert 1 < steps[0] // config.minibatches < config.epochs


def test_the_logged_kl_divergence_is_that_of_the_whole_update() -> None:
    agent = make_agent(replace(QUICK_PPO, learning_rate=0.02), seed=0)
    batch = rollout_of(agent)
    norm = deepcopy(agent.actor.norm)
    logged = agent.update(batch)
    agent.actor.norm = norm  # it takes in the rollout after the update
    old, new = batch["action_log_prob"], Normal(*agent.actor(batch["observation"]))
    log_ratio = new.log_prob(batch["action"]).sum(-1) - old
    kl = (log_ratio.exp() - 1 - log_ratio).mean().item()
    assert kl > 1e-3
    assert logged["kl"] == pytest.approx(kl, rel=1e-4)


def test_rollout_log_probabilities_are_the_losss_also_after_updates() -> None:
    agent = make_agent(QUICK_PPO, seed=0)
    for _ in range(3):
        batch = rollout_of(agent)
        distribution = loss_of(agent).actor_network.get_dist(batch)
        log_prob = distribution.log_prob(batch["action"])
        torch.testing.assert_close(batch["action_log_prob"], log_prob.detach())
        agent.update(batch)


def steps_of(agent: Agent) -> int:
    (optimiser,) = agent.optimisers().values()
    (count,) = {int(state["step"]) for state in optimiser.state.values()}
    return count


@pytest.mark.parametrize(("target_kl", "epochs"), [(-1e9, 1), (1e9, 4), (None, 4)])
def test_a_far_moved_policy_ends_the_epochs(
    target_kl: float | None, epochs: int
) -> None:
    config = replace(QUICK_PPO, epochs=4, minibatches=3, target_kl=target_kl)
    agent = make_agent(config, seed=0)
    agent.update(rollout_of(agent))
    assert steps_of(agent) == 3 * epochs


def test_a_large_step_size_trips_the_default_target_kl() -> None:
    config = replace(QUICK_PPO, epochs=20, minibatches=2, learning_rate=0.05)
    agent = make_agent(config, seed=0)
    agent.update(rollout_of(agent))
    assert steps_of(agent) < 20 * 2
    assert PPOConfig().target_kl == config.target_kl


def test_observations_seen_set_the_norm_of_actor_and_critic() -> None:
    agent = make_agent(QUICK_PPO, seed=0)
    batches = [rollout_of(agent) for _ in range(2)]
    for batch in batches:
        agent.update(batch)
    seen = torch.cat([batch["observation"].flatten() for batch in batches])
    state = loss_of(agent).state_dict()
    means = [value for name, value in state.items() if "norm.mean" in name]
    assert means
    for mean in (agent.actor.norm.mean, *means):
        torch.testing.assert_close(mean, seen.mean().view(1))


@pytest.mark.parametrize("seed", range(3))
def test_learns_to_go_to_the_goal(seed: int) -> None:
    untrained = mean_return(make_agent(QUICK_PPO, seed))
    assert untrained < 12
    assert mean_return(train(QUICK_PPO, seed, steps=3200)) > 15.5


def test_same_seed_gives_the_same_weights_bit_for_bit() -> None:
    first, second, other = (
        train(QUICK_PPO, seed, steps=960).modules()["loss"].state_dict()
        for seed in (0, 0, 1)
    )
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert any(not torch.equal(first[name], other[name]) for name in first)
