"""Options of a training run; manip.training.recipes has tuned ones."""

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from manip.agents.agent import AgentConfig
from manip.agents.policy_card import Observe, method_name
from manip.agents.registry import check_algorithm_origin, load_algorithm
from manip.errors import UserError, shown
from manip.io.dataclass_values import build
from manip.io.option_ranges import COUNT, NUMBER, SHARE, Range, check_options
from manip.io.yaml_files import read_yaml
from manip.preferences.label_options import LabelOptions
from manip.robot_config import RobotConfig
from manip.sim.scene import Fidelity
from manip.sim.warp.library import Device
from manip.training.reward_weights import parse_weights

Controller = Literal["OSC_POSE", "OSC_POSITION", "JOINT_POSITION", "JOINT_VELOCITY"]

MAY_CHANGE = {
    *("out", "resume", "steps", "until", "threads", "wandb"),
    *("eval_every", "eval_episodes", "curve_episodes", "checkpoint_every", "faults"),
    *("save_buffer", "preferences", "device", "njmax", "nconmax"),
}
"""Options that may change when a run is resumed; the others made it what it is."""

NESTED = ("labels", "agent")
"""Options that are groups of options."""

SCALE = "action_scale"
"""Option whose length is that of the controller's action."""

RENAMED = {"num_worlds": "num_envs", "own_starts": "restart_fraction"}
"""Old name of an option -> its present name."""


@dataclass(frozen=True)
class TrainConfig:
    """Train a policy on the batch engine; a tuned recipe sets the defaults."""

    task: str = "Lift"
    """Task to learn (see `manip list`), or package.module:Class."""
    algo: str = "sac"
    """Algorithm (see `manip list`), or package.module:Class."""
    robot: str = "Panda"
    """Robot arm (see `manip list`)."""
    controller: Controller = "OSC_POSE"
    """Action space, as robosuite defines it (JOINT_VELOCITY: dm_control only)."""
    seed: Annotated[int, Range(0, 2**32 - 1)] = 0
    """Seed of the environments, the networks and the exploration. The same command with
    the same seed on the same machine gives the same run."""
    out: Path | None = None
    """Run folder; runs/<task>-<algo>[-cameras]-<seed> unless given."""
    resume: bool = False
    """Continue the run in the run folder from its latest checkpoint."""
    steps: Annotated[int, COUNT] = 100_000
    """Control steps to train for, all environments together."""
    until: Annotated[float, SHARE] = 0.0
    """Share of success_held that the run is to reach: while its best evaluation is
    below it at the end, training goes on by a third of --steps, at most three times.
    More --eval-episodes decide this better."""
    num_envs: Annotated[int, COUNT] = 32
    """Number of environments that are stepped in parallel. With more of them, policies
    are updated less often per control step."""
    collectors: Annotated[int, COUNT] = 1
    """Equal parts into which the environments are split, each stepped by a collector of
    its own. The run depends on their number."""
    observe: Observe = "state"
    """Observation of the actor. state: all parts of the task's observation; cameras:
    camera images and proprioception, without the poses of objects."""
    cameras: tuple[str, ...] = ("robot0_eye_in_hand",)
    """Cameras that the actor sees with `--observe cameras`, by robosuite's names."""
    parts: tuple[str, ...] = ()
    """Parts of the observation that the actor sees besides the cameras' images; those
    that a real arm measures by itself (proprioception) unless given."""
    image_size: Annotated[int, Range(8, 512)] = 32
    """Height and width of the images [pixel]. Larger ones show more, and cost more time
    to draw and to learn from."""
    image_quality: Literal["exact", "lean"] = "lean"
    """Images of training. exact: robosuite's bytes; lean: without reflections and with
    fewer triangles, several times faster. `manip evaluate` uses exact images."""
    frames: Annotated[int, Range(1, 16)] = 1
    """Latest images that the actor sees of each camera (frame stack). More of them
    show motion, and what has left the view."""
    looks: Annotated[float, SHARE] = 0.0
    """Strength, from 0 to 1, of random changes of colours, textures, lights and camera
    poses in each episode (domain randomisation), also of the evaluations that choose
    the best policy."""
    randomise: str = ""
    """What differs from episode to episode of the training besides images, such as
    masses, friction and delays (domain randomisation): the name of a shipped list (see
    `manip list`), or a YAML file of your own. It also holds for the evaluations that
    choose the best policy; `manip evaluate` has none."""
    teacher: str | None = None
    """Policy that `--algo bc` imitates instead of the task's expert: a run folder, a
    policy folder or the name of a shipped policy. It sees the whole observation."""
    dataset: str | None = None
    """Data set of recorded episodes: a robomimic file, or a LeRobot or Minari folder
    (docs/datasets.md). `--algo bc` imitates it, without an expert or a simulation;
    `--algo sac` takes half of each batch from it."""
    horizon: Annotated[int | None, COUNT] = None
    """Length of a training episode [control steps]; the task's own unless given."""
    control_freq: Annotated[int, COUNT] = 20
    """Control frequency [Hz]: 10, 20, 25, 50 or 100."""
    fidelity: Fidelity = "fast"
    """Physics of training. exact: as stock robosuite; fast: larger time steps, and
    most of the arm's links do not collide. Evaluation always uses exact physics."""
    engine: Literal["native", "warp"] = "native"
    """Engine that steps the training environments. native: MuJoCo's C code; warp:
    MuJoCo Warp on an NVIDIA GPU (the extra gpu, docs/gpu.md). Evaluations always use
    the native engine."""
    device: Device | None = None
    """Device of --engine warp, cuda unless given: PPO and SAC also learn there
    (docs/gpu.md). cpu: the same kernels on one core, to try and to test them."""
    njmax: Annotated[int | None, COUNT] = None
    """Constraint rows that --engine warp allocates for an environment; as measured for
    the task unless given. A larger number takes more memory and time."""
    nconmax: Annotated[int | None, COUNT] = None
    """Contacts that --engine warp allocates for an environment, on average; as measured
    for the task unless given."""
    reward: Literal["shaped", "stock"] = "shaped"
    """Reward set: manip's own, or robosuite's shaped reward."""
    reward_weights: tuple[str, ...] = ()
    """Weights of reward terms that replace those of the task, as in
    `lift=0.6 reach=0.1`. A larger weight pays more for the term."""
    restart_fraction: Annotated[float, SHARE] = 0.0
    """Fraction of training episodes that start from a previously visited state."""
    waypoint_fraction: Annotated[float, SHARE] = 0.0
    """Fraction of training episodes that start from a waypoint of the task: a state in
    the middle of it, generated before the training (docs/waypoints.md). The fraction
    falls to a tenth as the success from waypoints rises."""
    init: str | None = None
    """Policy that the actor starts from (fine-tuning): a run folder, or the name of a
    shipped policy. The critics are new."""
    init_std: Annotated[float, Range(0.01, 1.0)] = 0.1
    """Standard deviation of the actions of a policy from --init at the start [fraction
    of the action's range]: larger explores more."""
    cool_down: Annotated[float, SHARE] = 0.0
    """Last fraction of --steps in which learning rates fall linearly to zero. A
    run that goes on with more steps has them fall anew."""
    threads: Annotated[int | None, COUNT] = None
    """Threads of simulation and learner; all CPUs of this process unless given. The
    number changes the speed only."""
    gradients: Literal["native", "torchrl"] = "native"
    """Gradients of SAC and PPO: native: compiled code, which is compared with TorchRL's
    losses at the start and at every 1,000th update; torchrl: those losses with
    autograd. All other algorithms, and learners on --device cuda, always use TorchRL's
    losses."""
    overlap: bool = True
    """Simulate and learn at the same time: faster on two cores or more (off-policy
    algorithms only). The policy that collects is then older by one round of updates."""
    eval_every: Annotated[int, COUNT] = 10_000
    """Control steps between evaluations of the policy; the best one is saved."""
    eval_episodes: Annotated[int, COUNT] = 32
    """Episodes per evaluation: more choose the best policy better, and take longer."""
    curve_episodes: Annotated[int, Range(0, 10_000)] = 4
    """Episodes of a light evaluation for the learning curve, in the physics and with
    the length of training episodes, in each tenth of the run that has no other
    evaluation; 0 for none. They choose no policy and do not change the run."""
    faults: Literal["survive", "stop"] = "survive"
    """A number that is not finite ends an episode or skips an update (survive), or
    ends the run (stop)."""
    save_buffer: bool = True
    """Save the replay buffer in checkpoints; without it, a resumed run refills it."""
    checkpoint_every: Annotated[float, NUMBER] = 60.0
    """Time between checkpoints [s]; each evaluation also writes one."""
    wandb: str | None = None
    """Log to this Weights & Biases project as well (needs the `wandb` extra)."""
    preferences: Path | None = None
    """Folder of clips and comparisons: the run learns from these, and from those that
    it asks for (see --labels), instead of from the task's reward."""
    labels: LabelOptions = field(default_factory=LabelOptions)
    """Options of a run with --preferences."""
    taste: str = ""
    """Taste whose weighted penalties are subtracted from the reward (see `manip list`):
    what labellers of this taste want, as if it were known without labels."""
    agent: AgentConfig = field(default_factory=lambda: load_algorithm("sac").Config())
    """Options of the algorithm."""

    def __post_init__(self) -> None:
        check_options(self)
        parse_weights(self.reward_weights)
        check_options(self.agent)
        expected = load_algorithm(self.algo).Config
        if type(self.agent) is not expected:
            raise UserError(
                f"agent must hold the options of algorithm {self.algo!r}, "
                f"{expected.__name__}, not {type(self.agent).__name__}"
            )

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def method(self) -> str:
        """Algorithm and observation, as recipes are named: bc, bc-cameras."""
        return method_name(self.algo, self.observe)

    @property
    def folder(self) -> Path:
        """The run folder."""
        name = f"{self.task}-{self.method}-{self.seed}"
        return self.out or Path("runs") / name.replace(":", ".").replace("/", "-")


def to_dict(config: TrainConfig) -> dict[str, Any]:
    """Return the options as plain values, fit for YAML."""
    plain = dataclasses.asdict(config) | {"out": str(config.folder)}
    plain |= {"preferences": config.preferences and str(config.preferences)}
    return _with_lists(plain) | {name: _with_lists(plain[name]) for name in NESTED}


def _with_lists(values: dict[str, Any]) -> dict[str, Any]:
    return {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}


def lasting(config: TrainConfig) -> dict[str, Any]:
    """Return the options that must not change when a run is resumed: name -> value."""
    plain = to_dict(config)
    for group in NESTED:
        options = plain.pop(group).items()
        plain |= {f"{group}.{name}": value for name, value in options}
    return {name: value for name, value in plain.items() if name not in MAY_CHANGE}


def check_lasting(recorded: dict[str, Any], config: TrainConfig) -> None:
    """Compare the `lasting` options of a run with those that it is resumed with.

    Options that did not exist yet when the run began have their defaults.

    Raises:
        UserError: one of them differs.
    """
    requested, before = lasting(config), lasting_defaults(config.algo) | recorded
    changed = [
        f"{name} was {before.get(name)!r}, not {requested.get(name)!r}"
        for name in sorted((before.keys() | requested.keys()) - MAY_CHANGE)
        if before.get(name) != requested.get(name)
    ]
    if changed:
        raise UserError(
            f"the run cannot be resumed with other options: {'; '.join(changed)}. "
            "Leave them out, or start another run with another --out"
        )


def lasting_defaults(algo: str) -> dict[str, Any]:
    """The `lasting` options of a run for which none was given."""
    return lasting(TrainConfig(algo=algo, agent=load_algorithm(algo).Config()))


def from_dict(values: dict[str, Any]) -> TrainConfig:
    """Build a configuration from plain values.

    Raises:
        UserError: unknown algorithm or option, or a value that the option cannot have.
    """
    algo, out = values.get("algo", "sac"), values.get("out")
    if not isinstance(algo, str):
        raise UserError(f"algo must be text, not {shown(algo)}")
    _check_names(values)
    agent = build(load_algorithm(algo).Config, values.get("agent") or {})
    labels = build(LabelOptions, values.get("labels") or {})
    rest = values | {"agent": agent, "labels": labels, "out": _path(out)}
    rest |= {"preferences": _path(values.get("preferences"))}
    return build(TrainConfig, rest)


def _path(value: Any) -> Any:
    return Path(value) if isinstance(value, str) else value


def _check_names(values: dict[str, Any]) -> None:
    for old, new in RENAMED.items():
        if old in values:
            raise UserError(f"the option {old} is now called {new}")


def recorded(folder: Path) -> TrainConfig:
    """Read the configuration in a run folder.

    Raises:
        UserError: it is damaged, or names an algorithm whose code lies in the folder.
        OSError: there is none.
    """
    path = folder / "config.yaml"
    values = read_yaml(path)
    if not isinstance(values, dict):
        raise UserError(f"{path} is damaged: expected a mapping of options")
    values.pop("versions", None)
    check_algorithm_origin(str(values.get("algo", "sac")), folder)
    try:
        return from_dict(values)
    except UserError as error:
        raise UserError(f"{path}: {error}") from error
