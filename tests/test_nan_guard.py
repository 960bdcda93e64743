"""Gradients and losses that are not finite: caught, named, and without effect."""

import pytest
import torch
import toy
from toy import SPACES, Points, make_agent

from manip.agents.a2c import A2CConfig
from manip.agents.a3c import A3CConfig
from manip.agents.bc import BCConfig
from manip.agents.clone_best import CloneBestConfig
from manip.agents.dpo import DPOConfig
from manip.agents.gaussian_bc import GaussianBCConfig
from manip.agents.pebble import PEBBLEConfig
from manip.agents.sac import SACConfig
from manip.errors import UserError
from manip.training.collector import Rollout
from manip.training.nan_guard import NanGuard

QUICK = {name: value for name, value in vars(toy).items() if name.startswith("QUICK")}


def test_every_algorithm_is_checked() -> None:
    supervised = {BCConfig, GaussianBCConfig, CloneBestConfig, DPOConfig}
    subclasses = {A3CConfig: A2CConfig, PEBBLEConfig: SACConfig}
    shipped = toy.ALGORITHMS
    checked = {type(config) for config in QUICK.values()}
    assert checked == {*shipped} - supervised - {*subclasses}
    for algorithm, base in subclasses.items():
        assert issubclass(shipped[algorithm], shipped[base])


@pytest.mark.parametrize("config", QUICK.values(), ids=QUICK)
def test_a_gradient_that_is_not_finite_is_named_and_changes_no_weight(config) -> None:
    agent, other = make_agent(config, seed=0), make_agent(config, seed=0)
    guard = NanGuard(agent.optimisers(), stop=False)
    batch = Rollout(Points([20] * 32)).collect(agent.policy(), 20).batch
    agent.update(batch.clone())
    batch["next", "reward"][:] = torch.nan
    guard.finite(agent.update(batch))
    assert any("the gradient of the optimiser" in message for message in guard.messages)
    assert any("loss" in message for message in guard.messages)
    for module in agent.modules().values():
        assert all(tensor.isfinite().all() for tensor in module.state_dict().values())
    NanGuard(other.optimisers(), stop=True)
    with pytest.raises(UserError, match=r"gradient of the optimiser .* is not finite"):
        other.update(batch)


def test_finite_gradients_are_left_alone() -> None:
    weight = torch.nn.Parameter(torch.ones(SPACES.action_dim))
    optimiser = torch.optim.SGD([weight], 0.5)
    guard = NanGuard({"all": optimiser}, stop=True)
    weight.grad = torch.ones(1)
    optimiser.step()
    assert weight.item() == 0.5
    assert guard.finite({"loss": 1.5}) == {"loss": 1.5}
