"""Throughput with many collectors, whose simulation is replaced by a wait.

A collector on another machine costs the learner's process only what is sent in both
directions. Here each collector waits as long as its rollout would take, and then gives
a copy of a real rollout, serialised as between machines. The learner learns. So two
cores show what many machines would do, network apart, and check `predicted`.
"""

import pickle
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase

from manip.agents.agent import Agent
from manip.benchmarks.rounds import Candidate, Comparison, Settings, speed
from manip.cluster.policy_weights import SharedWeights
from manip.cluster.remote_rollout import (
    Collected,
    CollectorProcess,
    RemoteRollout,
    State,
)
from manip.rewards.reward_function import EnvironmentReward
from manip.training.build import build_agent, overlaps, training_env
from manip.training.collector import Collector, Order
from manip.training.config import TrainConfig
from manip.training.recipes import recipe

SPEED = 3_200.0
"""Control steps per second of a collector: Lift on one core."""

SLOW_SPEED = 160.0
"""The same of a simulation that takes twenty times as long, as with images."""


LEARNER = 4
"""Collectors whose rollouts the learner learns from alone."""

UPDATES = 3
"""Rollouts of a measurement."""


@dataclass(frozen=True)
class Case:
    """An algorithm, and collectors of one speed.

    Attributes:
        algo: of the learner.
        speed: control steps per second of a collector.
        collectors: their numbers that are measured.
    """

    algo: str
    speed: float
    collectors: tuple[int, ...]

    @property
    def learner(self) -> str:
        """Name of the candidate that learns and does not collect."""
        return f"{self.algo}, learner alone"

    def name(self, collectors: int) -> str:
        """Name of a candidate."""
        return f"{self.algo}, {collectors} x {self.speed:,.0f} steps/s"


CASES = (Case("ppo", SPEED, (1, 4, 16, 64)), Case("sac", SLOW_SPEED, (1, 2, 4, 8)))


def predicted(algo: str, collected: float, learned: float) -> float:
    """Control steps per second of a run.

    Args:
        algo: on-policy algorithms collect and learn in turns, the others at once.
        collected: control steps per second of all collectors together.
        learned: control steps per second of the learner alone.
    """
    if algo == "ppo":
        return 1 / (1 / collected + 1 / learned)
    return min(collected, learned)


def comparison(settings: Settings) -> Comparison:
    """Compare numbers of collectors, of `settings.num_envs` environments each."""
    torch.set_num_threads(1)  # as in training
    candidates: dict[str, Candidate] = {}
    for case in CASES:
        config = recipe(settings.task, case.algo)
        config = replace(config, num_envs=settings.num_envs, threads=1)
        candidates |= _candidates(config, case)
    return Comparison(
        f"{settings.task}, {settings.num_envs} environments a collector",
        candidates,
        derive=_against_prediction,
        task=settings.task,
    )


def _candidates(config: TrainConfig, case: Case) -> dict[str, Candidate]:
    env = training_env(config, 0, 1)
    agent = build_agent(config, env)
    given = CollectorProcess(config, 0, 1).collect(
        agent.policy(), agent.rollout_length, None
    )
    start = partial(_Waiting, pickle.dumps(given), case.speed)

    def run_of(collectors: int) -> "_Run":
        sources = [RemoteRollout(env, start, "") for _ in range(collectors)]
        order: Order = "together" if collectors > 1 else "turns"
        ahead = overlaps(config)
        return _Run(agent, Collector(sources, agent, ahead, EnvironmentReward(), order))

    run_of(1).warm_up()
    batch = run_of(LEARNER).collector.next().batch
    learner = {case.learner: speed(partial(_learn, agent, batch))}
    return learner | {
        case.name(number): run_of(number).speed for number in case.collectors
    }


def _learn(agent: Agent, batch: TensorDictBase) -> int:
    agent.update(batch.clone())
    return int(batch.numel())


class _Run:
    """Collects and learns, without evaluations and files."""

    def __init__(self, agent: Agent, collector: Collector) -> None:
        self._agent, self.collector = agent, collector

    def _step(self) -> int:
        experience = self.collector.next()
        self._agent.update(experience.batch)
        return experience.steps

    def warm_up(self) -> None:
        """Collect until the agent learns."""
        while not self._agent.update(self.collector.next().batch):
            pass

    def speed(self) -> float:
        """Control steps per second, once a rollout is under way as in a run."""
        self._step()
        return speed(lambda: sum(self._step() for _ in range(UPDATES)))()


class _Waiting:
    """A collector that waits, and gives the same rollout every time.

    Args:
        given: the rollout, serialised.
        rate: control steps per second.
    """

    def __init__(self, given: bytes, rate: float) -> None:
        self._given, self._rate = given, rate
        self._shared = SharedWeights(pickle.dumps)

    def collect(
        self, policy: TensorDictModuleBase, length: int, state: State | None
    ) -> Collected:
        """Wait; see `manip.cluster.remote_rollout.Collecting`."""
        self._shared.split(policy)
        collected: Collected = pickle.loads(self._given)
        time.sleep(collected.experience["steps"] / self._rate)
        return collected


def _against_prediction(rounds: Mapping[str, list[float]]) -> dict[str, float]:
    """Measured over predicted throughput, the median over the rounds."""
    return {
        f"{case.name(number)}, measured / predicted": float(
            np.median(
                [
                    measured / predicted(case.algo, number * case.speed, learned)
                    for measured, learned in zip(
                        rounds[case.name(number)], rounds[case.learner], strict=True
                    )
                ]
            )
        )
        for case in CASES
        for number in case.collectors
    }
