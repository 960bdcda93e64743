"""The card of a policy: what it was trained for. Its values are not trusted."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Any

from manip.agents.networks import MOST_NEURONS
from manip.errors import UserError, shown
from manip.io.dataclass_values import build
from manip.io.option_ranges import COUNT, WHOLE, Range, check_options
from manip.observation import ObservationSpec
from manip.robot_config import RobotConfig

FORMAT = 3
"""Version of the policy files; raised when they change incompatibly."""

TEXT = re.compile(r"[\w .,:/+()-]{0,200}", re.ASCII)
"""Text that a card may hold: no markup, escape sequences or line breaks."""

WIDTH = Range(1, MOST_NEURONS)


@dataclass(frozen=True)
class PolicyCard:
    """What a policy was trained for: all that an evaluator needs besides the weights.

    Attributes:
        observation: the parts that the policy needs, in the order in which it joins
            them: name, shape, dtype and role of each (see manip.observation).
        hidden: widths of the hidden layers.
        squash, normalise: the form of the network; see `Actor`.
        env_steps: control steps of training that led to the policy.
        bins: values that each dimension of the action can take; 0 if it is continuous.
    """

    task: str
    robot: str
    algo: str
    controller: str
    control_freq: Annotated[int, Range(1, 10_000)]
    action_dim: Annotated[int, WIDTH]
    observation: list[dict[str, str | list[int]]]
    hidden: Annotated[list[int], WIDTH]
    squash: bool
    normalise: bool
    env_steps: Annotated[int, WHOLE]
    seed: Annotated[int, Range(0, 2**32 - 1)]
    versions: dict[str, str]
    bins: Annotated[int, Range(0, 1000)] = 0
    format: Annotated[int, COUNT] = FORMAT

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def name(self) -> str:
        """Name of the policy if it is shipped: its task, and its arm if no Panda."""
        return self.task if self.robot == "Panda" else f"{self.task}-{self.robot}"

    @cached_property
    def observation_spec(self) -> ObservationSpec:
        """The observation as a specification, which joins the parts."""
        return ObservationSpec.from_dict(self.observation)

    @property
    def observation_dim(self) -> int:
        """D, the length of the joined observation."""
        return self.observation_spec.dim


def read_card(values: Any) -> PolicyCard:
    """Build a card from plain values of any origin.

    Raises:
        UserError: it is of another format, or one of its values is impossible.
    """
    form = values.get("format") if isinstance(values, Mapping) else None
    if form != FORMAT:
        raise UserError(
            f"it has format {shown(form)}, expected {FORMAT}: train it again with this "
            "version"
        )
    card = build(PolicyCard, values)
    check_options(card)
    for text in _texts(asdict(card)):
        if not TEXT.fullmatch(text):
            raise UserError(
                f"the card holds text that is no plain name: {shown(text[:50])}"
            )
    if not 1 <= card.observation_dim <= MOST_NEURONS:
        raise UserError(
            f"the observation has {shown(card.observation_dim)} numbers, expected 1 to "
            f"{MOST_NEURONS}"
        )
    return card


def _texts(value: Any) -> Iterator[str]:
    """Yield all text in a tree of plain values, names included."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        yield from _texts([*value.keys(), *value.values()])
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)
