"""CameraConfig: cameras whose images are parts of an observation."""

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import Literal, get_args

from manip.errors import UserError, check_choice, shown
from manip.observation import ObservationPart

Quality = Literal["exact", "lean"]
"""exact: robosuite's own images, byte for byte. lean: cheaper to draw, for training;
see `manip.sim.scene_cameras`."""

SMALLEST, LARGEST = 8, 1024
"""Limits of the height and width of an image [pixels]."""
MOST_FRAMES = 16
"""Largest number of stacked images."""


@dataclass(frozen=True)
class CameraConfig:
    """Cameras whose images are parts of the observation.

    A part is uint8 [size, size, 3 * frames], RGB, bottom row first, as robosuite's
    camera observations are by default (macros.IMAGE_CONVENTION = "opengl").

    Args:
        names: cameras of the simulation, such as "agentview" and "robot0_eye_in_hand".
        size: height and width [pixels].
        quality: "exact" or "lean"; other libraries' environments draw exactly always.
        frames: number of latest images that are given, along the channels, oldest
            first (frame stack). An episode begins with copies of its first image.

    Raises:
        UserError: a name occurs twice, or a value is out of its range.
    """

    names: tuple[str, ...] = ()
    size: int = 64
    quality: Quality = "exact"
    frames: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", _checked_names(self.names))
        _check_range("the size of an image [pixels]", self.size, SMALLEST, LARGEST)
        _check_range("frames", self.frames, 1, MOST_FRAMES)
        check_choice("image quality", self.quality, get_args(Quality))

    @property
    def parts(self) -> tuple[ObservationPart, ...]:
        """One observation part per camera, named as robosuite's observations."""
        shape = (self.size, self.size, 3 * self.frames)
        return tuple(
            ObservationPart(part_name(name), shape, "uint8", "camera")
            for name in self.names
        )


def part_name(camera: str) -> str:
    """Name of the observation part that holds a camera's images."""
    return f"{camera}_image"


def check_cameras(cameras: object) -> CameraConfig:
    """The configuration; without cameras for None.

    Raises:
        UserError: it is neither.
    """
    if cameras is None:
        return CameraConfig()
    if not isinstance(cameras, CameraConfig):
        raise UserError(
            f"cameras must be a CameraConfig(names, size, ...), not {shown(cameras)}"
        )
    return cameras


def _checked_names(names: object) -> tuple[str, ...]:
    if not isinstance(names, Sequence) or isinstance(names, str):
        raise UserError(f"names of cameras must be a list, not {shown(names)}")
    for name in names:
        if not isinstance(name, str) or not name:
            raise UserError(f"the name of a camera must be text, not {shown(name)}")
    if len(set(names)) < len(names):
        raise UserError(f"a camera is named twice: {', '.join(names)}")
    return tuple(names)


def _check_range(name: str, value: object, least: int, most: int) -> None:
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if not whole or not least <= int(value) <= most:  # type: ignore[call-overload]
        raise UserError(
            f"{name} must be a whole number from {least} to {most}, not {shown(value)}"
        )
