"""Options of a training run, and the recipes that set them per task."""

import dataclasses
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

import yaml

from manip.agents.a2c import A2CConfig
from manip.agents.a3c import A3CConfig
from manip.agents.bc import BCConfig
from manip.agents.dqn import DQNConfig
from manip.agents.ppo import PPOConfig
from manip.agents.ppo_kl import PPOKLConfig
from manip.agents.reinforce import ReinforceConfig
from manip.agents.sac import SACConfig
from manip.agents.td3 import TD3Config
from manip.agents.trpo import TRPOConfig
from manip.envs.task_registry import task_names
from manip.errors import UserError, one_line, unknown
from manip.io.dataclass_values import build
from manip.robot_config import RobotConfig
from manip.sim.scene import Fidelity
from manip.training.option_ranges import check_options

AgentConfig = (
    ReinforceConfig
    | A2CConfig
    | A3CConfig
    | TRPOConfig
    | PPOConfig
    | PPOKLConfig
    | DQNConfig
    | TD3Config
    | SACConfig
    | BCConfig
)
ALGORITHMS: dict[str, type[AgentConfig]] = {
    "reinforce": ReinforceConfig,
    "a2c": A2CConfig,
    "a3c": A3CConfig,
    "trpo": TRPOConfig,
    "ppo": PPOConfig,
    "ppo-kl": PPOKLConfig,
    "dqn": DQNConfig,
    "td3": TD3Config,
    "sac": SACConfig,
    "bc": BCConfig,
}
"""Algorithm name -> its options."""

Controller = Literal["OSC_POSE", "OSC_POSITION", "JOINT_POSITION", "JOINT_VELOCITY"]

MAY_CHANGE = {
    *("out", "resume", "steps", "threads", "wandb"),
    *("eval_every", "eval_episodes", "checkpoint_every", "faults"),
    "save_buffer",
}
"""Options that a run may go on with changed: the others made it what it is."""


@dataclass(frozen=True)
class TrainConfig:
    """Train a policy on the batch engine, from a tuned recipe."""

    task: str = "Lift"
    """Task to learn (see `manip list`), or package.module:Task."""
    algo: str = "sac"
    """Algorithm (see `manip list`)."""
    robot: str = "Panda"
    """Arm (see `manip list`)."""
    controller: Controller = "OSC_POSE"
    """Action space, as robosuite defines it (JOINT_VELOCITY: dm_control only)."""
    seed: int = 0
    """Seed of the worlds, the network and the exploration."""
    out: Path | None = None
    """Run folder; runs/<task>-<algo>-<seed> unless given."""
    resume: bool = False
    """Continue the run in the run folder from its latest checkpoint."""
    steps: int = 100_000
    """Control steps to train for, all worlds together."""
    num_envs: int = 32
    """TaskBatch that are simulated side by side."""
    horizon: int | None = None
    """Length of a training episode [control steps]; the task's own unless given."""
    control_freq: int = 20
    """Control frequency [Hz]."""
    fidelity: Fidelity = "fast"
    """Physics while training; evaluation is always exact."""
    reward: Literal["shaped", "stock"] = "shaped"
    """Reward set: ours, or robosuite's own shaped reward."""
    restart_fraction: float = 0.0
    """Share of the training episodes that begin where an earlier one has been."""
    cool_down: float = 0.0
    """Last share of the steps, in which learning rates fall linearly to zero."""
    threads: int | None = None
    """Threads of physics and learner; the CPUs this process may use unless given."""
    gradients: Literal["native", "torchrl"] = "native"
    """Gradients of SAC and PPO: compiled code that is compared with TorchRL's losses at
    the start and now and then (native), or those losses with autograd (torchrl). All
    other algorithms always learn through TorchRL's losses."""
    overlap: bool = True
    """Simulate and learn at the same time where the algorithm allows (SAC)."""
    eval_every: int = 10_000
    """Control steps between evaluations."""
    eval_episodes: int = 32
    """Episodes an evaluation."""
    faults: Literal["survive", "stop"] = "survive"
    """Numbers that go wrong cost an episode or an update (survive), or end the run."""
    save_buffer: bool = True
    """Checkpoints hold the replay buffer; without it, a resumed run fills it anew."""
    checkpoint_every: float = 60.0
    """Seconds between checkpoints (one is written at every evaluation, too)."""
    wandb: str | None = None
    """Log to this Weights & Biases project as well (needs the `wandb` extra)."""
    agent: AgentConfig = field(default_factory=SACConfig)
    """Options of the algorithm."""

    def __post_init__(self) -> None:
        check_options(self)
        check_options(self.agent)

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def folder(self) -> Path:
        """The run folder."""
        name = self.task.replace(":", ".").replace("/", "-")
        return self.out or Path("runs") / f"{name}-{self.algo}-{self.seed}"


def recipe_names() -> list[str]:
    """Names `<task>-<algo>` of the tuned recipes that are shipped."""
    paths = (files("manip.assets") / "recipes").iterdir()
    names = [path.name.removesuffix(".yaml") for path in paths]
    return sorted(name for name in names if "-" in name)


def recipes(robot: str | None = None) -> dict[str, TrainConfig]:
    """Name -> options of the tuned recipes that are shipped for tasks known here."""
    tasks = {task.lower(): task for task in task_names()}
    pairs = {name: name.split("-", 1) for name in recipe_names()}
    return {
        name: recipe(tasks[task], algo, robot)
        for name, (task, algo) in pairs.items()
        if task in tasks
    }


def recipe(task: str, algo: str, robot: str | None = None) -> TrainConfig:
    """The tuned options for a task and an algorithm, or the defaults where none are.

    robot: the arm, if not the recipe's own; what the recipe says under `robots` of it
        takes the place of other options. All tasks of another library share one recipe.

    Raises:
        UserError: unknown algorithm.
    """
    if algo not in ALGORITHMS:
        raise unknown("algorithm", algo, ALGORITHMS)
    name = task.split("/")[0] if "/" in task else f"{task.lower()}-{algo}"
    found = dict(_shipped(name))
    arm = {"robot": robot} if robot else {}
    own = found.pop("robots", {}).get(robot, {})
    return from_dict({"task": task, "algo": algo} | found | own | arm)


@cache
def _shipped(name: str) -> dict[str, Any]:
    path = files("manip.assets") / "recipes" / f"{name}.yaml"
    return yaml.safe_load(path.read_text()) if path.is_file() else {}


def to_dict(config: TrainConfig) -> dict[str, Any]:
    """Plain values, fit for YAML."""
    plain = dataclasses.asdict(config) | {"out": str(config.folder)}
    plain["agent"] = {
        key: list(value) if isinstance(value, tuple) else value
        for key, value in plain["agent"].items()
    }
    return plain


def lasting(config: TrainConfig) -> dict[str, Any]:
    """Name -> plain value of the options that stay as they are when a run goes on."""
    plain = to_dict(config)
    plain |= {f"agent.{name}": value for name, value in plain.pop("agent").items()}
    return {name: value for name, value in plain.items() if name not in MAY_CHANGE}


def check_lasting(recorded: dict[str, Any], config: TrainConfig) -> None:
    """Compare what `lasting` gave of a run with the options it is to go on with.

    Raises:
        UserError: one of them differs.
    """
    asked = lasting(config)
    changed = [
        f"{name} was {recorded.get(name)!r}, not {asked.get(name)!r}"
        for name in sorted(recorded.keys() | asked.keys())
        if recorded.get(name) != asked.get(name)
    ]
    if changed:
        raise UserError(
            f"the run cannot go on with other options: {'; '.join(changed)}. Leave "
            "them out, or begin another run with another --out"
        )


def from_dict(values: dict[str, Any]) -> TrainConfig:
    """The configuration of plain values.

    Raises:
        UserError: unknown algorithm or option, or a value that it cannot have.
    """
    algo, out = values.get("algo", "sac"), values.get("out")
    if algo not in (*ALGORITHMS,):
        raise unknown("algorithm", algo, ALGORITHMS)
    agent = build(ALGORITHMS[algo], values.get("agent") or {})
    rest = values | {"agent": agent, "out": Path(out) if isinstance(out, str) else out}
    return build(TrainConfig, rest)


def recorded(folder: Path) -> TrainConfig:
    """The configuration that a run has left in its folder.

    Raises:
        UserError: it is damaged.
        OSError: there is none.
    """
    path = folder / "config.yaml"
    try:
        values = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{path} is damaged: {one_line(error)}") from error
    if not isinstance(values, dict):
        raise UserError(f"{path} is damaged: it holds no options")
    values.pop("versions", None)
    return from_dict(values)
