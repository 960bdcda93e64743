"""Write animated 3-D scenes as binary glTF 2.0 (.glb), with small numbers.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html. Positions are 16-bit and
normals 8-bit integers (KHR_mesh_quantization), rotations of animations 16-bit.
"""

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray

_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
_VERTICES, _INDICES = 34962, 34963
_Z_UP = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
"""Rotation xyzw from axes with z up to glTF's, with y up."""

_STILL = 1e-5
"""Movements [m] and changes of quaternions below this are not animated."""


@dataclass(frozen=True)
class Surface:
    """Triangles of one material.

    Attributes:
        positions, normals: [V, 3] m; of unit length.
        colours: [V, 4] RGBA in 0-1, sRGB; those with alpha below 1 are drawn as
            transparent if that of the first vertex is.
        faces: [F, 3] int.
    """

    positions: Array
    normals: Array
    colours: Array
    faces: Array


@dataclass(frozen=True)
class Node:
    """A frame of the scene, in the frame of its parent (None: of the scene, z up)."""

    name: str
    parent: int | None
    surfaces: Sequence[Surface] = ()


@dataclass(frozen=True)
class Motion:
    """Poses of P nodes at T times: positions [T, P, 3] m, rotations [T, P, 4] wxyz."""

    times: Array
    positions: Array
    rotations: Array


def write_glb(nodes: Sequence[Node], motions: Mapping[str, Motion]) -> bytes:
    """A scene whose nodes follow the motions, each an animation of its name.

    A frame that does not change within and between the motions is no part of them.

    Args:
        nodes: the P nodes; parents come before their children.
        motions: at least one; the first pose of the first is shown at rest.
    """
    return _File(nodes, motions).encode()


class _File:
    """Collects the binary part and its description."""

    def __init__(self, nodes: Sequence[Node], motions: Mapping[str, Motion]) -> None:
        self._binary = bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        first = next(iter(motions.values()))
        self._nodes = [_rest(node, first, i) for i, node in enumerate(nodes)]
        for index, node in enumerate(nodes):
            if node.parent is not None:
                self._child(node.parent, index)
            if node.surfaces:
                self._add_surfaces(index, node.surfaces)
        moving = _moving(list(motions.values()))
        self._animations = [self._animation(*item, *moving) for item in motions.items()]
        self._roots = [i for i, node in enumerate(nodes) if node.parent is None]

    def encode(self) -> bytes:
        root = {"name": "scene", "rotation": _Z_UP, "children": self._roots}
        tree = {
            "asset": {"version": "2.0", "generator": "manip"},
            "extensionsUsed": ["KHR_mesh_quantization"],
            "extensionsRequired": ["KHR_mesh_quantization"],
            "scene": 0,
            "scenes": [{"nodes": [len(self._nodes)]}],
            "nodes": [*self._nodes, root],
            "meshes": self._meshes,
            "materials": [_material("opaque"), _material("transparent", "BLEND")],
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._binary)}],
            "animations": self._animations,
        }
        text = json.dumps(tree, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        total = 12 + 8 + len(text) + 8 + len(self._binary)
        return b"".join(
            [
                struct.pack("<4sII", b"glTF", 2, total),
                struct.pack("<I4s", len(text), b"JSON"),
                text,
                struct.pack("<I4s", len(self._binary), b"BIN\0"),
                self._binary,
            ]
        )

    def _child(self, parent: int, index: int) -> None:
        self._nodes[parent].setdefault("children", []).append(index)

    def _add_surfaces(self, index: int, surfaces: Sequence[Surface]) -> None:
        """Add a node that scales the integers of its surfaces to metres."""
        points = np.concatenate([surface.positions for surface in surfaces])
        centre = (points.min(0) + points.max(0)) / 2
        scale = float(np.abs(points - centre).max()) or 1.0
        meshes = [self._primitive(surface, centre, scale) for surface in surfaces]
        child = {
            "mesh": len(self._meshes),
            "translation": centre.tolist(),
            "scale": [scale] * 3,
        }
        self._meshes.append({"primitives": meshes})
        self._child(index, len(self._nodes))
        self._nodes.append(child)

    def _primitive(self, part: Surface, centre: Array, scale: float) -> dict[str, Any]:
        positions = np.round((part.positions - centre) / scale * 32767)
        bounds = {"min": positions.min(0), "max": positions.max(0)}
        attributes = {
            "POSITION": self._vertices(positions, "i2", bounds),
            "NORMAL": self._vertices(np.round(part.normals * 127), "i1"),
            "COLOR_0": self._vertices(np.round(_linear(part.colours) * 255), "u1"),
        }
        wide = "u4" if len(part.positions) > 65535 else "u2"
        indices = self._add(part.faces.reshape(-1, 1), wide, target=_INDICES)
        material = int(part.colours[0, 3] < 1)
        return {"attributes": attributes, "indices": indices, "material": material}

    def _vertices(
        self, values: Array, kind: str, bounds: Mapping[str, Array] | None = None
    ) -> int:
        """Add values of vertices as fractions of the integer type's largest value."""
        width = 4 // np.dtype(kind).itemsize * (2 if kind == "i2" else 1)
        padded = np.zeros((len(values), width))
        padded[:, : values.shape[1]] = values
        more = {name: list(map(int, bound)) for name, bound in (bounds or {}).items()}
        return self._add(
            padded, kind, values.shape[1], target=_VERTICES, normalized=True, **more
        )

    def _add(
        self,
        values: Array,
        kind: str,
        width: int | None = None,
        target: int | None = None,
        **more: Any,
    ) -> int:
        """Add rows of numbers to the binary part; returns the accessor's number."""
        data = np.ascontiguousarray(values, np.dtype(f"<{kind}"))
        view = {
            "buffer": 0,
            "byteOffset": len(self._binary),
            "byteLength": data.nbytes,
        }
        if target:
            view["target"] = target
        if target == _VERTICES:
            view["byteStride"] = data.strides[0]
        self._binary += data.tobytes() + b"\0" * (-data.nbytes % 4)
        self._views.append(view)
        accessor = {
            "bufferView": len(self._views) - 1,
            "componentType": _COMPONENTS[kind],
            "count": len(data),
            "type": _TYPES[width or data.shape[1]],
        }
        self._accessors.append(accessor | more)
        return len(self._accessors) - 1

    def _animation(
        self, name: str, motion: Motion, shifted: Array, turned: Array
    ) -> dict[str, Any]:
        times = motion.times.reshape(-1, 1)
        clock = self._add(times, "f4", min=times[0].tolist(), max=times[-1].tolist())
        tracks = [
            (node, "translation", self._add(motion.positions[:, node], "f4"))
            for node in shifted
        ]
        for node in turned:
            values = np.round(_continuous(motion.rotations[:, node]) * 32767)
            output = self._add(values[:, [1, 2, 3, 0]], "i2", normalized=True)
            tracks.append((node, "rotation", output))
        samplers = [{"input": clock, "output": output} for *_, output in tracks]
        channels = [
            {"sampler": i, "target": {"node": int(node), "path": path}}
            for i, (node, path, _) in enumerate(tracks)
        ]
        return {"name": name, "samplers": samplers, "channels": channels}


def _rest(node: Node, motion: Motion, index: int) -> dict[str, Any]:
    w, x, y, z = map(float, motion.rotations[0, index])
    translation = list(map(float, motion.positions[0, index]))
    return {"name": node.name, "translation": translation, "rotation": [x, y, z, w]}


def _moving(motions: Sequence[Motion]) -> tuple[Array, Array]:
    """Numbers of the nodes whose position, and whose rotation, changes."""
    moving = []
    for name in ("positions", "rotations"):
        rest = getattr(motions[0], name)[0]
        far = [np.abs(getattr(m, name) - rest).max(axis=(0, 2)) for m in motions]
        moving.append(np.flatnonzero(np.max(far, axis=0) > _STILL))
    return moving[0], moving[1]


def _continuous(rotations: Array) -> Array:
    """The same rotations [T, 4], none in the other half sphere than the one before."""
    near = (rotations[1:] * rotations[:-1]).sum(1) < 0
    flips = np.cumprod(np.where(near, -1.0, 1.0))
    return np.concatenate([rotations[:1], rotations[1:] * flips[:, None]])


def _linear(colours: Array) -> Array:
    """Colours [V, 4] from sRGB to linear light; alpha as it is."""
    rgb = np.clip(colours[:, :3], 0, 1)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.concatenate([linear, np.clip(colours[:, 3:], 0, 1)], axis=1)


def _material(name: str, mode: str = "OPAQUE") -> dict[str, Any]:
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.6}
    return {"name": name, "pbrMetallicRoughness": surface, "alphaMode": mode}
