"""TD3 and DQN: targets and losses by hand, schedules, exploration, learning."""

from itertools import pairwise
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, nn
from toy import QUICK_DQN, QUICK_TD3, make_agent, mean_return, train

from manip.agents.agent import Spaces
from manip.agents.dqn import DQN, DQNConfig
from manip.agents.networks import BinnedActor
from manip.agents.off_policy import OffPolicy, transitions_of
from manip.agents.policy import Policy, load_policy
from manip.agents.policy_card import PolicyCard
from manip.agents.td3 import TD3, TD3Config
from manip.errors import UserError

OBSERVATION = [{"name": "x", "shape": [5], "dtype": "float32", "role": "object"}]
SPACES = Spaces(observation_dim=5, action_dim=3)
SMALL: dict[str, Any] = {
    "gamma": 0.9,
    "critic_hidden": (16,),
    "batch_size": 32,
    "random_steps": 0,
    "updates_per_step": 0.125,
}
"""One update for a rollout of eight steps."""


def td3(**changes: Any) -> TD3:
    torch.manual_seed(0)
    return shaken(TD3(TD3Config(**SMALL | {"actor_hidden": (16,)} | changes), SPACES))


def dqn(**changes: Any) -> DQN:
    torch.manual_seed(0)
    return shaken(DQN(DQNConfig(**SMALL | changes), SPACES))


def shaken(agent: Any) -> Any:
    """Every parameter somewhere else: targets differ from what they follow."""
    for parameter in agent.modules()["loss"].parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape)
    return agent


def rows(count: int = 8) -> Tensor:
    """Transitions of three steps each; every fourth terminated."""
    found = torch.randn(count, 2 * 5 + 3 + 3)
    found[:, 5:8] = found[:, 5:8].tanh()
    found[:, -2], found[:, -1] = 3.0, (torch.arange(count) % 4 == 0).float()
    return found


def target(batch: TensorDict, future: Tensor) -> Tensor:
    """y = sum of rewards + gamma^3 (1 - terminated) future, all [B, 1]."""
    after = batch["next"]
    return after["reward"] + 0.9**3 * ~after["terminated"] * future


def value(params: TensorDict, network: nn.Module, *inputs: Tensor) -> Tensor:
    with params.to_module(network):
        return network.module(*inputs)


@pytest.mark.parametrize("critics", [1, 2])
def test_td3s_critics_regress_on_the_least_value_of_a_noisy_action(critics) -> None:
    agent = td3(critics=critics, target_noise=0.4, target_noise_clip=0.3)
    loss, batch = agent._loss, transitions_of(rows(), 5)
    torch.manual_seed(3)
    found, _ = loss.value_loss(batch)
    torch.manual_seed(3)
    noise = (0.4 * torch.randn(8, 3)).clamp(-0.3, 0.3)
    following = batch["next", "observation"]
    aim = value(loss.target_actor_network_params, loss.actor_network, following)
    action = (aim + noise).clamp(-1, 1)
    network, online = loss.qvalue_network, loss.qvalue_network_params
    futures = [
        value(loss.target_qvalue_network_params[i], network, following, action)
        for i in range(critics)
    ]
    y = target(batch, torch.stack(futures).min(0).values).detach()
    values = [
        value(online[i], network, batch["observation"], batch["action"])
        for i in range(critics)
    ]
    expected = sum((value - y).square().mean() for value in values)
    torch.testing.assert_close(found, expected)


def test_td3s_actor_climbs_the_first_critic() -> None:
    agent = td3()
    loss, state = agent._loss, torch.randn(8, 5)
    found, _ = loss.actor_loss(TensorDict({"observation": state}, 8))
    mean = agent.actor(state)[0].tanh()
    first = loss.qvalue_network_params[0]
    expected = -value(first, loss.qvalue_network, state, mean).mean()
    torch.testing.assert_close(found, expected)


def flat(agent: OffPolicy, part: str) -> Tensor:
    state = agent.modules()["loss"].state_dict()
    found = [v.flatten() for k, v in state.items() if k.startswith(part)]
    return torch.cat([v for v in found if v.dtype == torch.float32]).clone()


def test_td3s_actor_and_targets_move_at_every_actor_delay_th_update() -> None:
    agent, parts = td3(actor_delay=2), ("actor_net", "target_actor", "target_qvalue")
    states = [[flat(agent, part) for part in parts]]
    for _ in range(4):
        critics = flat(agent, "qvalue_net")
        agent._updates += 1
        agent._learn(rows())
        assert not torch.equal(critics, flat(agent, "qvalue_net"))
        states.append([flat(agent, part) for part in parts])
    moved = [
        [not torch.equal(*both) for both in zip(*neighbours, strict=True)]
        for neighbours in pairwise(states)
    ]
    assert moved == [[False] * 3, [True] * 3] * 2


def test_td3_explores_around_its_action_and_within_its_scale() -> None:
    scale = torch.tensor([1.0, 0.5, 0.1])
    agent = td3(action_scale=tuple(scale.tolist()), exploration_noise=0.3)
    state = torch.randn(1, 5).expand(4000, 5)
    action = agent.policy()(TensorDict({"observation": state}, 4000))["action"] / scale
    assert action.abs().max() <= 1 + 1e-6
    middle = agent.actor.decide(state)[0] / scale
    torch.testing.assert_close(action.median(0).values, middle, atol=0.03, rtol=0)
    assert action.std(0).max() > 0.2


@pytest.mark.parametrize("double", [True, False])
def test_dqn_regresses_on_the_value_of_the_best_bins(double: bool) -> None:
    agent = dqn(double=double, bins=4)
    loss, batch = agent._loss, transitions_of(rows(), 5)
    chosen = torch.randint(4, (8, 3))
    batch["action"] = nn.functional.one_hot(chosen, 4).flatten(-2)

    def values(params: TensorDict, observation: Tensor) -> Tensor:
        with params.to_module(loss.value_network):
            return agent.actor(observation).view(8, 3, 4)

    following = batch["next", "observation"]
    later = values(loss.target_value_network_params, following)
    chooser = values(loss.value_network_params, following) if double else later
    best = chooser.argmax(-1, keepdim=True)
    y = target(batch, later.gather(-1, best).sum(1)).detach()
    now = values(loss.value_network_params, batch["observation"])
    value_now = now.gather(-1, chosen.unsqueeze(-1)).sum(1)
    torch.testing.assert_close(loss(batch)["loss"], (value_now - y).square().mean())


def test_the_value_of_bins_is_their_mean_about_a_common_one() -> None:
    actor = BinnedActor(5, 3, (16,), bins=4)
    state = torch.randn(6, 5)
    value, advantage = actor.body(state).tensor_split([1], -1)
    centred = advantage.view(6, 3, 4)
    centred = centred - centred.mean(-1, keepdim=True)
    found = actor(state).view(6, 3, 4)
    torch.testing.assert_close(found, (value.unsqueeze(-1) + centred) / 3)


def test_bins_and_numbers_are_two_names_of_an_action() -> None:
    actor = BinnedActor(1, 2, (4,), bins=5)
    assert actor.values_of(torch.arange(5)).tolist() == [-1, -0.5, 0, 0.5, 1]
    chosen = torch.randint(5, (20, 2))
    found = actor.one_hot(actor.values_of(chosen))
    assert torch.equal(found.view(20, 2, 5).argmax(-1), chosen)
    assert torch.equal(found.sum(-1), torch.full((20,), 2))


@pytest.mark.parametrize("make", [td3, dqn])
def test_bursts_fix_the_gripper_of_a_fraction(make) -> None:
    policy = make(gripper_bursts=0.5).policy()
    action = policy(TensorDict({"observation": torch.randn(400, 5)}, [400]))["action"]
    forced = action[:, -1].abs() == 0.9
    assert forced.float().mean() == pytest.approx(0.5, abs=0.1)
    assert (action[:, :-1].abs() != 0.9).all()


@pytest.mark.parametrize("make", [td3, dqn])
def test_bursts_keep_to_the_scale_of_actions(make) -> None:
    scale = (1.0, 1.0, 0.5)
    policy = make(gripper_bursts=1.0, action_scale=scale)
    action = policy.policy()(TensorDict({"observation": torch.randn(9, 5)}, [9]))
    torch.testing.assert_close(action["action"][:, -1].abs(), torch.full((9,), 0.45))


def test_dqn_explores_with_a_share_of_epsilon_and_warms_up_at_random() -> None:
    state = TensorDict({"observation": torch.randn(1, 5).expand(3000, 5)}, 3000)
    for random_steps, epsilon in ((1, 1.0), (0, 0.3)):
        agent = dqn(random_steps=random_steps, epsilon=0.3, bins=4)
        action = agent.policy()(state)["action"]
        best = agent.actor.decide(state["observation"])
        share = (action != best).float().mean().item()
        assert share == pytest.approx(epsilon * 3 / 4, abs=0.03)


def test_a_policy_of_bins_is_saved_and_loaded(tmp_path) -> None:
    agent = dqn(bins=5, action_scale=(1.0, 0.5, 0.1))
    card = PolicyCard(
        task="Reach", robot="Panda", algo="dqn", controller="OSC_POSE",
        control_freq=20, action_dim=3, observation=OBSERVATION, hidden=[16],
        squash=False, normalise=False, env_steps=0, seed=0, versions={}, bins=5,
    )  # fmt: skip
    Policy(card, agent.actor).save(tmp_path)
    state = torch.randn(20, 5)
    assert torch.equal(load_policy(tmp_path)({"x": state}), agent.actor.decide(state))


def test_one_bin_is_refused() -> None:
    with pytest.raises(UserError, match="bins must be at least 2, not 1"):
        dqn(bins=1)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_td3_learns_to_go_to_the_goal(seed: int) -> None:
    assert mean_return(make_agent(QUICK_TD3, seed)) < 15
    assert mean_return(train(QUICK_TD3, seed, steps=1280)) > 16.5


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_dqn_learns_to_go_to_the_goal(seed: int) -> None:
    assert mean_return(make_agent(QUICK_DQN, seed)) < 15
    assert mean_return(train(QUICK_DQN, seed, steps=960)) > 15.5
