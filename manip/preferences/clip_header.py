"""The header of a clip: where it comes from. Its values are not trusted."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from manip.agents.policy_card import TEXT
from manip.envs.episode_streams import Purpose
from manip.errors import UserError, check_choice, shown
from manip.io.dataclass_values import build
from manip.io.option_ranges import COUNT, SIGNED, WHOLE, Range, check_options
from manip.robot_config import RobotConfig, check_robot_config
from manip.sim.scene import Fidelity

FORMAT = 1
"""Version of clip files; raised when they change incompatibly."""


@dataclass(frozen=True)
class ClipHeader:
    """What is needed, besides its arrays, to draw, repeat and judge a clip.

    Attributes:
        task: its name, as in `load_task`.
        robot, controller, control_freq: see `RobotConfig`.
        fidelity: physics of the batch engine.
        reward_set: the task's reward set, and in reward_weights its terms and weights.
        seed, purpose: the random streams of the episodes.
        env, episode, step: the environment, its episode, and the control steps of the
            episode before the clip.
        actor: who acted, in words: "expert", "ppo policy after 20480 steps".
        measure_names: of the visible measures.
    """

    task: str
    robot: str
    controller: str
    control_freq: Annotated[int, Range(1, 10_000)]
    fidelity: Fidelity
    reward_set: str
    reward_weights: Annotated[dict[str, float], SIGNED]
    seed: Annotated[int, Range(0, 2**32 - 1)]
    purpose: str
    env: Annotated[int, WHOLE]
    episode: Annotated[int, WHOLE]
    step: Annotated[int, WHOLE]
    actor: str
    measure_names: tuple[str, ...]
    format: Annotated[int, COUNT] = FORMAT

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def reward_names(self) -> tuple[str, ...]:
        """Names of the reward terms, in order."""
        return tuple(self.reward_weights)


def read_header(values: Any) -> ClipHeader:
    """Build a header from plain values of any origin.

    Raises:
        UserError: it is of another format, or one of its values is impossible.
    """
    form = values.get("format") if isinstance(values, Mapping) else None
    if form != FORMAT:
        raise UserError(f"it has format {shown(form)}, expected {FORMAT}")
    header = build(ClipHeader, values)
    check_options(header)
    check_robot_config(header.robot_config)
    check_choice("purpose", header.purpose, [each.name.lower() for each in Purpose])
    for text in _texts(asdict(header)):
        if not TEXT.fullmatch(text):
            raise UserError(f"it holds text that is no plain name: {shown(text[:50])}")
    return header


def _texts(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield all text of a header, names of measures and reward terms included."""
    for value in values.values():
        if isinstance(value, str):
            yield value
        elif isinstance(value, tuple | dict):
            yield from value
