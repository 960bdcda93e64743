"""Read binary glTF back, as a viewer would: nodes, meshes and animations."""

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray

TYPES = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}


@dataclass
class Glb:
    """A file's description and its binary part."""

    tree: dict[str, Any]
    binary: bytes

    @classmethod
    def parse(cls, data: bytes) -> "Glb":
        magic, version, total = struct.unpack_from("<4sII", data)
        assert (magic, version, total) == (b"glTF", 2, len(data))
        length, kind = struct.unpack_from("<I4s", data, 12)
        assert kind == b"JSON"
        start = 20 + length
        size, kind = struct.unpack_from("<I4s", data, start)
        assert kind == b"BIN\0"
        assert start + 8 + size == len(data)
        return cls(json.loads(data[20:start]), data[start + 8 :])

    def array(self, number: int) -> Array:
        """[count, width] of an accessor; normalised integers as fractions."""
        accessor = self.tree["accessors"][number]
        view = self.tree["bufferViews"][accessor["bufferView"]]
        dtype = np.dtype("<" + TYPES[accessor["componentType"]])
        width = WIDTHS[accessor["type"]]
        stride = view.get("byteStride", width * dtype.itemsize)
        part = self.binary[view["byteOffset"] :][: view["byteLength"]]
        rows = np.frombuffer(part, np.uint8).reshape(accessor["count"], stride)
        raw = np.ascontiguousarray(rows[:, : width * dtype.itemsize]).view(dtype)
        values = raw.astype(float)
        if accessor.get("normalized"):
            values = np.maximum(values / np.iinfo(dtype).max, -1)
        return values

    def poses(self, animation: str, step: int) -> dict[str, Array]:
        """Name of each node -> its pose [4, 4] in z-up axes, at a step."""
        nodes = [dict(node) for node in self.tree["nodes"]]
        moved = next(a for a in self.tree["animations"] if a["name"] == animation)
        for channel in moved["channels"]:
            target, sampler = channel["target"], moved["samplers"][channel["sampler"]]
            nodes[target["node"]][target["path"]] = self.array(sampler["output"])[step]
        poses: dict[str, Array] = {}
        (root,) = self.tree["scenes"][0]["nodes"]
        up = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
        self._place(nodes, root, up, poses)
        return poses

    def _place(self, nodes: list, index: int, parent: Array, poses: dict) -> None:
        node = nodes[index]
        pose = parent @ _matrix(node)
        if "name" in node:
            poses[node["name"]] = pose
        for child in node.get("children", ()):
            self._place(nodes, child, pose, poses)


def _matrix(node: dict[str, Any]) -> Array:
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1.0)))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, :3] *= node.get("scale", (1, 1, 1))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
