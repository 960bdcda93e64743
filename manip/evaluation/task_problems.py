"""Compare a task natively and in stock robosuite, and measure its ranges.

Each function returns problems, one line each; none where everything is in order.
"""

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import log, sqrt

import numpy as np

from manip.envs.backends.native_batch import NativeBatch
from manip.envs.backends.stock_batch import StockBatch
from manip.envs.episode_streams import EpisodeStreams
from manip.envs.task import Measures, Start, Task
from manip.robot_config import RobotConfig
from manip.sim.scene import Scene, load_scene
from manip.sim.sensors import Sensors

Array = np.ndarray

NATIVE_STARTS, STOCK_STARTS = 400, 50
"""Start states that are compared; robosuite resets slowly."""

FALSE_ALARM = 1e-6
"""Probability that equal distributions of one number are called different."""

ROUNDING = 1e-4
"""Differences of start states that do not count [m, rad]."""

TOLERANCE = 1e-3
"""Largest difference of observations and reward terms after some equal steps."""

STEPS = 10
"""Control steps that are compared."""

LARGE = 10.0
"""Observations beyond are called large: networks learn from numbers of order one."""


@dataclass(frozen=True)
class TaskBackends:
    """A task natively and in stock robosuite, built once.

    Attributes:
        task: the task.
        scene: its compiled scene.
        stock: one environment of robosuite.
    """

    task: Task
    scene: Scene
    stock: StockBatch


def open_task(task: Task, robot: RobotConfig) -> TaskBackends:
    """Build the task in both backends.

    Raises:
        UserError: the task cannot be built.
    """
    scene = load_scene(task.robosuite_name, task.sensors, robot)
    return TaskBackends(task, scene, StockBatch(task, robot=robot, stock=scene.stock))


def start_problems(task: TaskBackends) -> Iterator[str]:
    """Compare the distributions of start states: arm, objects, sites, joints, fields.

    Raises:
        UserError: the task's start states are impossible.
    """
    native = _native_starts(task)
    stock = _stock_starts(task)
    for name in _compared(task.task.sensors):
        different = [
            column
            for column in range(native[name].shape[1])
            if not _alike(native[name][:, column], stock[name][:, column])
        ]
        if different:
            yield (
                f"starts differ: {name} is {_span(native[name][:, different])} "
                f"natively (sample_start) and {_span(stock[name][:, different])} in "
                "robosuite (its reset)"
            )


def step_problems(task: TaskBackends) -> Iterator[str]:
    """Take equal random steps from equal starts; compare the task's outputs."""
    stock = task.stock
    stock.restart()
    stock.begin(np.arange(1))
    native = _begun_as(task, stock.read())
    generator = np.random.default_rng(0)
    worst: dict[str, float] = {}
    for _ in range(STEPS):
        action = generator.uniform(-1, 1, (1, stock.action_dim))
        values = [_outputs(batch, action) for batch in (native, stock)]
        for name, value in values[0].items():
            apart = float(np.abs(value - values[1][name]).max(initial=0.0))
            worst[name] = max(worst.get(name, 0.0), apart)
    for name, apart in worst.items():
        if not apart <= TOLERANCE:
            yield f"steps differ: {name} by {apart:.2g} after {STEPS} equal steps"


def range_problems(
    observations: Mapping[str, Array], terms: Mapping[str, Array], reward: Array
) -> Iterator[str]:
    """Ranges over some episodes: parts [T, k], raw terms [T], shaped reward [T]."""
    for name, part in observations.items():
        largest = float(np.abs(part).max(initial=0.0))
        if largest > LARGE:
            yield f"observation {name} reaches {largest:.3g}: scale it to order one"
        if part.size and np.ptp(part, axis=0).max() == 0:
            yield f"observation {name} never changes"
    for name, term in terms.items():
        if np.abs(term).max() == 0:
            yield f"reward term {name} was 0 in every step, the expert's included"
    if reward.min() < -1e-6 or reward.max() > 1 + 1e-6:
        yield (
            f"the shaped reward of a step is from {reward.min():.3g} to "
            f"{reward.max():.3g}, not from 0 to 1"
        )


def _compared(sensors: Sensors) -> Sequence[str]:
    """Readings that are compared: not the bodies that are out of the way."""
    bodies = [n for n, body in sensors.bodies.items() if body not in sensors.parked]
    return (
        *("joint_pos", "gripper_qpos"),
        *(f"{name}_{part}" for name in bodies for part in ("pos", "quat")),
        *(f"{name}_pos" for name in sensors.sites),
        *(f"{name}_qpos" for name in sensors.joints),
        *sensors.fields,
    )


def _native_starts(task: TaskBackends) -> Measures:
    batch = NativeBatch(task.task, NATIVE_STARTS, scene=task.scene)
    batch.begin(np.arange(NATIVE_STARTS))
    return {name: _plain(name, rows) for name, rows in batch.read().items()}


def _stock_starts(task: TaskBackends) -> Measures:
    rows: list[Measures] = []
    for episode in range(STOCK_STARTS):
        task.stock.restart(episode=episode)
        task.stock.begin(np.arange(1))
        rows.append(task.stock.read())
    names = _compared(task.task.sensors)
    return {n: _plain(n, np.concatenate([row[n] for row in rows])) for n in names}


def _plain(name: str, rows: Array) -> Array:
    """Rotations q and -q are the same: w is positive."""
    return rows * np.where(rows[:, :1] < 0, -1, 1) if name.endswith("_quat") else rows


def _alike(first: Array, second: Array) -> bool:
    """Kolmogorov-Smirnov test of samples [n] and [m]; differences below `ROUNDING` do
    not count.
    """
    values = [np.sort(np.round(sample / ROUNDING)) for sample in (first, second)]
    both = np.concatenate(values)
    here, beyond = (
        [np.searchsorted(v, both + shift, "right") / len(v) for v in values]
        for shift in (0, 1)
    )
    apart = max((here[0] - beyond[1]).max(), (here[1] - beyond[0]).max())
    n, m = len(first), len(second)
    return bool(apart <= sqrt(-0.5 * log(FALSE_ALARM / 2) * (n + m) / (n * m)))


def _span(values: Array) -> str:
    lows, highs = values.min(axis=0), values.max(axis=0)
    spans = [
        f"{low:.4g}" if high - low < ROUNDING else f"{low:.4g} to {high:.4g}"
        for low, high in zip(lows, highs, strict=True)
    ]
    return f"({', '.join(spans)})"


def _begun_as(task: TaskBackends, read: Measures) -> NativeBatch:
    """One native environment that begins in the state that was read."""
    fields = {name: read[name] for name in task.task.sensors.fields}

    def sample_start(scene: Scene, streams: EpisodeStreams) -> Start:
        rows = np.zeros(len(streams), int)
        repeated = {name: values[rows] for name, values in fields.items()}
        return Start(read["qpos"][rows].copy(), repeated)

    twin = copy.copy(task.task)
    setattr(twin, "sample_start", sample_start)  # noqa: B010, of this instance alone
    batch = NativeBatch(twin, 1, scene=task.scene)
    batch.begin(np.arange(1))
    return batch


def _outputs(batch: NativeBatch | StockBatch, action: Array) -> dict[str, Array]:
    step = batch.step(action)
    parts = batch.observation_spec.split(step.observation)
    return {
        **{f"observation {name}": part for name, part in parts.items()},
        **{f"reward term {name}": term for name, term in step.reward_terms.items()},
        "success": step.success.astype(float),
    }
