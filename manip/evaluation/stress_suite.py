"""Suites of perturbations at some strengths: the files of assets/perturbations."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal

from manip.envs.perturbation import Perturbation
from manip.errors import UserError, check_choice, one_line, shown
from manip.io.dataclass_values import build
from manip.io.yaml_files import read_yaml
from manip.looks import GROUPS, Looks

SUITES = Path(str(files("manip.assets"))) / "perturbations"
"""Folder of the shipped suites."""


@dataclass(frozen=True)
class Stress:
    """A perturbation at some strengths.

    Attributes:
        levels: values from the weakest to the strongest.
        quantity: see `manip.envs.perturbation`; empty where looks change.
        looks: what changes in images, one of `manip.looks.GROUPS`; a level is the
            strength of random changes, from 0 to 1.
        spread: constant, a level is the value; normal, its standard deviation.
        per: how often a normal value is drawn.
    """

    levels: tuple[float, ...]
    quantity: str = ""
    looks: str = ""
    spread: Literal["constant", "normal"] = "constant"
    per: Literal["episode", "step"] = "episode"

    def __post_init__(self) -> None:
        if not self.levels:
            raise UserError("levels must be one number or more")
        if bool(self.quantity) == bool(self.looks):
            raise UserError("name either a quantity or looks")
        for level in self.levels:
            if self.looks:
                self.look(level)
            else:
                self.perturbation(level)

    @property
    def subject(self) -> str:
        """The quantity, or what changes in images."""
        return self.quantity or self.looks

    @property
    def unit(self) -> str:
        """Unit of the levels."""
        level = self.levels[0]
        return "strength" if self.looks else self.perturbation(level).kind.unit

    def perturbation(self, level: float) -> Perturbation:
        """The perturbation of a level."""
        given: dict[str, Any] = {self.spread: float(level)}
        return Perturbation(self.quantity, per=self.per, **given)

    def look(self, level: float) -> Looks:
        """The looks of a level."""
        check_choice("looks", self.looks, GROUPS)
        if not 0 < level <= 1:
            raise UserError(f"levels of looks must be from 0 to 1, not {shown(level)}")
        return Looks((self.looks,), float(level))


def suite_names() -> list[str]:
    """Names of the shipped suites."""
    return sorted(path.stem for path in SUITES.glob("*.yaml"))


def load_suite(name: str) -> dict[str, Stress]:
    """The suite of a shipped name, or of a YAML file of one's own: name -> stress.

    Raises:
        UserError: there is no such suite, or a value in it is impossible.
    """
    path = Path(name)
    if not name.endswith((".yaml", ".yml")):
        check_choice("suite", name, suite_names())
        path = SUITES / f"{name}.yaml"
    if not path.is_file():
        raise UserError(f"there is no file {name}")
    values = read_yaml(path)
    if not isinstance(values, dict) or not values:
        raise UserError(f"{name} must map names to perturbations")
    return {str(key): _stress(f"{name}: {key}", value) for key, value in values.items()}


def _stress(where: str, value: Any) -> Stress:
    try:
        return build(Stress, value)
    except UserError as error:
        raise UserError(f"{where}: {one_line(error)}") from error
