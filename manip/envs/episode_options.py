"""Options of the episodes of a batch, checked when it is built."""

from collections.abc import Mapping
from dataclasses import dataclass

from manip.cameras import CameraConfig, check_cameras
from manip.envs.episode_streams import TRAINING, Purpose, check_purpose, check_seed
from manip.envs.option_checks import check_flag
from manip.envs.perturbation import Perturbation, Perturbations
from manip.errors import UserError, at_least, shown
from manip.looks import Looks, check_looks


@dataclass(frozen=True)
class EpisodeOptions:
    """Options of the episodes, which every backend takes.

    Args:
        horizon: episode length [control steps]; the task's own by default.
        reward: reward set that is paid, "shaped" or "stock".
        reward_weights: weights that replace those of the set, term -> weight.
        seed: episode e of environment i depends on (seed, purpose, i, e) only.
        purpose: see `manip.envs.episode_streams.Purpose`.
        first_env: number of the first environment in the random streams; batches that
            share a seed have different episodes.
        cameras: cameras whose images are parts of the observation; None for none.
        looks: strength, from 0 to 1, of the random changes of each episode's look, or
            the name of a suite of fixed looks (see `manip.looks`); native backend only.
        perturbations: what differs from the nominal task, and how it is drawn for each
            episode or step (see `manip.envs.perturbation`).
        motion: whether `TaskBatch.motion` can be called; no effect but with the
            native backend.

    Raises:
        UserError: an option is out of its range.
    """

    horizon: int | None = None
    reward: str = "shaped"
    reward_weights: Mapping[str, float] | None = None
    seed: int = 0
    purpose: Purpose = TRAINING
    first_env: int = 0
    cameras: CameraConfig | None = None
    looks: float | str | Looks = 0.0
    perturbations: Perturbations = ()
    motion: bool = False

    def __post_init__(self) -> None:
        at_least(1, "horizon", 1 if self.horizon is None else self.horizon)
        at_least(0, "first_env", self.first_env)
        check_seed(self.seed)
        check_purpose(self.purpose)
        check_cameras(self.cameras)
        check_flag("motion", self.motion)
        for each in self.perturbations:
            if not isinstance(each, Perturbation):
                raise UserError(
                    f"perturbations must be Perturbation(...) each, not {shown(each)}"
                )
        if check_looks(self.looks).groups and not check_cameras(self.cameras).names:
            raise UserError("looks change images only: name cameras, too")

    def refuse_perturbations(self, library: str) -> None:
        """Raise `UserError` if something is perturbed that another library steps."""
        if self.perturbations:
            raise UserError(f"tasks of {library} cannot be perturbed: choose another")

    def refuse_looks(self, library: str) -> None:
        """Raise `UserError` if looks vary, which another library does not draw."""
        if check_looks(self.looks).groups:
            raise UserError(
                f"{library} draws its own look: choose the native backend for looks "
                f"{shown(self.looks)}"
            )
