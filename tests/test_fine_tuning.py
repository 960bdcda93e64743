"""Algorithms that change a reference: DPO and cloning by hand, references, PEBBLE."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor
from torch.distributions import Normal, kl_divergence

from manip.agents.agent import Spaces
from manip.agents.clone_best import CloneBest, CloneBestConfig, best_steps
from manip.agents.compared_clips import ComparedClips
from manip.agents.dpo import DPO, DPOConfig
from manip.agents.gaussian_bc import GaussianBC, GaussianBCConfig, VariedExpert
from manip.agents.networks import Actor
from manip.agents.pebble import PEBBLE, PEBBLEConfig
from manip.agents.policy import Policy
from manip.agents.policy_card import PolicyCard
from manip.agents.ppo_kl import PPOKL, PPOKLConfig
from manip.errors import UserError

SPACES = Spaces(3, 2)
LENGTH = 6


def save_policy(actor: Actor, folder: Path, algo: str = "bc") -> str:
    part = {"name": "x", "shape": [3], "dtype": "float32", "role": "object"}
    card = PolicyCard(
        task="Reach", robot="Panda", algo=algo, controller="OSC_POSE",
        control_freq=20, action_dim=2, observation=[part], hidden=[8],
        squash=actor.squash, normalise=not actor.squash, env_steps=0, seed=0,
        versions={},
    )  # fmt: skip
    Policy(card, actor).save(folder)
    return str(folder)


def new_actor(squash: bool) -> Actor:
    actor = Actor(3, 2, (8,), squash=squash, normalise=not squash)
    for parameter in actor.parameters():
        parameter.data += 0.1 * torch.randn(parameter.shape)
    return actor


def options(folder: Path, squash: bool) -> dict[str, Any]:
    reference = save_policy(new_actor(squash), folder)
    form = {"actor_hidden": (8,), "squash": squash, "normalise": not squash}
    return {"reference": reference, **form}


def compared(count: int = 12) -> ComparedClips:
    """The better clip has larger actions."""
    left, right = torch.randn(2, count, LENGTH, 5)
    better = left[..., 3:].sum((1, 2)) > right[..., 3:].sum((1, 2))
    return ComparedClips(left, right, better.float())


def log_prob(gaussian: Any, clip: Tensor) -> Tensor:
    return Normal(*gaussian(clip[..., :3])).log_prob(clip[..., 3:]).sum()


@pytest.mark.parametrize("squash", [False, True])
def test_the_loss_of_dpo_by_hand(squash: bool, tmp_path: Path) -> None:
    torch.manual_seed(0)
    agent = DPO(DPOConfig(alpha=0.3, **options(tmp_path, squash)), SPACES)
    for parameter in agent.gaussian.parameters():
        parameter.data += 0.05 * torch.randn(parameter.shape)
    pairs = compared(3)
    pairs = replace(pairs, target=torch.tensor([1.0, 0.0, 0.5]))
    expected = []
    for left, right, y in zip(pairs.left, pairs.right, pairs.target, strict=True):
        ratios = [
            log_prob(agent.gaussian, clip) - log_prob(agent.reference, clip)
            for clip in (left, right)
        ]
        better, worse = (torch.sigmoid(0.3 * d) for d in _both(*ratios))
        expected.append(-y * better.log() - (1 - y) * worse.log())
    mean = torch.stack(expected).mean().float()
    torch.testing.assert_close(agent.loss(pairs), mean, rtol=1e-4, atol=1e-4)


def _both(left: Tensor, right: Tensor) -> tuple[Tensor, Tensor]:
    """The difference and its negative, in numbers that do not round to 0 or 1."""
    difference = (left - right).double()
    return difference, -difference


def test_dpo_begins_without_preference_and_learns_the_answers(tmp_path: Path) -> None:
    agent, pairs = DPO(DPOConfig(**options(tmp_path, False)), SPACES), compared()
    assert agent.loss(pairs).item() == pytest.approx(0.6931, abs=1e-4)
    agent.compare(pairs)
    learned = agent.loss(pairs).item()
    assert learned < 0.6
    torch.manual_seed(0)
    first = agent.compare(pairs)
    torch.manual_seed(0)
    assert agent.compare(pairs) == first  # each round starts from the reference


def test_the_winners_are_cloned(tmp_path: Path) -> None:
    config = CloneBestConfig(source="winners", **options(tmp_path, False))
    agent, pairs = CloneBest(config, SPACES), compared(40)
    before = agent.actor.decide(pairs.left[..., :3]).mean()
    agent.compare(pairs)
    assert agent.actor.decide(pairs.left[..., :3]).mean() > before


def test_the_best_whole_episodes_are_chosen() -> None:
    """Episode 2 pays most, but did not end; of the others, episode 1 pays most."""
    episode = torch.tensor([0, 0, 1, 1, 1, 2, 3])[:, None]
    after = {
        "reward": torch.tensor([0.1, 0.2, 0.5, 0.6, 0.5, 0.9, 0.3])[:, None, None],
        "done": torch.tensor([0, 1, 0, 0, 1, 0, 1]).bool()[:, None, None],
    }
    steps = TensorDict({"episode": episode, "next": TensorDict(after, (7, 1))}, (7, 1))
    assert best_steps(steps, 0.34)["episode"].tolist() == [1, 1, 1]
    assert best_steps(steps, 0.67)["episode"].tolist() == [1, 1, 1, 3]
    assert best_steps(steps, 0.0)["episode"].tolist() == [1, 1, 1]


@pytest.mark.parametrize("squash", [False, True])
@pytest.mark.parametrize(("agent", "config"), [(PPOKL, PPOKLConfig), (DPO, DPOConfig)])
def test_any_kind_of_reference_acts_as_before(
    agent: Any, config: Any, squash: bool, tmp_path: Path
) -> None:
    torch.manual_seed(1)
    given = options(tmp_path, squash)
    torch.manual_seed(1)
    reference = new_actor(squash)
    started = agent(config(reference_std=0.15, **given), SPACES)
    states = torch.randn(9, 3)
    assert torch.equal(started.actor.decide(states), reference.decide(states))
    _, std = started.gaussian(states)
    expected = 0.15 if squash else reference.log_std.exp().expand_as(std)
    torch.testing.assert_close(std, torch.as_tensor(expected).expand_as(std))


@pytest.mark.parametrize("agent", [PPOKL, DPO])
def test_a_reference_of_another_form_is_refused(agent: Any, tmp_path: Path) -> None:
    config = (PPOKLConfig if agent is PPOKL else DPOConfig)(
        **options(tmp_path, False) | {"actor_hidden": (9,)}
    )
    with pytest.raises(UserError, match="other networks than this run"):
        agent(config, SPACES)


def test_the_divergence_in_the_rewards_estimates_the_closed_form(
    tmp_path: Path,
) -> None:
    """The mean of log(pi / pi_ref) over samples of pi is KL(pi || pi_ref)."""
    agent = PPOKL(PPOKLConfig(reference_beta=1.0, **options(tmp_path, True)), SPACES)
    for parameter in agent.gaussian.parameters():
        parameter.data += 0.05 * torch.randn(parameter.shape)
    states = torch.randn(200, 100, 3)
    batch = agent.policy()(TensorDict({"observation": states}, (200, 100)))
    batch["next"] = TensorDict({"reward": torch.zeros(200, 100, 1)}, (200, 100))
    estimate = agent._penalise(batch)["kl_reference"]
    policies = [Normal(*g(states)) for g in (agent.gaussian, agent._reference)]
    exact = kl_divergence(*policies).sum(-1).mean().item()
    assert estimate == pytest.approx(exact, rel=0.05)
    assert -batch["next", "reward"].mean().item() == pytest.approx(exact, rel=0.05)


def test_the_normaliser_of_a_reference_stays(tmp_path: Path) -> None:
    agents = [
        PPOKL(PPOKLConfig(**options(tmp_path, False) | changes), SPACES)
        for changes in ({}, {"reference": None})
    ]
    for agent, moves in zip(agents, (False, True), strict=True):
        before = agent.actor.norm.mean.clone()
        agent._update_norm(1 + torch.randn(4, 5, 3))
        assert (not torch.equal(agent.actor.norm.mean, before)) == moves


def test_demonstrations_vary_around_the_expert() -> None:
    expert = torch.full((2000, 7), 0.5)
    still = GaussianBCConfig(haste=(1.0, 1.0), wrist=0.0, noise=0.0)
    same = VariedExpert(still)(TensorDict({"expert_action": expert}, 2000))
    assert torch.equal(same["action"], expert)
    policy = VariedExpert(GaussianBCConfig(haste=(0.4, 0.8), wrist=0.1, noise=0.0))
    first, second = (
        policy(TensorDict({"expert_action": expert}, 2000))["action"] for _ in range(2)
    )
    assert torch.equal(first, second)  # haste and turn last for a rollout
    assert first[:, :3].min() >= 0.2
    assert first[:, :3].max() <= 0.4
    assert first[:, 3:6].std().item() == pytest.approx(0.1, rel=0.1)
    assert torch.equal(first[:, 6], expert[:, 6])


def test_the_clone_takes_over_mean_and_spread_of_the_demonstrations() -> None:
    torch.manual_seed(0)
    agent = GaussianBC(
        GaussianBCConfig(actor_hidden=(32,), updates_per_step=0.5), SPACES
    )
    for _ in range(12):
        states = torch.randn(8, 32, 3)
        action = 0.3 * states[..., :2] + 0.2 * torch.randn(8, 32, 2)
        flags = torch.zeros(8, 32, 1, dtype=torch.bool)
        after = {"observation": states, "reward": 0 * flags.float()}
        after |= {"done": flags, "terminated": flags}
        batch = {"observation": states, "action": action}
        agent.update(TensorDict(batch | {"next": TensorDict(after, (8, 32))}, (8, 32)))
    mean, std = agent.actor(torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    assert (mean - 0.3 * torch.eye(2)).abs().max() < 0.1
    assert std.mean().item() == pytest.approx(0.2, rel=0.3)


@pytest.mark.parametrize("haste", [(0.5,), (0.9, 0.4)])
def test_a_haste_of_another_form_is_refused(haste: tuple[float, ...]) -> None:
    with pytest.raises(UserError, match="a least and a greatest factor"):
        GaussianBC(GaussianBCConfig(haste=haste), SPACES)


@pytest.mark.parametrize("reset", [False, True])
def test_rewards_are_relabelled_and_critics_reset_after_a_round(reset: bool) -> None:
    config = PEBBLEConfig(
        buffer_size=64, batch_size=8, random_steps=0, reset_critics=reset
    )
    agent = PEBBLE(config, SPACES)
    new = agent._params.critics.data.clone()
    flags = torch.zeros(4, 8, 1, dtype=torch.bool)
    after = {"observation": torch.randn(4, 8, 3), "reward": 0 * flags.float()}
    after |= {"done": flags, "terminated": flags, "measures": torch.randn(4, 8, 2)}
    batch = TensorDict(
        {
            "observation": torch.randn(4, 8, 3),
            "action": torch.rand(4, 8, 2) - 0.5,
            "next": TensorDict(after, (4, 8)),
        },
        (4, 8),
    )
    agent.update(batch)
    assert not torch.equal(agent._params.critics.data, new)
    agent.relabel(lambda steps: steps["next", "measures"].sum(-1, keepdim=True))
    steps = agent.replay.steps()
    expected = steps["next", "measures"].sum(-1, keepdim=True)
    assert torch.equal(steps["next", "reward"], expected)
    assert torch.equal(agent._params.critics.data, new) == reset
    assert torch.equal(agent._params.targets.data, new) == reset
