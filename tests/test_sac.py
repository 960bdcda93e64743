"""SAC: losses against TorchRL's and by hand, targets, schedules, learning."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from torch.distributions import Normal
from torchrl.objectives import SACLoss
from toy import QUICK_SAC, Points, make_agent, mean_return, train

from manip.agents.agent import Spaces
from manip.agents.native import sac_gradients as sac_gradients
from manip.agents.native.sac_gradients import AutogradGradients, NativeGradients
from manip.agents.off_policy import rows_of
from manip.agents.sac import SAC, SACConfig
from manip.agents.value_targets import n_step_transitions
from manip.training.collector import Rollout

SPACES = Spaces(observation_dim=5, action_dim=3)
SMALL = SACConfig(
    actor_hidden=(16,),
    critic_hidden=(16, 16),
    batch_size=32,
    buffer_size=500,
    random_steps=0,
    updates_per_step=0.125,
    actor_delay=1,
)
"""One update for a rollout of eight steps."""


def transitions(count: int = 8, seed: int = 0) -> TensorDict:
    """Single steps of random environments that do not end."""
    draw = torch.Generator().manual_seed(seed)
    flag = torch.zeros(count, 1, dtype=torch.bool)
    after = {
        "observation": torch.randn(count, 5, generator=draw),
        "reward": torch.rand(count, 1, generator=draw),
        "terminated": flag,
        "done": flag.clone(),
    }
    before = {
        "observation": torch.randn(count, 5, generator=draw),
        "action": torch.rand(count, 3, generator=draw) * 2 - 1,
        "steps_to_next_obs": torch.ones(count, 1),
    }
    return TensorDict({**before, "next": TensorDict(after, count)}, count)


def agent_of(config: SACConfig = SMALL, seed: int = 0) -> SAC:
    torch.manual_seed(seed)
    return SAC(config, SPACES)


def loss_of(agent: SAC) -> SACLoss:
    loss = agent.modules()["loss"]
    assert isinstance(loss, SACLoss)
    return loss


def shake(module: nn.Module, seed: int = 1) -> None:
    """Every parameter somewhere else, so that no two of them are equal by chance."""
    draw = torch.Generator().manual_seed(seed)
    for parameter in module.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=draw)


def gradients_of(agent: SAC) -> sac_gradients.Gradients:
    return agent._gradients


def gradients_and_losses(
    agent: SAC, batch: TensorDict
) -> tuple[list[Tensor], list[float]]:
    """Return the gradients of actor and critics, and the reported numbers."""
    rows, gradients = rows_of(batch), gradients_of(agent)
    torch.manual_seed(7)
    numbers = [gradients.critic(rows), *gradients.actor(rows)]
    return [param.grad.clone() for param in agent._params[:2]], numbers


def native_and_torchrl(config: SACConfig) -> tuple[SAC, SAC]:
    """Return two agents of equal weights; the second learns by TorchRL's losses."""
    native = agent_of(config)
    torchrl = SAC(config, SPACES, gradients="torchrl")
    shake(loss_of(native))
    loss_of(torchrl).load_state_dict(loss_of(native).state_dict())
    return native, torchrl


@pytest.mark.parametrize("scale", [(), (1.0, 0.5, 0.1)])
@pytest.mark.parametrize("size", [64, 128, 200])
@pytest.mark.parametrize(("hidden", "critics"), [((16,), 2), ((16, 24), 2), ((16,), 1)])
def test_native_gradients_are_those_of_torchrls_loss(
    scale, size, hidden, critics
) -> None:
    config = replace(
        SMALL,
        critics=critics,
        action_scale=scale,
        batch_size=size,
        actor_hidden=hidden,
        critic_hidden=hidden,
    )
    both = native_and_torchrl(config)
    assert isinstance(gradients_of(both[0]).in_use, NativeGradients)
    assert isinstance(gradients_of(both[1]), AutogradGradients)
    assert type(loss_of(both[0])) is SACLoss
    batch = transitions(size)
    batch["next", "terminated"][::5] = True
    batch["steps_to_next_obs"][::3] = 3
    (native, numbers), (torchrl, expected) = [
        gradients_and_losses(agent, batch) for agent in both
    ]
    assert numbers == pytest.approx(expected, rel=1e-5)
    for gradient, reference in zip(native, torchrl, strict=True):
        assert reference.abs().max() > 0
        torch.testing.assert_close(gradient, reference, rtol=1e-4, atol=2e-6)


def test_extreme_outputs_of_the_actor_keep_gradients_finite_and_right() -> None:
    both = native_and_torchrl(replace(SMALL, batch_size=64))
    extreme = torch.tensor([30, -30, 8, -9, 9, -40.0])
    for agent in both:
        agent.explorer.body[-1].bias.data.copy_(extreme)
    (native, _), (torchrl, _) = [
        gradients_and_losses(agent, transitions(64)) for agent in both
    ]
    for gradient, reference in zip(native, torchrl, strict=True):
        assert gradient.isfinite().all()
        torch.testing.assert_close(gradient, reference, rtol=1e-3, atol=1e-4)


def test_threads_do_not_change_a_bit() -> None:
    results = []
    for threads in (1, 2, 3):
        torch.manual_seed(0)
        agent = SAC(replace(SMALL, batch_size=500), SPACES, threads)
        results.append(gradients_and_losses(agent, transitions(500)))
    for gradients, numbers in results[1:]:
        assert numbers == results[0][1]
        assert all(map(torch.equal, gradients, results[0][0]))


def test_an_agent_learns_alike_with_native_and_torchrl_gradients() -> None:
    both = native_and_torchrl(replace(SMALL, batch_size=16))
    for agent in both:
        torch.manual_seed(0)
        for seed in range(6):
            agent.update(transitions(8, seed)[:, None])
    native, expected = [loss_of(agent).state_dict() for agent in both]
    for name, value in native.items():
        torch.testing.assert_close(value, expected[name], rtol=1e-3, atol=1e-5)


def critic_by_hand(params: TensorDict, x: Tensor) -> Tensor:
    """[2, B] values of the two critics: Linear, LayerNorm, ReLU, ..., Linear."""
    layers = sorted(params.get("module").items(), key=lambda item: int(item[0]))
    values = []
    for critic in range(2):
        out = x
        for index, (_, layer) in enumerate(layers):
            weight, bias = layer["weight"][critic], layer["bias"][critic]
            if weight.ndim == 2:
                out = out @ weight.T + bias
            else:
                out = nn.functional.layer_norm(out, weight.shape, weight, bias).relu()
            assert (index == len(layers) - 1) == (len(bias) == 1)
        values.append(out.squeeze(-1))
    return torch.stack(values)


def sample_by_hand(agent: SAC, observation: Tensor) -> tuple[Tensor, Tensor]:
    """a = tanh(u), log pi = log N(u) - sum log(1 - tanh(u)^2)."""
    loc, std = agent.explorer(observation)
    raw = loc + std * torch.randn_like(loc)
    action = raw.tanh()
    log_prob = Normal(loc, std).log_prob(raw) - (1 - action.square()).log()
    return action, log_prob.sum(-1)


@torch.no_grad()
def target_by_hand(agent: SAC, batch: TensorDict) -> Tensor:
    """y = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha log pi(a' | s'))."""
    discount = SMALL.gamma ** batch["steps_to_next_obs"].squeeze(-1)
    loss, after = loss_of(agent), batch["next"]
    action, log_prob = sample_by_hand(agent, after["observation"])
    x = torch.cat([after["observation"], action], -1)
    value = critic_by_hand(loss.target_qvalue_network_params, x).min(0).values
    future = value - loss.log_alpha.exp() * log_prob
    alive = 1 - after["terminated"].squeeze(-1).float()
    return after["reward"].squeeze(-1) + discount * alive * future


def critic_loss_by_hand(agent: SAC, batch: TensorDict) -> Tensor:
    target = target_by_hand(agent, batch)
    x = torch.cat([batch["observation"], batch["action"]], -1)
    value = critic_by_hand(loss_of(agent).qvalue_network_params, x)
    return (value - target).square().mean(1).sum()


@pytest.mark.parametrize("terminated", [False, True])
@pytest.mark.parametrize("done", [False, True])
def test_critic_regresses_on_the_soft_target(terminated: bool, done: bool) -> None:
    agent, batch = agent_of(), transitions()
    shake(loss_of(agent))
    batch["next", "terminated"][:] = terminated
    batch["next", "done"][:] = done or terminated
    torch.manual_seed(3)
    found, _ = loss_of(agent).qvalue_v2_loss(batch)
    torch.manual_seed(3)
    torch.testing.assert_close(found, critic_loss_by_hand(agent, batch))


def test_a_time_limit_is_bootstrapped_through_and_a_termination_is_not() -> None:
    agent, losses = agent_of(), {}
    shake(loss_of(agent))
    for end in ("none", "time", "termination"):
        batch = transitions()
        batch["next", "done"][:] = end != "none"
        batch["next", "terminated"][:] = end == "termination"
        torch.manual_seed(3)
        losses[end], _ = loss_of(agent).qvalue_v2_loss(batch)
    assert losses["time"] == losses["none"]
    assert losses["termination"] != losses["none"]


def test_actor_and_temperature_losses_are_the_papers() -> None:
    agent, batch = agent_of(), transitions()
    loss = loss_of(agent)
    shake(loss)
    torch.manual_seed(3)
    found, rest = loss.actor_loss(batch)
    torch.manual_seed(3)
    action, log_prob = sample_by_hand(agent, batch["observation"])
    x = torch.cat([batch["observation"], action], -1)
    value = critic_by_hand(loss.qvalue_network_params, x).min(0).values
    alpha = loss.log_alpha.exp()
    torch.testing.assert_close(found, (alpha * log_prob - value).mean())
    torch.testing.assert_close(rest["log_prob"], log_prob.detach())
    expected = -loss.log_alpha * (log_prob.detach() + SMALL.target_entropy).mean()
    torch.testing.assert_close(loss.alpha_loss(log_prob.detach()).mean(), expected)


def weights(agent: SAC, part: str) -> dict[str, Tensor]:
    state = loss_of(agent).state_dict()
    found = {k.removeprefix(part): v for k, v in state.items() if k.startswith(part)}
    assert found
    return {k: v.clone() for k, v in found.items() if v.dtype == torch.float32}


def differ(a: dict[str, Tensor], b: dict[str, Tensor]) -> bool:
    return any(not torch.equal(a[name], b[name]) for name in a)


def test_targets_start_at_the_critics_and_move_by_tau() -> None:
    agent = agent_of(replace(SMALL, tau=0.25))
    before = weights(agent, "target_qvalue_network_params")
    online = weights(agent, "qvalue_network_params")
    assert not differ(before, online)
    agent.update(transitions()[:, None])
    online = weights(agent, "qvalue_network_params")
    assert differ(before, online)
    for name, after in weights(agent, "target_qvalue_network_params").items():
        torch.testing.assert_close(after, 0.75 * before[name] + 0.25 * online[name])


def test_actor_and_temperature_move_at_every_actor_delay_th_update() -> None:
    agent = agent_of(replace(SMALL, actor_delay=3))
    moved = []
    for _ in range(7):
        critic, actor = (weights(agent, p) for p in ("qvalue_net", "actor_net"))
        alpha = loss_of(agent).log_alpha.clone()
        logged = agent.update(transitions()[:, None])
        assert differ(critic, weights(agent, "qvalue_net"))
        moved.append(differ(actor, weights(agent, "actor_net")))
        assert (loss_of(agent).log_alpha != alpha) == moved[-1]
        assert ("loss_actor" in logged) == moved[-1]
    assert moved == [False, False, True, False, False, True, False]


def test_a_fixed_temperature_stays_while_the_actor_learns() -> None:
    agent = agent_of(replace(SMALL, fixed_alpha=True, initial_alpha=0.3))
    before = weights(agent, "actor_net")
    agent.update(transitions()[:, None])
    assert differ(before, weights(agent, "actor_net"))
    assert loss_of(agent).log_alpha.exp().item() == pytest.approx(0.3)


@pytest.mark.parametrize("per_step", [0.1, 0.25, 0.75, 1.5])
def test_updates_follow_updates_per_step_whatever_the_rollouts(per_step) -> None:
    agent = agent_of(replace(SMALL, updates_per_step=per_step))
    steps = 0
    for size in (1, 8, 3, 8, 8, 1, 7):
        agent.update(transitions(size)[:, None])
        steps += size
        done = agent.extra_state()["updates"]
        assert done == pytest.approx(steps * per_step, abs=1 - 1e-6)
        assert done <= steps * per_step + 1e-6


def make_sure(agent: SAC) -> None:
    """Mean 10, small deviation: whatever the actor samples is then 1 after tanh."""
    loc, log_std = agent.explorer.body[-1].bias.data.chunk(2)
    loc.fill_(10.0)
    log_std.fill_(-10.0)


def test_warm_up_acts_uniformly_and_learns_nothing() -> None:
    agent = make_agent(replace(QUICK_SAC, random_steps=901), seed=0)
    make_sure(agent)
    before = {k: v.clone() for k, v in agent.modules()["loss"].state_dict().items()}
    batch = Rollout(Points([20] * 900)).collect(agent.policy(), 1).batch
    action = batch["action"]
    assert agent.update(batch) == {}
    assert not differ(before, agent.modules()["loss"].state_dict())
    assert action.abs().max() <= 1
    counts = torch.histc(action, bins=9, min=-1, max=1)
    assert (counts - 100).abs().max() < 45  # 100 +- 9.4 expected in each ninth


def test_the_actor_acts_after_warm_up() -> None:
    agent = agent_of(replace(SMALL, random_steps=16, updates_per_step=0))
    make_sure(agent)
    for expected in (False, False, True):
        found = agent.policy()(transitions().select("observation"))["action"]
        assert (found.min() > 0.99) == expected
        agent.update(transitions()[:, None])


def test_bursts_hold_the_grippers_of_a_share_of_the_worlds() -> None:
    policy = agent_of(replace(SMALL, gripper_bursts=0.5)).policy()
    seen = transitions(400).select("observation")
    first, second = [policy(seen.clone())["action"] for _ in range(2)]
    forced = first[:, -1].abs() == 0.9
    assert forced.float().mean() == pytest.approx(0.5, abs=0.1)
    assert (first[forced, -1] > 0).float().mean() == pytest.approx(0.5, abs=0.15)
    torch.testing.assert_close(second[forced, -1], first[forced, -1])
    assert (second[~forced, -1] != first[~forced, -1]).all()
    assert (second[:, :-1] != first[:, :-1]).all()


def test_the_deployed_actor_is_an_exponential_average() -> None:
    agent = agent_of(replace(SMALL, actor_average=0.25))
    weight, learning = agent.actor.body[-1].weight, agent.explorer.body[-1].weight
    expected = learning.detach().clone()
    for seed in range(3):
        agent.update(transitions(seed=seed)[:, None])
        expected += 0.25 * (learning.detach() - expected)
        torch.testing.assert_close(weight.detach(), expected)
    assert not torch.equal(weight, learning)


def n_steps_by_hand(batch: TensorDict, world: int, t: int, n: int, gamma: float):
    """Return, number of steps and last step of the transition that begins at t."""
    after, total, steps = batch["next"][world], 0.0, 0
    while True:
        total += gamma**steps * after["reward"][t + steps].item()
        steps += 1
        last = t + steps - 1
        if steps == n or t + steps == len(after) or after["done"][last]:
            return total, steps, last


@pytest.mark.parametrize("n", [1, 2, 3, 20])
def test_n_steps_end_with_the_episode_and_with_the_rollout(n: int) -> None:
    policy = make_agent(QUICK_SAC, seed=0).policy()
    batch = Rollout(Points([3, 4, 50])).collect(policy, 11).batch
    batch["next", "terminated"][1] = batch["next", "done"][1]
    found = n_step_transitions(batch, n, gamma=0.9)
    for world in range(3):
        for t in range(11):
            total, steps, last = n_steps_by_hand(batch, world, t, n, gamma=0.9)
            mine, end = found[world, t], batch["next"][world, last]
            assert mine["next", "reward"].item() == pytest.approx(total)
            assert mine["steps_to_next_obs"].item() == steps
            for key in ("observation", "terminated"):
                assert torch.equal(mine["next", key], end[key])
            for key in ("observation", "action"):
                assert torch.equal(mine[key], batch[world, t][key])


@pytest.mark.parametrize("seed", range(3))
def test_learns_to_go_to_the_goal(seed: int) -> None:
    untrained = mean_return(make_agent(QUICK_SAC, seed))
    assert untrained < 15
    assert mean_return(train(QUICK_SAC, seed, steps=1280)) > 16.5


def test_same_seed_gives_the_same_weights_bit_for_bit() -> None:
    first, second, other = (
        train(QUICK_SAC, seed, steps=480).modules()["loss"].state_dict()
        for seed in (0, 0, 1)
    )
    assert not differ(first, second)
    assert differ(first, other)
