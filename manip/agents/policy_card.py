"""The card of a policy: what it was trained for. Its values are not trusted."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Annotated, Any, Literal

from manip.agents.image_encoder import MOST_CHANNELS, EncoderSizes
from manip.agents.networks import MOST_NEURONS
from manip.cameras import CameraConfig, part_name
from manip.deploy.formulas import parse_formula
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

Observe = Literal["state", "cameras"]
"""What an actor sees: the whole observation, or cameras and proprioception."""

CAMERAS = "-cameras"
"""End of the names of recipes and policies whose actor sees cameras."""

MOST_CAMERAS = 16
MOST_OUTPUTS = 2**24
"""Most numbers that the first convolution may make of an image."""


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
        image_channels, image_features: widths of the encoder of each camera; see
            `manip.agents.image_encoder`.
        image_quality: of the images that the policy was trained with.
        looks: strength of the random looks that it was trained with.
        randomised: what differed from episode to episode of its training, see
            `manip.envs.perturbation`; empty for nothing.
        waypoint_fraction: fraction of the training episodes that started from a
            waypoint at first, see `manip.envs.waypoint_starts`.
        image_convention: order of the rows: "opengl", the bottom row first, as
            robosuite's camera observations are.
        horizon: length of the task's episodes [control steps]; 0 if it is not known.
        fidelity: physics of the training.
        evaluation: result of the evaluation that chose the policy: episodes, success
            rates and mean return, in exact physics.
        measurements: what a robot must measure: name -> shape, unit, frame, meaning.
        formulas: part of the observation -> formula of the measurements, scales and
            clips included, in the language of `manip.deploy.formulas`.
        control: what an action does: name of the control law, range of its inputs,
            motion [m, rad] at 1 and at -1, frame, gains, base frame, gripper.

    The last three are empty for tasks of other libraries, and for policies of earlier
    versions; `manip export` computes them then.
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
    image_channels: Annotated[list[int], Range(1, MOST_CHANNELS)] = field(
        default_factory=list
    )
    image_features: Annotated[int, Range(0, MOST_NEURONS)] = 0
    image_quality: Literal["", "exact", "lean"] = ""
    looks: Annotated[float, Range(0.0, 1.0)] = 0.0
    randomised: list[dict[str, str | float | list[float]]] = field(default_factory=list)
    waypoint_fraction: Annotated[float, Range(0.0, 1.0)] = 0.0
    image_convention: Literal["opengl"] = "opengl"
    horizon: Annotated[int, WHOLE] = 0
    fidelity: Literal["", "exact", "fast"] = ""
    evaluation: dict[str, float] = field(default_factory=dict)
    measurements: dict[str, dict[str, str]] = field(default_factory=dict)
    formulas: dict[str, str] = field(default_factory=dict)
    control: dict[str, float | str | list[float] | list[str]] = field(
        default_factory=dict
    )
    format: Annotated[int, COUNT] = FORMAT

    @property
    def robot_config(self) -> RobotConfig:
        """Arm, controller and control frequency."""
        return RobotConfig(self.robot, self.controller, self.control_freq)

    @property
    def name(self) -> str:
        """Name of the policy if it is shipped: task, arm if no Panda, and cameras."""
        robot = "" if self.robot == "Panda" else f"-{self.robot}"
        return f"{self.task}{robot}{CAMERAS if self.cameras else ''}"

    @property
    def method(self) -> str:
        """Algorithm and observation, as recipes are named: bc, bc-cameras."""
        return method_name(self.algo, "cameras" if self.cameras else "state")

    @cached_property
    def observation_spec(self) -> ObservationSpec:
        """The observation as a specification, which joins the parts."""
        return ObservationSpec.from_dict(self.observation)

    @property
    def observation_dim(self) -> int:
        """D, the length of the joined observation."""
        return self.observation_spec.dim

    @cached_property
    def cameras(self) -> CameraConfig | None:
        """Cameras that an evaluator must give, as robosuite draws them; None without.

        Raises:
            UserError: their images are of another form than cameras give.
        """
        parts = tuple(p for p in self.observation_spec.parts if p.role == "camera")
        if not parts:
            return None
        size, *_, channels = parts[0].shape or (0, 0)
        names = tuple(part.name.removesuffix(part_name("")) for part in parts)
        config = CameraConfig(names, size, "exact", channels // 3)
        if config.parts != parts or len(parts) > MOST_CAMERAS:
            raise UserError(
                "images of a policy must be uint8 [S, S, 3 frames], equal for all of "
                f"at most {MOST_CAMERAS} cameras, named as <camera>_image"
            )
        return config

    @property
    def encoder_sizes(self) -> EncoderSizes | None:
        """Sizes of the encoders, one for each camera; None without cameras."""
        if self.cameras is None:
            return None
        shapes = tuple(part.shape for part in self.cameras.parts)
        return EncoderSizes(shapes, tuple(self.image_channels), self.image_features)


def method_name(algo: str, observe: Observe) -> str:
    """Algorithm and observation, as recipes are named: bc, bc-cameras."""
    return algo if observe == "state" else f"{algo}{CAMERAS}"


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
    _check_formulas(card)
    for text in _texts(asdict(card) | {"formulas": [*card.formulas]}):
        if not TEXT.fullmatch(text):
            raise UserError(
                f"the card holds text that is no plain name: {shown(text[:50])}"
            )
    _check_cameras(card)
    least = 0 if card.cameras else 1
    if not least <= card.observation_dim <= MOST_NEURONS:
        raise UserError(
            f"the observation has {shown(card.observation_dim)} numbers, expected "
            f"{least} to {MOST_NEURONS}"
        )
    return card


def _check_formulas(card: PolicyCard) -> None:
    """Raise `UserError` unless all formulas can be parsed; they are not evaluated."""
    for name, text in card.formulas.items():
        try:
            parse_formula(text)
        except ValueError as error:
            raise UserError(f"formula of {shown(name)}: {error}") from None


def _check_cameras(card: PolicyCard) -> None:
    """Raise `UserError` unless the encoders are possible, if there are cameras."""
    if card.cameras is None:
        return
    if not card.image_channels or not card.image_features or card.bins:
        raise UserError(
            "a policy with cameras needs image_channels and image_features, and no bins"
        )
    outputs = (card.cameras.size // 2) ** 2 * card.image_channels[0]
    if outputs > MOST_OUTPUTS:
        raise UserError(
            f"the first convolution makes {outputs} numbers of an image, more than "
            f"{MOST_OUTPUTS}"
        )


def _texts(value: Any) -> Iterator[str]:
    """Yield all text in a tree of plain values, names included."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        yield from _texts([*value.keys(), *value.values()])
    elif isinstance(value, list):
        for item in value:
            yield from _texts(item)
