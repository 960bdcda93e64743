"""Replay: n-step transitions by hand, links, ring, relabelling, exact resume."""

from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from toy import QUICK_SAC, QUICK_TD3, Points, make_agent

from manip.agents.agent import AgentConfig
from manip.agents.off_policy import OffPolicy
from manip.agents.replay import NONE, Replay
from manip.errors import UserError
from manip.training.collector import Rollout

GAMMA = 0.5


def rollout(
    first: int, ends: str, env: int = 0, terms: tuple[float, ...] = ()
) -> TensorDict:
    """Steps of one environment: reward and observation count on from `first`.

    Args:
        ends: a character for each step: "." goes on, "t" terminates, "|" is truncated.
        terms: factors of reward terms; each term is its factor times the reward.
    """
    count = torch.arange(first, first + len(ends)).float()[None, :, None]
    flag = {key: torch.tensor([[[c == key] for c in ends]]) for key in "t|"}
    after = {
        "observation": count + 0.5 + 100 * env,
        "reward": count,
        "terminated": flag["t"],
        "truncated": flag["|"],
        "done": flag["t"] | flag["|"],
    }
    if terms:
        after["reward_terms"] = count * torch.tensor(terms)
    shape = (1, len(ends))
    before = {"observation": count + 100 * env, "action": -count}
    return TensorDict(before | {"next": TensorDict(after, shape)}, shape)


def replay_of(*rollouts: TensorDictBase, capacity: int = 20) -> Replay:
    replay = Replay(capacity, observation_dim=1, action_dim=1)
    for batch in rollouts:
        replay.add(batch)
    return replay


def table(replay: Replay, n: int) -> dict[float, list[float]]:
    """Observation -> [successor, return, steps, terminated] of each stored row."""
    rows = replay.transitions(torch.arange(len(replay)), n, GAMMA)
    assert torch.equal(rows[:, 1], -rows[:, 0] % -100)
    return {row[0]: row[2:] for row in rows.tolist()}


def test_transitions_equal_a_hand_computed_table() -> None:
    """r + r'/2 + r''/4; up to a termination, a time limit, and the newest step."""
    assert table(replay_of(rollout(0, "..t.|...")), n=3) == {
        0: [2.5, 0 + 1 / 2 + 2 / 4, 3, 1],
        1: [2.5, 1 + 2 / 2, 2, 1],
        2: [2.5, 2, 1, 1],
        3: [4.5, 3 + 4 / 2, 2, 0],
        4: [4.5, 4, 1, 0],  # bootstraps from the true last observation
        5: [7.5, 5 + 6 / 2 + 7 / 4, 3, 0],
        6: [7.5, 6 + 7 / 2, 2, 0],
        7: [7.5, 7, 1, 0],
    }


@pytest.mark.parametrize("ends", ["......", "..t.|.", "tttttt", ".....|"])
def test_one_step_is_what_was_stored(ends: str) -> None:
    assert table(replay_of(rollout(0, ends)), n=1) == {
        t: [t + 0.5, t, 1, end == "t"] for t, end in enumerate(ends)
    }


@pytest.mark.parametrize("n", [2, 3, 20])
@pytest.mark.parametrize("ends", [".........", "..t.|...t", "|..|....."])
def test_sums_end_with_the_rollout(ends: str, n: int) -> None:
    pieces = [rollout(at, ends[at : at + 3]) for at in (0, 3, 6)]
    alone = [table(replay_of(piece), n) for piece in pieces]
    assert table(replay_of(*pieces), n) == alone[0] | alone[1] | alone[2]


def test_environments_keep_apart() -> None:
    both = [
        torch.cat([rollout(at, ends), rollout(at, other, env=1)])
        for at, ends, other in ((0, "..", ".|"), (2, ".t", ".."))
    ]
    found = table(replay_of(*both), n=3)
    alone = table(replay_of(rollout(0, ".."), rollout(2, ".t")), n=3)
    pieces = rollout(0, ".|", env=1), rollout(2, "..", env=1)
    other = table(replay_of(*pieces), n=3)
    assert found == alone | other


@pytest.mark.parametrize("capacity", [5, 6, 7, 9])
@pytest.mark.parametrize("n", [1, 3])
def test_a_full_ring_forgets_the_oldest_and_no_link_leads_astray(capacity, n) -> None:
    ends = "...t....|......t......"
    replay, large = replay_of(capacity=capacity), replay_of(capacity=30)
    for at in range(0, 20, 5):
        for buffer in (replay, large):
            buffer.add(rollout(at, ends[at : at + 5]))
        stored = range(max(0, at + 5 - capacity), at + 5)
        whole = table(large, n)
        assert table(replay, n) == {t: whole[t] for t in stored}


def test_a_ring_of_several_environments_never_mixes_episodes() -> None:
    """Any sampled return sums consecutive numbers of one environment."""
    torch.manual_seed(0)
    replay = replay_of(capacity=17)
    for at in range(0, 60, 4):
        ends = ["".join(".t|"[i] for i in torch.randint(3, (4,))) for _ in range(3)]
        replay.add(torch.cat([rollout(at, e, env) for env, e in enumerate(ends)]))
        for start, (last, total, steps, _) in table(replay, n=3).items():
            rewards = [start % 100 + k for k in range(int(steps))]
            assert last == start + steps - 0.5
            assert total == sum(GAMMA**k * r for k, r in enumerate(rewards))


def test_a_rollout_that_does_not_fit_is_refused() -> None:
    with pytest.raises(UserError, match=r"buffer_size is 4, but a rollout has 5 steps"):
        replay_of(rollout(0, "....."), capacity=4)


def test_too_large_a_buffer_is_one_line() -> None:
    with pytest.raises(UserError, match=r"no memory for .*smaller agent.buffer_size"):
        Replay(10**10, 10**4, 7)


def test_episodes_are_numbered() -> None:
    replay = replay_of(rollout(0, "..t."), rollout(4, ".|"), rollout(6, ".."))
    steps = replay.steps()
    assert steps["episode"].flatten().tolist() == [0, 0, 0, 1, 1, 1, 2, 2]
    assert steps["env"].flatten().tolist() == [0] * 8


def test_relabelling_changes_the_rewards_of_all_stored_steps() -> None:
    replay = replay_of(rollout(0, "...", terms=(1.0, 10.0)))
    weights = torch.tensor([0.5, 0.25])

    def reward(steps: TensorDictBase) -> torch.Tensor:
        return steps["next", "reward_terms"] @ weights[:, None]

    replay.relabel(reward)
    expected = table(replay_of(rollout(0, "...")), n=3)
    assert table(replay, n=3) == {
        t: [after, 3 * total, steps, end]
        for t, (after, total, steps, end) in expected.items()
    }


def test_an_empty_buffer_is_relabelled_without_asking_for_rewards() -> None:
    def reward(_: TensorDictBase) -> torch.Tensor:
        raise AssertionError

    Replay(4, 2, 1).relabel(reward)


def fed(config: AgentConfig, seed: int = 0) -> tuple[OffPolicy, Rollout]:
    agent = make_agent(config, seed)
    assert isinstance(agent, OffPolicy)
    return agent, Rollout(Points([3, 4, 7], start=0.5))


def feed(agent: OffPolicy, source: Rollout, rounds: int) -> None:
    for _ in range(rounds):
        agent.update(source.collect(agent.policy(), 3).batch)


@pytest.mark.parametrize("config", [QUICK_SAC, QUICK_TD3])
def test_steps_of_episodes_that_end_have_their_true_successor(config) -> None:
    agent, source = fed(replace(config, action_scale=(0.5,)))
    feed(agent, source, 4)
    steps = agent.replay.steps()
    x, action = steps["observation"], steps["action"]
    torch.testing.assert_close(steps["next", "observation"], x + 0.2 * action)
    torch.testing.assert_close(
        steps["next", "reward"], 1 - steps["next", "observation"].abs()
    )
    assert action.abs().max() <= 0.5


@pytest.mark.parametrize("rounds", [1, 3, 8])
def test_a_restored_buffer_goes_on_bit_for_bit(rounds: int) -> None:
    """At capacity 40 the ring is full after five rollouts of nine steps."""
    config = replace(QUICK_SAC, buffer_size=40, random_steps=1_000)
    agent, source = fed(config)
    feed(agent, source, rounds)
    other, _ = fed(config, seed=1)
    other.load_extra_state(agent.extra_state())
    batch = source.collect(agent.policy(), 3).batch
    for either in (agent, other):
        either.update(batch)
    found, expected = (
        a.replay.transitions(torch.arange(len(a.replay)), 3, 0.9)
        for a in (other, agent)
    )
    assert torch.equal(found, expected)
    for name, column in agent.extra_state()["buffer"].items():
        assert torch.equal(column, other.extra_state()["buffer"][name]), name


def test_a_buffer_that_was_not_saved_is_filled_again() -> None:
    agent, source = fed(replace(QUICK_SAC, random_steps=20))
    feed(agent, source, 3)
    state = agent.extra_state(buffer=False)
    assert state["buffer"] is None
    other, _ = fed(replace(QUICK_SAC, random_steps=20))
    other.load_extra_state(state)
    assert len(other.replay) == 0
    assert not other.warming_up
    logs = [other.update(source.collect(agent.policy(), 3).batch) for _ in range(3)]
    assert [bool(log) for log in logs] == [False, False, True]


@pytest.mark.parametrize(
    "damage",
    [
        *({"cursor": 999}, {"cursor": 2.5}, {"episodes": "x"}, {"owed": -1.0}),
        *({"steps": -1}, {"current": torch.zeros(3)}),
        {"current": torch.full((1, 3), NONE)},
    ],
)
def test_damaged_counters_are_refused(damage: dict) -> None:
    agent, source = fed(QUICK_SAC)
    feed(agent, source, 2)
    with pytest.raises(ValueError, match=r"replay buffer|counters"):
        agent.load_extra_state(agent.extra_state() | damage)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("reward", torch.zeros(18, 1)),
        ("reward", torch.zeros(18, dtype=torch.float64)),
        ("before", torch.zeros(18, 3)),
        ("link", torch.full((18,), 10**12)),
        ("link", torch.full((18,), -7)),
        ("after", torch.zeros(17, 1)),
    ],
)
def test_damaged_columns_are_refused(name: str, value: torch.Tensor) -> None:
    agent, source = fed(QUICK_SAC)
    feed(agent, source, 2)
    state = agent.extra_state()
    state["buffer"] |= {name: value}
    with pytest.raises(ValueError, match="replay buffer"):
        agent.load_extra_state(state)
