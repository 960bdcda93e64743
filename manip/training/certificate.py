"""Compare a task on three engines: MuJoCo's C code, MuJoCo Warp and stock robosuite."""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from manip.agents.policy import shipped_policies
from manip.envs.make_batch import make_batch
from manip.envs.task import Task
from manip.envs.task_batch import TaskBatch
from manip.evaluation.episodes import Episode
from manip.evaluation.statistics import Rate
from manip.evaluation.task_problems import open_task, step_problems
from manip.robot_config import RobotConfig
from manip.sim.warp.contact_differences import ContactDifferences
from manip.sim.warp.library import Device, check_library
from manip.training.baselines import AnyPolicy
from manip.training.contact_check import contact_differences
from manip.training.final_evaluation import (
    EvaluationOptions,
    load_policy_and_task,
    measure_on_task,
)
from manip.versions import versions

Array = np.ndarray

STEPS = (1, 10, 50)
"""Control steps after which states are compared."""

STARTS = 16
"""Environments whose states are compared."""

STATE_TOLERANCE = 1e-4
"""Largest median difference [rad] of the arm's joints after the last of `STEPS`.

The largest difference is no measure: a contact that begins a substep earlier in one
environment multiplies it."""

SUCCESS_TOLERANCE = 0.05
"""Largest difference of success on Warp and on C."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class CertificateOptions:
    """What is compared.

    Attributes:
        task: name of the task.
        robot: arm.
        device: of Warp.
        episodes: on C and on Warp, with the same starts.
        stock_episodes: in stock robosuite, which samples its own starts; 0 for none.
    """

    task: str
    robot: str = "Panda"
    device: Device = "cuda"
    episodes: int = 64
    stock_episodes: int = 20


@dataclass(frozen=True)
class Certificate:
    """The result of a comparison.

    Attributes:
        success: policy -> engine -> rate of success_held with its interval.
        equal_flags: policy -> share of the episodes with the same success_held on C
            and on Warp.
        differences: control steps -> median and largest difference [rad] of the arm's
            joints between C and Warp, over environments with equal starts and equal
            random actions.
        stock_problems: differences between C and stock robosuite, in lines.
        contacts: kind of pair of geoms, such as box-box -> how the contacts of C and
            Warp differ in states of the expert.
    """

    task: str
    robot: str
    device: str
    episodes: int
    success: dict[str, dict[str, Rate]] = field(default_factory=dict)
    equal_flags: dict[str, float] = field(default_factory=dict)
    differences: dict[int, tuple[float, float]] = field(default_factory=dict)
    stock_problems: list[str] = field(default_factory=list)
    contacts: dict[str, ContactDifferences] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    @property
    def exact(self) -> bool:
        """Whether C and stock robosuite agree."""
        return not self.stock_problems

    @property
    def trains(self) -> bool:
        """Whether what is learned on Warp can be expected to hold on C."""
        near = self.differences[STEPS[-1]][0] <= STATE_TOLERANCE
        rates = self.success.values()
        apart = [abs(rate["warp"].rate - rate["native"].rate) for rate in rates]
        return near and max(apart, default=0.0) <= SUCCESS_TOLERANCE

    def to_json(self) -> str:
        """Indented JSON with the fields above."""
        verdict = {"exact": self.exact, "trains": self.trains}
        return json.dumps(asdict(self) | verdict, indent=2) + "\n"


def certify(options: CertificateOptions, say: Say = lambda _: None) -> Certificate:
    """Run the comparison; `say` is called with what begins.

    Raises:
        UserError: there is no such task or device, or a package is missing.
    """
    check_library(options.device)
    policies = _policies(options)
    task = next(iter(policies.values()))[1]
    robot = RobotConfig(options.robot)
    say("states after equal steps")
    differences = state_differences(task, robot, options.device)
    say("contacts in the expert's states")
    contacts = contact_differences(task, robot, options.device)
    say("C against stock robosuite")
    problems = list(step_problems(open_task(task, robot)))
    result = Certificate(
        task.name,
        options.robot,
        options.device,
        options.episodes,
        differences=differences,
        stock_problems=problems,
        contacts=contacts,
        versions=versions(),
    )
    for name, (policy, _) in policies.items():
        _add_success(result, name, policy, task, options, say)
    return result


def state_differences(
    task: Task, robot: RobotConfig, device: Device
) -> dict[int, tuple[float, float]]:
    """Median and largest |difference| [rad] of the arm's joints after `STEPS`."""
    batches = [
        make_batch(task, STARTS, robot=robot, backend="native"),
        make_batch(task, STARTS, robot=robot, backend="warp", device=device),
    ]
    for batch in batches:
        batch.begin(np.arange(STARTS))
    generator, differences = np.random.default_rng(0), {}
    for step in range(1, STEPS[-1] + 1):
        action = generator.uniform(-1, 1, (STARTS, batches[0].action_dim))
        for batch in batches:
            batch.step(action)
        if step in STEPS:
            differences[step] = _apart(*batches)
    return differences


def _apart(first: TaskBatch, second: TaskBatch) -> tuple[float, float]:
    joints = [batch.read()["joint_pos"] for batch in (first, second)]
    apart = np.abs(joints[0] - joints[1]).max(axis=1)
    return float(np.median(apart)), float(apart.max())


def _policies(options: CertificateOptions) -> dict[str, tuple[AnyPolicy, Task]]:
    """The expert, and the shipped policy if there is one."""
    name, robot = options.task, options.robot
    shipped = name if robot == "Panda" else f"{name}-{robot}"
    policies = {"expert": load_policy_and_task(Path(name), "expert", robot)}
    if shipped in shipped_policies():
        policies[shipped] = load_policy_and_task(Path(shipped), None, robot)
    return policies


def _add_success(
    result: Certificate,
    name: str,
    policy: AnyPolicy,
    task: Task,
    options: CertificateOptions,
    say: Say,
) -> None:
    episodes: dict[str, list[Episode]] = {}
    result.success[name] = {}
    for env in ("native", "warp", "stock"):
        chosen = _evaluation(env, options)
        if not chosen.episodes:
            continue
        say(f"{name}: {chosen.episodes} episodes on {env}")
        measured = measure_on_task(policy, task, chosen)
        result.success[name][env] = measured.evaluation.success["success_held"]
        episodes[env] = sorted(measured.episodes, key=lambda e: e.index)
    pairs = zip(episodes["native"], episodes["warp"], strict=True)
    same = [a.success_held == b.success_held for a, b in pairs]
    result.equal_flags[name] = float(np.mean(same))


def _evaluation(env: str, options: CertificateOptions) -> EvaluationOptions:
    if env == "warp":
        return EvaluationOptions("warp", options.episodes, device=options.device)
    if env == "native":
        return EvaluationOptions("native", options.episodes)
    return EvaluationOptions("stock", options.stock_episodes)
