"""The parts of a training run, built from its options."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from manip.agents.agent import Agent
from manip.agents.registry import load_algorithm
from manip.agents.trajectory import CPU
from manip.envs.adapters.torchrl import TaskEnv
from manip.rewards.reward_function import RewardFunction
from manip.training.averages import TrainingAverages
from manip.training.build import build_agent, overlaps, training_envs
from manip.training.collector import Collector, Order, Rollout, RolloutSource
from manip.training.config import TrainConfig
from manip.training.demonstrations import check_dataset, use_dataset
from manip.training.evaluator import Evaluator
from manip.training.fault_report import FaultReport
from manip.training.initial_policy import start_agent
from manip.training.inputs import spaces_of
from manip.training.memory import check_memory
from manip.training.nan_guard import NanGuard
from manip.training.placement import learner_device, placement_notes
from manip.training.preferences import (
    check_preferences,
    with_preferences,
    with_taste,
)
from manip.training.teacher import teacher_digest
from manip.training.waypoints import add_waypoints


@dataclass(frozen=True)
class RunParts:
    """The parts of a run: environments, agent, collector, evaluator, guards.

    Attributes:
        envs: training environments, one batch for each of the agent's workers.
        agent: the algorithm.
        evaluator: evaluates the agent's policy, in environments of its own.
        collector: collects rollouts with the agent in `envs`.
        guard: checks the agent's gradients and losses.
        averages: recent training averages.
        faults: reports what went wrong in environments and updates.
        teacher: digest of the weights of the policy that is imitated; empty if none.
        notes: lines that the run prints when it starts.
    """

    envs: Sequence[TaskEnv]
    agent: Agent
    evaluator: Evaluator
    collector: Collector
    guard: NanGuard
    averages: TrainingAverages
    faults: FaultReport
    teacher: str
    notes: tuple[str, ...] = ()

    def messages(self) -> Iterator[str]:
        """Lines about faults and lost collectors, new since the last call."""
        yield from self.faults.messages()
        yield from self.collector.messages()

    @property
    def milestones(self) -> tuple[str, ...]:
        """Names of the task's milestones."""
        return tuple(self.evaluator.env.batch.task.milestone_names)


Place = Callable[[TrainConfig, Sequence[TaskEnv]], Sequence[RolloutSource]]
"""Makes the sources of rollouts for the groups of a run's environments."""


def here(config: TrainConfig, envs: Sequence[TaskEnv]) -> list[Rollout]:
    """Step the environments in threads of this process."""
    return [Rollout(env) for env in envs]


def build_parts(
    config: TrainConfig,
    reward: RewardFunction,
    place: Place = here,
    report: Callable[[str], object] = lambda _: None,
) -> RunParts:
    """Build the environments and the agent of a run.

    Args:
        config: options of the run.
        reward: computes the reward that the agent learns from.
        place: where the environments are stepped.
        report: called with lines about what takes long.

    Raises:
        UserError: an option does not fit, or there is not enough memory.
    """
    check_preferences(config)
    check_dataset(config)
    device = learner_device(config)
    envs = training_envs(config)
    add_waypoints(config, envs, report)
    evaluator = Evaluator(config, envs[0].batch)
    if device == CPU:
        check_memory(config, spaces_of(config, evaluator.env))
    agent = build_agent(config, evaluator.env, device)
    notes = [*start_agent(config, agent, evaluator.env), *_gradient_notes(config)]
    notes += placement_notes(config)
    recorded = use_dataset(config, agent, envs)
    agent = with_preferences(config, agent, envs[0])
    guard = NanGuard(agent.optimisers(), config.faults == "stop")
    milestones = evaluator.env.batch.task.milestone_names
    batch = envs[0].batch
    reward = with_taste(config, reward, batch)
    weights = {name: batch.reward_weights[name] for name in batch.reward_names}
    return RunParts(
        envs=envs,
        agent=agent,
        evaluator=evaluator,
        collector=Collector(
            recorded or place(config, envs),
            agent,
            overlaps(config),
            reward,
            _order(config),
        ),
        guard=guard,
        averages=TrainingAverages(milestones, weights),
        faults=FaultReport(envs, guard),
        teacher=teacher_digest(config),
        notes=tuple(notes),
    )


def _order(config: TrainConfig) -> Order:
    if config.agent.asynchronous:
        return "first"
    return "together" if config.collectors > 1 else "turns"


def _gradient_notes(config: TrainConfig) -> Iterator[str]:
    """Say where gradients come from, if not from where the options say."""
    native = load_algorithm(config.algo).has_native_gradients
    if native and config.gradients == "native" and config.observe == "cameras":
        yield "gradients: TorchRL's losses, as compiled ones are for the state only"
