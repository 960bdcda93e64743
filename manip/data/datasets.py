"""Data sets of recorded episodes, whatever their format."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

from manip.data.lerobot_layout import INFO
from manip.data.lerobot_reader import read_lerobot
from manip.data.lerobot_writer import write_lerobot
from manip.data.minari_files import DATA, read_minari, write_minari
from manip.data.robomimic_files import FILE, read_robomimic, write_robomimic
from manip.data.stored_episode import Recording, StoredEpisode
from manip.errors import UserError

Format = Literal["lerobot", "robomimic", "minari"]

Writer = Callable[[Path, Recording, Iterator[StoredEpisode]], Path]

WRITERS: dict[Format, Writer] = {
    "lerobot": write_lerobot,
    "robomimic": write_robomimic,
    "minari": write_minari,
}


def read_dataset(path: Path) -> tuple[Recording, list[StoredEpisode]]:
    """Read a robomimic file, or a folder of any of the formats.

    Returns:
        The recording, and its episodes; see `read_robomimic` for files of another
        origin.

    Raises:
        UserError: there is no data set, or it is damaged.
    """
    if path.is_file():
        return read_robomimic(path)
    if (path / FILE).is_file():
        return read_robomimic(path / FILE)
    if (path / INFO).is_file():
        return read_lerobot(path)
    if (path / DATA).is_file():
        return read_minari(path)
    raise UserError(
        f"{path} holds no data set: expected a robomimic file (.hdf5), a LeRobot "
        f"folder ({INFO}) or a Minari folder ({DATA})"
    )
