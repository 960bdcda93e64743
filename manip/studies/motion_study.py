"""Study of motion: how each policy moves the arm, beside the arm's limits."""

import gc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import degrees, nan
from pathlib import Path

from manip.agents.policy import Policy, load_policy, shipped_policies
from manip.envs.external_task import ExternalTask
from manip.envs.task import Task
from manip.errors import UserError
from manip.evaluation.report import Evaluation
from manip.training.final_evaluation import (
    EvaluationOptions,
    evaluate_on_task,
    load_run,
)


@dataclass(frozen=True)
class MotionRow:
    """How a policy moves the arm: medians over the episodes.

    Attributes:
        success_held: share of the episodes with success_held.
        speed, torque, jerk: largest share of the arm's limit, over the joints and the
            episode (see `manip.evaluation.motion`); jerk is nan for an arm whose
            maker states no limit.
        action_change: mean change of the action's numbers from step to step.
        hand_tilt: largest angle between the tool and straight down [degree].
        self_contact: share of the steps in which the arm touches itself.
    """

    policy: str
    task: str
    robot: str
    algo: str
    episodes: int
    success_held: float
    speed: float
    torque: float
    jerk: float
    action_change: float
    hand_tilt: float
    self_contact: float


def default_policies() -> tuple[str, ...]:
    """Names of the shipped policies that see no images, which are slow to draw."""
    names = shipped_policies()
    return tuple(name for name in names if load_policy(name).card.cameras is None)


def motion_rows(policies: Sequence[str], episodes: int) -> Iterator[MotionRow]:
    """A row for each policy, as soon as its episodes have ended.

    The episodes are exact native ones, which equal stock robosuite's.

    Args:
        policies: run folders, policy folders, or names of shipped policies.
        episodes: of each policy.

    Raises:
        UserError: there is no such policy, or its task is not simulated natively;
            before any episode begins.
    """
    loaded = [_load(name) for name in policies]
    options = EvaluationOptions(env="native", episodes=episodes, details=True)
    for name, (policy, task) in zip(policies, loaded, strict=True):
        yield _row(name, evaluate_on_task(policy, task, options))
        gc.collect()  # a robosuite model is a cycle of 300 MB that lives on otherwise


def _load(name: str) -> tuple[Policy, Task]:
    policy, task = load_run(Path(name))
    if isinstance(task, ExternalTask):
        raise UserError(
            f"{name} was trained for {policy.card.task}, whose motion is not measured: "
            "name policies of manip's own tasks (see `manip list`)"
        )
    return policy, task


def _row(name: str, result: Evaluation) -> MotionRow:
    motion = result.motion or {}  # native episodes with details have it
    return MotionRow(
        policy=name,
        task=result.task,
        robot=result.robot,
        algo=result.algo,
        episodes=result.episodes,
        success_held=result.success["success_held"].rate,
        speed=motion["speed"],
        torque=motion["torque"],
        jerk=motion.get("jerk", nan),
        action_change=motion["action_change"],
        hand_tilt=degrees(motion["hand_tilt"]),
        self_contact=motion["self_contact"],
    )
