"""The benchmark of learners: all do the same work, and operations are counted."""

from dataclasses import replace

import pytest
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from manip.agents.networks import mlp
from manip.benchmarks import bench_learner as learner
from manip.benchmarks import flop_counts, learner_manip, learner_torchrl
from manip.benchmarks.bench_learner import PPO, SAC, figures, operations
from manip.benchmarks.learner_problem import Problem, transitions

TINY = Problem(
    hidden=(8, 8),
    observation=5,
    action=2,
    batch=16,
    stored=64,
    updates=4,
    num_envs=4,
    length=8,
    minibatch=16,
    epochs=2,
)


def counted(run) -> float:
    with FlopCounterMode(display=False) as counter:
        run()
    return counter.get_total_flops()


def test_forward_is_what_pytorch_counts() -> None:
    net, rows = mlp(5, 3, (8, 6)), torch.randn(16, 5)
    assert counted(lambda: net(rows)) == flop_counts.forward((5, 8, 6, 3), 16)


def test_a_ppo_epoch_is_what_pytorch_counts() -> None:
    actor, critic = mlp(5, 2, (8, 8)), mlp(5, 1, (8, 8))
    rows = torch.randn(32, 5)
    values = counted(lambda: (actor(rows).sum() + critic(rows).sum()).backward())
    assert values == flop_counts.ppo_epoch(5, 2, (8, 8), 32)


def sac_by_hand(rows: int) -> None:
    """Every matrix product of SAC's losses, and no other."""
    actor, critics = mlp(5, 4, (8, 8)), [mlp(7, 1, (8, 8)) for _ in range(2)]
    states, actions = torch.randn(rows, 5), torch.randn(rows, 2)
    with torch.no_grad():
        following = torch.cat([states, actor(states)[:, :2]], 1)
        for target in critics:
            target(following)
    pairs = torch.cat([states, actions], 1)
    sum(critic(pairs).sum() for critic in critics).backward()
    for critic in critics:
        critic.requires_grad_(False)
    chosen = actor(states)[:, :2]
    values = sum(_split(critic, states, chosen) for critic in critics)
    values.sum().backward()


def _split(critic: nn.Sequential, states: torch.Tensor, actions: torch.Tensor):
    """Q(s, a) with the first layer cut in two: no gradient is carried to states."""
    first = critic[0]
    of_state = states @ first.weight[:, :5].T
    return critic[1:](of_state + actions @ first.weight[:, 5:].T + first.bias)


def test_a_sac_update_is_what_pytorch_counts() -> None:
    sizes = (5, 2, (8, 8), 16)
    both, delayed = (flop_counts.sac_update(*sizes, delay) for delay in (1, 2))
    assert counted(lambda: sac_by_hand(16)) == both
    assert both / 2 < delayed < both


def test_the_peak_is_measured_on_one_thread(monkeypatch) -> None:
    monkeypatch.setattr(flop_counts, "PRODUCTS", ((64, 64, 64),))
    threads = torch.get_num_threads()
    assert 1e8 < flop_counts.core_peak(seconds=0.01) < 1e13
    assert torch.get_num_threads() == threads


def test_episodes_end_at_their_time_limit_only() -> None:
    values = transitions(TINY, 50, 40)["next"]
    assert 0 < values["done"].float().mean() < 0.1
    assert torch.equal(values["done"], values["truncated"])
    assert not values["terminated"].any()


def weights(agent) -> torch.Tensor:
    return nn.utils.parameters_to_vector(agent.actor.parameters()).clone()


@pytest.mark.parametrize("threads", [1, 2])
def test_manip_makes_the_number_of_updates_that_it_returns(
    threads: int, monkeypatch
) -> None:
    agents = []
    original = learner_manip.SAC.__init__

    def recording(agent, *arguments):
        original(agent, *arguments)
        agents.append(agent)

    monkeypatch.setattr(learner_manip.SAC, "__init__", recording)
    run = learner_manip.sac(TINY, threads, actor_delay=1)
    (agent,) = agents
    assert agent.extra_state()["updates"] == 0
    before = weights(agent)
    assert run() == TINY.updates == agent.extra_state()["updates"]
    assert (weights(agent) != before).any()
    assert run() == TINY.updates
    assert agent.extra_state()["updates"] == 2 * TINY.updates


def test_manips_ppo_makes_its_epochs() -> None:
    run = learner_manip.ppo(TINY, 1)
    assert [run(), run()] == [TINY.epochs] * 2


def test_the_torchrl_script_learns() -> None:
    assert learner_torchrl.sac(TINY)(1) == TINY.updates
    run = learner_torchrl.ppo(TINY)
    assert [run(1), run(1)] == [TINY.epochs] * 2


def test_stable_baselines3_makes_its_updates() -> None:
    sb3 = pytest.importorskip("manip.benchmarks.learner_sb3", exc_type=ImportError)
    assert sb3.sac(TINY)(1) == TINY.updates
    run = sb3.ppo(TINY)
    assert [run(1), run(1)] == [TINY.epochs] * 2


def test_figures_use_the_best_threads_and_the_lowest_ratio_of_networks(
    monkeypatch,
) -> None:
    monkeypatch.setattr(learner, "usable_cpus", lambda: 2)
    small, large = TINY, replace(TINY, hidden=(16, 16))
    medians = {"manip": (3, 6), "SB3": (2, 1), "TorchRL script": (1, 1)}
    rounds = {
        learner._name(what, problem, who, threads): [speed * scale] * 3
        for what in (SAC, PPO)
        for problem, scale in ((small, 1.0), (large, 0.5))
        for who, speeds in medians.items()
        for threads, speed in zip((1, 2), speeds, strict=True)
    }
    rounds[learner._name(SAC, large, "SB3", 1)] = [2.0] * 3
    values = figures(rounds, (small, large), core_peak=1e6)
    assert values["sac_updates_vs_sb3_2x8"] == 3
    assert values["sac_updates_vs_sb3_2x16"] == 1.5 == values["sac_updates_vs_sb3"]
    assert values["ppo_epoch_vs_sb3"] == 3
    assert values["ppo_epoch_vs_torchrl"] == 6
    share = 6 * operations(small, PPO) / 2e6
    assert values["ppo_epoch_share_of_peak_2x8"] == pytest.approx(share)
