"""Videos of a LeRobot data set: the images of many episodes in one file."""

import io
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from manip.data.extra_libraries import library
from manip.data.lerobot_layout import SIZES, VIDEO, file_path
from manip.errors import UserError
from manip.io.atomic_files import replace_file

Array = np.ndarray

CODEC, PIXELS = "h264", "yuv420p"
OPTIONS = {"crf": "18", "g": "2"}
"""Quality (lower is better), and images from one key frame to the next."""


class VideoFiles:
    """Encode the images of one camera; a new file begins once one is full.

    Args:
        folder: of the data set.
        key: the camera's feature.
        fps: images a second.
    """

    def __init__(self, folder: Path, key: str, fps: int) -> None:
        self._av = library("av")
        self._folder, self._key, self._fps = folder, key, fps
        self._file, self._count, self._path = -1, 0, ""
        self._container: Any = None
        self._stream: Any = None
        self._buffer = io.BytesIO()
        self.info: dict[str, Any] = {}

    def add(self, images: Array) -> dict[str, Any]:
        """Append the images [T, H, W, 3] of an episode; return where they lie.

        Raises:
            UserError: their height or width is odd.
        """
        if self._container is None:
            self._open(*images.shape[1:3])
        first = self._count
        for pixels in images:
            frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels))
            frame.pts, self._count = self._count, self._count + 1
            frame.time_base = Fraction(1, self._fps)
            self._container.mux(self._stream.encode(frame))
        place = {
            "chunk_index": int(self._path.split("chunk-")[1][:3]),
            "file_index": int(self._path.split("file-")[1][:3]),
            "from_timestamp": first / self._fps,
            "to_timestamp": self._count / self._fps,
        }
        if self._buffer.tell() >= SIZES["video_files_size_in_mb"] << 20:
            self.close()
        return {f"videos/{self._key}/{name}": value for name, value in place.items()}

    def close(self) -> None:
        """Write the file that is under way, if any."""
        if self._container is None:
            return
        self._container.mux(self._stream.encode(None))
        self._container.close()
        data = self._buffer.getvalue()
        path = self._folder / self._path
        replace_file(path, lambda temporary: temporary.write_bytes(data))
        self._container = None

    def _open(self, height: int, width: int) -> None:
        if height % 2 or width % 2:
            raise UserError(
                f"--image-size {height} is odd: videos need an even number of pixels"
            )
        self._file += 1
        self._path, self._count = file_path(VIDEO, self._file, key=self._key), 0
        self._buffer = io.BytesIO()
        self._container = self._av.open(self._buffer, "w", format="mp4")
        stream = self._container.add_stream(CODEC, rate=self._fps, options=OPTIONS)
        stream.width, stream.height, stream.pix_fmt = width, height, PIXELS
        self._stream = stream
        self.info = {
            "video.height": height,
            "video.width": width,
            "video.codec": CODEC,
            "video.pix_fmt": PIXELS,
            "video.is_depth_map": False,
            "video.fps": self._fps,
            "video.channels": 3,
            "has_audio": False,
        }


def read_images(path: Path, first: int, count: int, shape: tuple[int, ...]) -> Array:
    """Decode `count` images [H, W, 3] of a file, from number `first` on.

    Raises:
        UserError: there are fewer, or they are of another size.
    """
    av = library("av")
    images = np.zeros((count, *shape), np.uint8)
    index = -first
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if index >= count:
                break
            if (frame.height, frame.width) != shape[:2]:
                raise UserError(f"its images are {frame.height} x {frame.width} pixels")
            if index >= 0:
                images[index] = frame.to_ndarray(format="rgb24")
            index += 1
    if index < count:
        raise UserError(f"{path} holds {index + first} images, fewer than {count}")
    return images
