"""Perturbations: what differs from the nominal task, and how it is drawn, as data.

    - {quantity: object_mass, loguniform: [0.5, 4.0]}
    - {quantity: object_position, normal: 0.005, per: step}
    - {quantity: friction, constant: 0.1, share: 0.2}

The same list perturbs an evaluation or randomises the training episodes. Every draw
comes from a stream of its own, so that episodes stay otherwise the same.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import log
from typing import Any, Literal, NamedTuple

import numpy as np

from manip.errors import UserError, check_choice, shown
from manip.io.dataclass_values import build

Array = np.ndarray


class Quantity(NamedTuple):
    """A quantity that perturbations change.

    Attributes:
        unit: of its values; "factor" multiplies the nominal value.
        nominal: the value that changes nothing.
        least, most: of its values.
        of_model: whether it belongs to the simulation, and is drawn once per episode.
        words: what it is.
    """

    unit: str
    nominal: float
    least: float
    most: float
    of_model: bool
    words: str


def _factor(words: str) -> Quantity:
    return Quantity("factor", 1.0, 0.01, 100.0, True, words)


def _offset(unit: str, words: str) -> Quantity:
    return Quantity(unit, 0.0, -10.0, 10.0, False, words)


QUANTITIES = {
    "object_mass": _factor("mass and inertia of the task's objects"),
    "object_size": _factor("lengths of the task's objects, at constant mass"),
    "friction": _factor("friction coefficients of all surfaces"),
    "gripper_force": _factor("force of the gripper"),
    "joint_damping": Quantity(
        "N m s/rad", 0.0, 0.0, 1000.0, True, "damping added to the arm's joints"
    ),
    "controller_stiffness": _factor("kp of the controller; the damping ratio stays"),
    "start_noise": _factor("noise of the arm's start pose (0.02 rad)"),
    "action_delay": Quantity(
        "control steps", 0.0, 0.0, 10.0, False, "age of the action that acts"
    ),
    "action": _offset("fraction of range", "added to each number of the action"),
    "observation_delay": Quantity(
        "control steps", 0.0, 0.0, 10.0, False, "age of the observation"
    ),
    "object_position": _offset("m", "added to measured positions of objects and sites"),
    "object_yaw": _offset("rad", "turn of measured rotations of objects, about z"),
    "hand_position": _offset("m", "added to the measured position of the hand"),
    "joint_position": _offset("rad", "added to measured positions of the joints"),
    "joint_velocity": _offset("rad/s", "added to measured speeds of the joints"),
}
"""Quantity -> its unit and range. Measured values change what the policy observes, not
rewards and success."""

DISTRIBUTIONS = ("constant", "uniform", "loguniform", "normal", "choice")


@dataclass(frozen=True)
class Perturbation:
    """A quantity and how its values are drawn; exactly one distribution is given.

    Attributes:
        quantity: one of `QUANTITIES`.
        constant: this value.
        uniform, loguniform: evenly between two values; loguniform: their logarithm.
        normal: Gaussian about the nominal value with this standard deviation.
        choice: one of these values, each equally likely.
        per: "episode", one value for each episode; "step", a new one in each control
            step. Quantities of the model are drawn per episode.
        share: share of the episodes in which values are drawn; in the others the
            quantity is nominal.
    """

    quantity: str
    constant: float | None = None
    uniform: tuple[float, ...] | None = None
    loguniform: tuple[float, ...] | None = None
    normal: float | None = None
    choice: tuple[float, ...] | None = None
    per: Literal["episode", "step"] = "episode"
    share: float = 1.0

    def __post_init__(self) -> None:
        check_choice("quantity", self.quantity, QUANTITIES)
        given = [n for n in DISTRIBUTIONS if getattr(self, n) is not None]
        if len(given) != 1:
            raise UserError(
                f"{self.quantity} needs one distribution of "
                f"{', '.join(DISTRIBUTIONS)}, not {', '.join(given) or 'none'}"
            )
        if self.kind.of_model and self.per == "step":
            raise UserError(
                f"{self.quantity} is a quantity of the model: draw it per episode"
            )
        if self.normal is not None and self.kind.unit in ("factor", "control steps"):
            raise UserError(
                f"{self.quantity} [{self.kind.unit}] cannot be normal: choose uniform, "
                "loguniform, choice or constant"
            )
        if not 0 < self.share <= 1:
            raise UserError(
                f"{self.quantity}: share must be above 0 and at most 1, not "
                f"{shown(self.share)}"
            )
        _check_values(self)

    @property
    def kind(self) -> Quantity:
        """Unit, nominal value and range of the quantity."""
        return QUANTITIES[self.quantity]

    @property
    def values(self) -> tuple[float, ...]:
        """The numbers of the distribution."""
        given = (getattr(self, name) for name in DISTRIBUTIONS)
        value = next(value for value in given if value is not None)
        return value if isinstance(value, tuple) else (value,)

    def draw(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Values of the given shape; whole numbers for delays."""
        first, last = self.values[0], self.values[-1]
        if self.constant is not None:
            return np.full(shape, first)
        if self.uniform is not None:
            drawn = generator.uniform(first, last, shape)
        elif self.loguniform is not None:
            drawn = np.exp(generator.uniform(log(first), log(last), shape))
        elif self.normal is not None:
            drawn = self.normal * generator.standard_normal(shape)
        else:
            drawn = generator.choice(np.array(self.values), shape)
        return np.round(drawn) if self.kind.unit == "control steps" else drawn

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without those that are not given."""
        plain = {n: v for n, v in asdict(self).items() if v is not None}
        if self.share == 1:
            del plain["share"]
        return {n: list(v) if isinstance(v, tuple) else v for n, v in plain.items()}


def _check_values(perturbation: Perturbation) -> None:
    kind, name = perturbation.kind, perturbation.quantity
    for value in perturbation.values:
        if not kind.least <= value <= kind.most:
            raise UserError(
                f"{name} must be from {kind.least:g} to {kind.most:g} [{kind.unit}], "
                f"not {shown(value)}"
            )
    ranges = perturbation.uniform or perturbation.loguniform
    if ranges is not None and (len(ranges) != 2 or ranges[0] > ranges[1]):
        raise UserError(
            f"{name} needs two values, the smaller first, not {shown(ranges)}"
        )
    if perturbation.loguniform is not None and min(perturbation.values) <= 0:
        raise UserError(f"{name} can be loguniform between positive values only")


Perturbations = tuple[Perturbation, ...]


def perturbations_of(values: Any) -> Perturbations:
    """Build perturbations from plain values, a list of mappings.

    Raises:
        UserError: a quantity, distribution or value does not exist or fit, or two
            entries are of the same quantity and drawn equally often.
    """
    if not isinstance(values, Sequence) or isinstance(values, str) or not values:
        raise UserError(f"perturbations must be a list, not {shown(values)}")
    built = tuple(build(Perturbation, value) for value in values)
    keys = [(each.quantity, each.per) for each in built]
    for key in keys:
        if keys.count(key) > 1:
            raise UserError(f"{key[0]} is perturbed twice per {key[1]}")
    return built
