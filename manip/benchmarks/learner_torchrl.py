"""SAC and PPO in TorchRL, written as in its documentation.

Loss modules, target updater and replay buffers are the library's, Adam is PyTorch's.
Nothing is compiled or fused.
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

from manip.benchmarks.learner_problem import GAMMA, Problem, transitions


def sac(problem: Problem) -> Callable[[int], int]:
    """SACLoss with SoftUpdate and an Adam each for actor, critics and temperature."""
    loss = _sac_loss(problem)
    targets = SoftUpdate(loss, tau=0.005)
    optimisers = _optimisers(loss)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(problem.stored), batch_size=problem.batch
    )
    batch = transitions(problem, problem.num_envs, problem.stored_length)
    buffer.extend(batch.reshape(-1))

    def update() -> None:
        terms = loss(buffer.sample())
        for name, optimiser in optimisers.items():
            optimiser.zero_grad()
            terms[f"loss_{name}"].backward()
            optimiser.step()
        targets.step()

    def run(threads: int) -> int:
        torch.set_num_threads(threads)
        for _ in range(problem.updates):
            update()
        return problem.updates

    return run


def _sac_loss(problem: Problem) -> SACLoss:
    loss = SACLoss(
        _actor(problem, TanhNormal, nn.ReLU, Split(), 2 * problem.action),
        _critic(problem, nn.ReLU, problem.observation + problem.action),
        num_qvalue_nets=2,
        target_entropy=-float(problem.action),
        loss_function="l2",
    )
    loss.make_value_estimator(gamma=GAMMA)
    return loss


def _optimisers(loss: SACLoss) -> dict[str, Adam]:
    """Name of a loss -> the optimiser of its parameters."""
    groups = {
        "actor": loss.actor_network_params.flatten_keys().values(),
        "qvalue": loss.qvalue_network_params.flatten_keys().values(),
        "alpha": [loss.log_alpha],
    }
    return {name: Adam(list(values), 3e-4) for name, values in groups.items()}


def ppo(problem: Problem) -> Callable[[int], int]:
    """GAE and ClipPPOLoss, minibatches from a replay buffer without replacement."""
    scale = AddStateIndependentNormalScale(problem.action)
    actor = _actor(problem, IndependentNormal, nn.Tanh, scale, problem.action)
    critic = _critic(problem, nn.Tanh, problem.observation)
    loss = ClipPPOLoss(actor, critic, normalize_advantage=True, entropy_coeff=0.0)
    advantage = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
    optimiser = Adam(loss.parameters(), 3e-4, eps=1e-5)
    buffer = _minibatches(problem)
    rollout = transitions(problem, problem.num_envs, problem.length)

    def update(batch: object) -> None:
        terms = loss(batch)
        optimiser.zero_grad()
        sum(terms[f"loss_{name}"] for name in ("objective", "critic")).backward()
        nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
        optimiser.step()

    def run(threads: int) -> int:
        torch.set_num_threads(threads)
        with torch.no_grad():
            steps = advantage(actor(rollout.clone()))
        buffer.extend(steps.reshape(-1))
        for _ in range(problem.epochs):
            for batch in buffer:
                update(batch)
        return problem.epochs

    return run


def _minibatches(problem: Problem) -> TensorDictReplayBuffer:
    return TensorDictReplayBuffer(
        storage=LazyTensorStorage(problem.rows),
        sampler=SamplerWithoutReplacement(),
        batch_size=problem.minibatch,
    )


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
