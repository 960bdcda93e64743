"""A3C: the gradients of its workers, their age, determinism, learning."""

from dataclasses import replace
from threading import Event

import pytest
import torch
from tensordict import TensorDictBase
from toy import QUICK_A2C, SPACES, Points, make_agent, mean_return

from manip.agents.a2c import A2C
from manip.agents.a3c import A3C, A3CConfig
from manip.rewards.reward_function import EnvironmentReward
from manip.training.collector import Collector, Order, Rollout

QUICK = A3CConfig(
    learning_rate=1e-2,
    gamma=0.9,
    actor_hidden=(32,),
    critic_hidden=(32,),
    workers=3,
)


def points(workers: int) -> list[Points]:
    """16 points, shared by the workers."""
    size = 16 // workers
    return [Points([20] * size, seed=worker) for worker in range(workers)]


def collector_of(envs: list[Points], agent: A2C, order: Order) -> Collector:
    sources = [Rollout(env) for env in envs]
    return Collector(sources, agent, False, EnvironmentReward(), order)


def run(agent: A2C, workers: int, steps: int, asynchronous: bool = False) -> A2C:
    """After so many control steps of 16 points, shared by the workers."""
    torch.manual_seed(5)
    envs = points(workers)
    collector = collector_of(envs, agent, "first" if asynchronous else "turns")
    for _ in range(steps // (envs[0].batch_size[0] * agent.rollout_length)):
        agent.update(collector.next().batch)
    return agent


def weights(agent: A2C) -> torch.Tensor:
    return agent._params.data.clone()


def test_one_worker_is_a2c() -> None:
    agent = run(make_agent(replace(QUICK, workers=1), seed=0), 1, 1280)
    other = run(make_agent(QUICK_A2C, seed=0), 1, 1280)
    assert torch.equal(weights(agent), weights(other))


def test_a_gradient_is_of_the_parameters_that_its_worker_copied() -> None:
    agent = make_agent(QUICK, seed=0)
    policy = agent.policy()
    copied = weights(agent)
    agent._params.data += 1
    assert torch.equal(policy.copy._params.data, copied)
    batch = Points([20] * 4).rollout(8, policy, break_when_any_done=False)
    found = agent.process_rollout(policy, batch.clone())
    alone = A2C(QUICK, SPACES)
    alone.load(policy.copy)
    alone._max_gradient = 1e9
    alone.update(batch)
    torch.testing.assert_close(found["gradient"], alone.gradient)


def test_shared_parameters_move_twice_while_one_of_three_works() -> None:
    agent = make_agent(QUICK, seed=0)
    begun_at, moves = [], []
    policy, update = agent.policy, agent.update
    agent.policy = lambda: (begun_at.append(len(moves)), policy())[1]
    agent.update = lambda batch: (update(batch), moves.append(1))[0]
    run(agent, 3, 5 * 8 * 6)
    ages = [taken - begun for taken, begun in enumerate(begun_at[: len(moves)])]
    assert ages == [0, 1, 2, 2, 2, 2]


def test_threads_do_not_change_a_bit() -> None:
    first, second = (run(make_agent(QUICK, seed=0), 3, 2400) for _ in range(2))
    assert torch.equal(weights(first), weights(second))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_learns_to_go_to_the_goal(seed: int) -> None:
    assert mean_return(run(make_agent(QUICK, seed), 3, 3200)) > 15.5


def test_learns_asynchronously() -> None:
    assert mean_return(run(make_agent(QUICK, 0), 3, 3200, asynchronous=True)) > 15.5


class Blocked(Points):
    """Points that take no step before `released`."""

    released = Event()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        self.released.wait(timeout=60)
        return super()._step(tensordict)


def test_a_slow_worker_delays_no_other() -> None:
    agent = make_agent(QUICK, seed=0)
    envs = [Blocked([20] * 5), *(Points([20] * 5, seed=i) for i in (1, 2))]
    collector = collector_of(envs, agent, "first")
    for _ in range(6):
        agent.update(collector.next().batch)
    assert not Blocked.released.is_set()
    Blocked.released.set()
    assert all(job.result() for job in collector._pending)
    collector.close()


def test_rollouts_under_way_are_in_the_order_of_their_workers() -> None:
    """A run is resumed with this order, of which the first is missing."""
    envs = [Points([20] * size) for size in (1, 2, 3)]
    agent = make_agent(QUICK_A2C, seed=0)
    collector = collector_of(envs, agent, "first")
    for _ in range(12):
        taken = collector.next().batch
        under_way = [job.result().batch for job in collector._pending]
        workers = [batch.shape[0] - 1 for batch in (taken, *under_way)]
        assert workers == [(collector._turn + i) % 3 for i in range(3)]
    collector.close()


def test_workers_share_one_normalisation() -> None:
    agent = run(make_agent(QUICK, seed=0), 3, 5 * 8 * 4)
    assert isinstance(agent, A3C)
    assert agent.actor.norm.count == 5 * 8 * 4
