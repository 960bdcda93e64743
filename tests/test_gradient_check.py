"""Errors of 1 % in any part of the native gradients are found, and rounding is not."""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from faulty_gradients import (
    BY_ONE_PERCENT,
    SMALL,
    SPACES,
    ScaledInputs,
    ScaledResult,
    gradient_names,
    make_agent,
    recheck,
)
from torch import Tensor
from toy import QUICK_TD3, Points

from manip.agents.native import gradient_check
from manip.agents.ppo import PPO
from manip.agents.sac import SAC
from manip.training.build import build_agent
from manip.training.config import TrainConfig

ALGORITHMS = ("sac", "ppo")
FOUND = "native gradients differ"
shared_agent = cache(make_agent)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_rounding_is_no_error_in_twenty_initialisations(algorithm: str) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", FOUND)
        for seed in range(20):
            agent = make_agent(algorithm, seed)
            assert agent._gradients.in_use is agent._gradients._native


@pytest.mark.parametrize(
    ("algorithm", "options"),
    [
        ("sac", {"critics": 1}),
        ("sac", {"critics": 3, "gamma": 1.0}),
        ("sac", {"batch_size": 1, "n_step": 1}),
        ("sac", {"initial_alpha": 10.0, "action_scale": (1.0, 0.01, 0.3)}),
        ("ppo", {"clip": None, "entropy_coefficient": 0.0}),
        ("ppo", {"clip": 0.9, "critic_coefficient": 0.0}),
        ("ppo", {"clip": 1.0, "normalise": False}),
        ("ppo", {"clip": 0.001, "action_scale": (1.0, 0.01, 0.3)}),
    ],
)
def test_no_option_is_an_error(algorithm: str, options: dict[str, Any]) -> None:
    config = replace(SMALL[algorithm], **options)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", FOUND)
        {"sac": SAC, "ppo": PPO}[algorithm](config, SPACES)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_error_in_any_gradient_or_reported_number_is_found(algorithm: str) -> None:
    agent = shared_agent(algorithm)
    names = gradient_names(agent)
    assert len(names) > 15
    for name in names:
        with pytest.warns(UserWarning, match=FOUND):
            assert not recheck(agent, ScaledResult(agent, name)), name


def scaled(array: np.ndarray, part: slice | int | tuple) -> np.ndarray:
    """Return a copy of which one part is 1 % too large."""
    copy = array.copy()
    copy[part] *= BY_ONE_PERCENT
    return copy


def last_is_larger(array: np.ndarray) -> np.ndarray:
    """Return a copy whose last entry, a logarithm, is that of 1 % more."""
    copy = array.copy()
    copy[-1] += math.log(BY_ONE_PERCENT)
    return copy


FIRST_GAIN = slice(12 * (8 + 1), 12 * (8 + 2))
"""Of the critic's first LayerNorm, behind weights [12, 8] and biases [12]."""

SAC_NETS: dict[str, Callable[[Any], Any]] = {
    "discount": lambda n: n._replace(gamma=n.gamma * BY_ONE_PERCENT),
    "target entropy": lambda n: n._replace(
        target_entropy=n.target_entropy * BY_ONE_PERCENT
    ),
    "action scale": lambda n: n._replace(action_scale=scaled(n.action_scale, 1)),
    "temperature": lambda n: n._replace(actor=last_is_larger(n.actor)),
    "one critic": lambda n: n._replace(critics=scaled(n.critics, 1)),
    "one target": lambda n: n._replace(targets=scaled(n.targets, 0)),
    "no targets": lambda n: n._replace(targets=n.critics),
    "same target twice": lambda n: n._replace(targets=n.targets[[0, 0]]),
    "norm gain": lambda n: n._replace(critics=scaled(n.critics, (0, FIRST_GAIN))),
}
SAC_ROWS: dict[str, Callable[[Tensor], Any]] = {
    "state": lambda rows: rows[:, :5].mul_(BY_ONE_PERCENT),
    "action": lambda rows: rows[:, 5:8].mul_(BY_ONE_PERCENT),
    "successor": lambda rows: rows[:, 8:13].mul_(BY_ONE_PERCENT),
    "reward": lambda rows: rows[:, -3].mul_(BY_ONE_PERCENT),
    "n-step exponent": lambda rows: rows[:, -2].mul_(BY_ONE_PERCENT),
    "one step instead of n": lambda rows: rows[:, -2].fill_(1),
    "termination": lambda rows: rows[:, -1].mul_(1 / BY_ONE_PERCENT),
    "no termination": lambda rows: rows[:, -1].zero_(),
}
PPO_NETS: dict[str, Callable[[Any], Any]] = {
    "clip range": lambda n: n._replace(clip=n.clip * BY_ONE_PERCENT),
    "narrower clip range": lambda n: n._replace(clip=n.clip / BY_ONE_PERCENT),
    "critic coefficient": lambda n: n._replace(
        critic_coefficient=n.critic_coefficient * BY_ONE_PERCENT
    ),
    "action scale": lambda n: n._replace(action_scale=scaled(n.action_scale, 1)),
    "parameters": lambda n: n._replace(params=scaled(n.params, slice(None))),
    "log deviation": lambda n: n._replace(params=scaled(n.params, n.log_std_at + 1)),
}
PPO_ROWS: dict[str, Callable[[Tensor], Any]] = {
    "state": lambda rows: rows[:, :5].mul_(BY_ONE_PERCENT),
    "action": lambda rows: rows[:, 5:8].mul_(BY_ONE_PERCENT),
    "old log-probability": lambda rows: rows[:, -3].mul_(BY_ONE_PERCENT),
    "value target": lambda rows: rows[:, -1].mul_(BY_ONE_PERCENT),
}
CASES = [
    (algorithm, kind, name, change)
    for algorithm, kind, changes in (
        ("sac", "nets", SAC_NETS),
        ("sac", "rows", SAC_ROWS),
        ("ppo", "nets", PPO_NETS),
        ("ppo", "rows", PPO_ROWS),
    )
    for name, change in changes.items()
]


@pytest.mark.parametrize(
    ("algorithm", "kind", "change"),
    [pytest.param(a, k, c, id=f"{a}-{name}") for a, k, name, c in CASES],
)
def test_an_error_in_any_constant_or_input_is_found(algorithm, kind, change) -> None:
    agent = shared_agent(algorithm)
    with pytest.warns(UserWarning, match=FOUND):
        assert not recheck(agent, ScaledInputs(agent, **{kind: change}))


def plant_entropy_coefficient(agent: PPO) -> None:
    agent._gradients._native._entropy_coefficient *= BY_ONE_PERCENT


def plant_advantage(agent: PPO) -> None:
    native = agent._gradients._native
    normalised = native._normalised

    def too_large(rows: Tensor) -> Tensor:
        rows = normalised(rows)
        rows[:, -2] *= BY_ONE_PERCENT
        return rows

    native._normalised = too_large


def plant_noise(agent: SAC) -> None:
    native = agent._gradients._native
    noise = native._noise
    native._noise = lambda rows: noise(rows) * BY_ONE_PERCENT


@pytest.mark.parametrize(
    ("algorithm", "plant"),
    [
        ("ppo", plant_entropy_coefficient),
        ("ppo", plant_advantage),
        ("sac", plant_noise),
    ],
)
def test_an_error_around_the_kernels_is_found(algorithm, plant) -> None:
    agent = make_agent(algorithm)
    plant(agent)
    with pytest.warns(UserWarning, match=FOUND):
        assert not recheck(agent, agent._gradients._native)


def rows_for(algorithm: str) -> Tensor:
    """Return rows of a batch; those of SAC end in termination, reward and steps."""
    rows = torch.randn(200, {"sac": 16, "ppo": 11}[algorithm])
    rows[:, -2:] = torch.tensor([1.0, 0.0])
    return rows


def learn(agent: SAC | PPO, rows: Tensor) -> None:
    agent._learn(rows) if isinstance(agent, SAC) else agent._improve(rows)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_comparing_changes_no_parameter_and_no_random_number(
    algorithm, monkeypatch
) -> None:
    weights, states = [], []
    for interval in (1, 10**9):
        monkeypatch.setattr(gradient_check, "INTERVAL", interval)
        agent = make_agent(algorithm)
        for _ in range(5):
            learn(agent, rows_for(algorithm))
        weights.append(agent.modules()["loss"].state_dict())
        states.append(torch.get_rng_state())
    assert torch.equal(*states)
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_an_error_that_begins_in_the_run_is_found(algorithm, monkeypatch) -> None:
    monkeypatch.setattr(gradient_check, "INTERVAL", 4)
    agent = make_agent(algorithm)
    check = agent._gradients
    name = "critic 0 0.weight" if algorithm == "sac" else "actor.log_std"
    for _ in range(2):
        learn(agent, rows_for(algorithm))
    check.in_use = check._native = ScaledResult(agent, name)
    for _ in range(4):  # updates 2 to 5: 4 is compared, and 5 as 4 differed
        learn(agent, rows_for(algorithm))
        assert check.in_use is check._native
    with pytest.warns(UserWarning, match=FOUND):
        learn(agent, rows_for(algorithm))
    assert check.in_use is check._reference


def test_single_batches_that_differ_are_forgiven(monkeypatch) -> None:
    monkeypatch.setattr(gradient_check, "INTERVAL", 1)
    agent = make_agent("ppo")
    agreements = iter([False, False, True, False, False, True])
    monkeypatch.setattr(agent._gradients, "_agree", lambda *_: next(agreements))
    for _ in range(6):
        learn(agent, rows_for("ppo"))
    assert agent._gradients.in_use is agent._gradients._native


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_a_batch_with_nan_is_no_evidence(algorithm, monkeypatch) -> None:
    monkeypatch.setattr(gradient_check, "INTERVAL", 1)
    agent = make_agent(algorithm)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", FOUND)
        for _ in range(4):
            rows = torch.full_like(rows_for(algorithm), math.nan)
            agent._gradients._select(rows)
    assert agent._gradients.in_use is agent._gradients._native


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_option_gradients_chooses_what_a_run_learns_from(algorithm: str) -> None:
    for source, expected in (("native", "CheckedGradients"), ("torchrl", "Autograd")):
        config = TrainConfig(algo=algorithm, gradients=source, agent=SMALL[algorithm])
        agent = build_agent(config, Points([5, 5]))
        assert type(agent._gradients).__name__.startswith(expected)


def test_other_algorithms_learn_through_torchrls_losses_with_either_option() -> None:
    for source in ("native", "torchrl"):
        config = TrainConfig(algo="td3", gradients=source, agent=QUICK_TD3)
        assert build_agent(config, Points([5, 5])).has_native_gradients is False
