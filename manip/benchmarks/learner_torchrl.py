"""A plain TorchRL script, put together the way its documentation does.

Loss modules, target updater, replay buffers and Adam from the library, one call after
the other; nothing compiled, nothing fused.
"""

from collections.abc import Callable

import torch
from tensordict.nn import AddStateIndependentNormalScale, TensorDictModule
from tensordict.nn import NormalParamExtractor as Split
from torch import nn
from torch.optim import Adam
from torchrl.data import (
    LazyTensorStorage,
    SamplerWithoutReplacement,
    TensorDictReplayBuffer,
)
from torchrl.modules import (
    MLP,
    IndependentNormal,
    ProbabilisticActor,
    TanhNormal,
    ValueOperator,
)
from torchrl.objectives import ClipPPOLoss, SACLoss, SoftUpdate
from torchrl.objectives.value import GAE

from manip.benchmarks.problem import GAMMA, Problem, transitions


def sac(problem: Problem) -> Callable[[int], int]:
    """SACLoss with SoftUpdate and an Adam each for actor, critics and temperature."""
    loss = SACLoss(
        _actor(problem, TanhNormal, nn.ReLU, Split(), 2 * problem.action),
        _critic(problem, nn.ReLU, problem.observation + problem.action),
        num_qvalue_nets=2,
        target_entropy=-float(problem.action),
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=GAMMA)
    targets = SoftUpdate(loss, tau=0.005)
    groups = (loss.actor_network_params, loss.qvalue_network_params)
    optimisers = [Adam(list(group.flatten_keys().values()), 3e-4) for group in groups]
    optimisers.append(Adam([loss.log_alpha], 3e-4))
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(problem.stored), batch_size=problem.batch
    )
    found = transitions(problem, problem.worlds, problem.stored // problem.worlds)
    buffer.extend(found.reshape(-1))

    def update() -> None:
        terms = loss(buffer.sample())
        for name, optimiser in zip(
            ("actor", "qvalue", "alpha"), optimisers, strict=True
        ):
            optimiser.zero_grad()
            terms[f"loss_{name}"].backward()
            optimiser.step()
        targets.step()

    def go(threads: int) -> int:
        torch.set_num_threads(threads)
        for _ in range(problem.updates):
            update()
        return problem.updates

    return go


def ppo(problem: Problem) -> Callable[[int], int]:
    """GAE and ClipPPOLoss, minibatches from a replay buffer without replacement."""
    spread = AddStateIndependentNormalScale(problem.action)
    actor = _actor(problem, IndependentNormal, nn.Tanh, spread, problem.action)
    critic = _critic(problem, nn.Tanh, problem.observation)
    loss = ClipPPOLoss(actor, critic, normalize_advantage=True, entropy_coeff=0.0)
    advantage = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
    optimiser = Adam(loss.parameters(), 3e-4, eps=1e-5)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(problem.rows),
        sampler=SamplerWithoutReplacement(),
        batch_size=problem.minibatch,
    )
    rollout = transitions(problem, problem.worlds, problem.length)

    def update(batch: object) -> None:
        terms = loss(batch)
        optimiser.zero_grad()
        sum(terms[f"loss_{name}"] for name in ("objective", "critic")).backward()
        nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
        optimiser.step()

    def go(threads: int) -> int:
        torch.set_num_threads(threads)
        with torch.no_grad():
            found = advantage(actor(rollout.clone()))
        buffer.extend(found.reshape(-1))
        for _ in range(problem.epochs):
            for batch in buffer:
                update(batch)
        return problem.epochs

    return go


def _actor(
    problem: Problem,
    distribution: type,
    activation: type[nn.Module],
    last: nn.Module,
    outputs: int,
) -> ProbabilisticActor:
    body = MLP(
        in_features=problem.observation,
        out_features=outputs,
        num_cells=list(problem.hidden),
        activation_class=activation,
    )
    net = TensorDictModule(nn.Sequential(body, last), ["observation"], ["loc", "scale"])
    return ProbabilisticActor(
        net,
        in_keys=["loc", "scale"],
        distribution_class=distribution,
        return_log_prob=True,
    )


def _critic(
    problem: Problem, activation: type[nn.Module], inputs: int
) -> ValueOperator:
    body = MLP(
        in_features=inputs,
        out_features=1,
        num_cells=list(problem.hidden),
        activation_class=activation,
    )
    keys = (
        ["observation", "action"] if inputs > problem.observation else ["observation"]
    )
    return ValueOperator(body, in_keys=keys)
