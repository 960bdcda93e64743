"""StoredEpisode: what happened in an episode; Recording: what it is a record of."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from manip.cameras import Quality
from manip.errors import UserError
from manip.io.dataclass_values import build
from manip.observation import ObservationSpec
from manip.robot_config import RobotConfig

Array = np.ndarray

MOST_JSON = 2**22
"""Most characters of the JSON text of a recording."""


@dataclass(frozen=True)
class Recording:
    """The environments and the actor of recorded episodes.

    Attributes:
        task, robot, controller, control_freq: of the environments.
        actor: who acted, in words.
        observation: the parts, as `ObservationSpec.to_dict` gives them; images upright.
        seed: of the episodes.
        noise: largest standard deviation of the noise on the actions.
        reward: names the reward set.
        image_quality: exact: robosuite's bytes; lean: see `manip record`.
    """

    task: str
    robot: str
    controller: str
    control_freq: int
    actor: str
    observation: list[dict[str, str | list[int]]]
    seed: int = 0
    noise: float = 0.0
    reward: str = "shaped"
    image_quality: Quality = "exact"

    @property
    def spec(self) -> ObservationSpec:
        """The parts of the observation, images included."""
        return ObservationSpec.from_dict(self.observation)

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the parts that are images."""
        return tuple(p.name for p in self.spec.parts if p.role == "camera")

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    def to_json(self) -> str:
        """The recording as text, which files of every format hold."""
        return json.dumps(asdict(self))


def read_recording(text: Any) -> Recording:
    """The recording that `Recording.to_json` wrote.

    Raises:
        UserError: it is something else.
    """
    if not isinstance(text, str) or len(text) > MOST_JSON:
        raise UserError("it holds no description of a recording of manip")
    try:
        recording = build(Recording, json.loads(text))
    except (json.JSONDecodeError, RecursionError) as error:
        raise UserError("its description of the recording is no JSON") from error
    recording.spec  # noqa: B018  raises for impossible parts
    return recording


@dataclass(frozen=True)
class StoredEpisode:
    """T control steps of one environment, from the start of an episode.

    Attributes:
        observation: [T + 1, D] float32, before each step and after the last.
        action: [T, A] float32 in [-1, 1], what was done.
        label: [T, A] float32, what the actor had chosen before noise was added.
        reward: [T] float32.
        success: [T] bool, after each step.
        terminated: whether the last step failed for good; else time was up.
        images: camera part -> [T + 1, H, W, 3] uint8, the bottom row first.
        states: [T + 1, 1 + nq + nv] float64, robosuite's flattened state: time, qpos,
            qvel; None without.
        fields: model fields of the episode, name -> [k].
        model: MJCF of the episode; "" without.
    """

    observation: Array
    action: Array
    label: Array
    reward: Array
    success: Array
    terminated: bool = False
    images: Mapping[str, Array] = field(default_factory=dict)
    states: Array | None = None
    fields: Mapping[str, Array] = field(default_factory=dict)
    model: str = ""

    @property
    def steps(self) -> int:
        """T."""
        return len(self.action)

    def __post_init__(self) -> None:
        """Check the shapes and values, which may come from any file.

        Raises:
            UserError: a shape does not fit, or a number is not finite.
        """
        steps, width = len(self.action), self.action.shape[-1]
        expected = {
            "observation": (steps + 1, *self.observation.shape[1:2]),
            "action": (steps, width),
            "label": (steps, width),
            "reward": (steps,),
            "success": (steps,),
        }
        if not steps:
            raise UserError("an episode without steps")
        for name, shape in expected.items():
            values = getattr(self, name)
            if values.shape != shape:
                raise UserError(f"{name} has shape {values.shape}, expected {shape}")
            if not np.isfinite(values).all():
                raise UserError(f"{name} holds numbers that are not finite")
        if max(abs(self.action).max(), abs(self.label).max()) > 1 + 1e-6:
            raise UserError("actions beyond -1 to 1: they are of another scale")
        for name, pixels in self.images.items():
            if pixels.dtype != np.uint8 or len(pixels) != steps + 1:
                raise UserError(f"{name} holds no image for each step")
