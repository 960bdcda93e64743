"""Domain randomisation of training episodes: the files of assets/randomisations."""

from importlib.resources import files
from pathlib import Path

from manip.envs.perturbation import Perturbations, perturbations_of
from manip.errors import UserError, check_choice, one_line
from manip.io.yaml_files import read_yaml

SHIPPED = Path(str(files("manip.assets"))) / "randomisations"
"""Folder of the shipped lists."""


def randomisation_names() -> list[str]:
    """Names of the shipped lists of perturbations."""
    return sorted(path.stem for path in SHIPPED.glob("*.yaml"))


def load_randomisation(name: str) -> Perturbations:
    """The perturbations of a shipped list or a YAML file; none of the name "".

    Raises:
        UserError: there is no such list, or a value in it is impossible.
    """
    if not name:
        return ()
    path = Path(name)
    if not name.endswith((".yaml", ".yml")):
        check_choice("randomisation", name, randomisation_names())
        path = SHIPPED / f"{name}.yaml"
    if not path.is_file():
        raise UserError(f"there is no file {name}")
    try:
        return perturbations_of(read_yaml(path))
    except UserError as error:
        raise UserError(f"{name}: {one_line(error)}") from error
