"""Reader of octomaps: `.bt` and `.ot` files, and `octomap_msgs/msg/Octomap` messages.

A file begins with lines of text: `# Octomap OcTree ... file`, comments, `id TYPE`, `size NODES`, `res METRES` and
`data`; the nodes follow in depth-first order. The root is a cube of 2^16 voxels about the origin, and child i of a node
is on the positive side of x, y and z if bits 0, 1 and 2 of i are set.

- **Binary** (`.bt`): two bytes for each inner node, two bits for each child, the lowest first: 0 unknown, 1 a free
  leaf, 2 an occupied leaf, 3 an inner node.
- **Full** (`.ot`): for each node the log-odds of its occupancy as a little-endian float32, three bytes of colour for a
  `ColorOcTree`, and a byte with a bit for each child. A leaf is occupied if its log-odds are at least 0.

Source: OctoMap 1.10, `OcTreeBase.h`, `OcTreeBaseImpl.hxx`, `OcTreeDataNode.hxx`.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pinocchio as pin

from hplan.apps.ros.fields import fields_of, is_message
from hplan.apps.ros.moveit_scene import planning_frame, shape
from hplan.base.arguments import check_integer, file_path, text
from hplan.base.arrays import IntArray
from hplan.base.files import ByteBudget
from hplan.errors import SceneError
from hplan.scene.limits import MOST_OBSTACLES, MOST_SHAPE_BYTES, Vector
from hplan.scene.obstacles import Obstacle

#: Depth of the tree, and the sizes of a node's data by type of tree [bytes].
_DEPTH: Final = 16
_NODE_BYTES: Final = {"OcTree": 4, "ColorOcTree": 7}


def read_octomap(
    source: Any,
    *,
    name: str = "octomap",
    position: Vector = (0.0, 0.0, 0.0),
    rpy_deg: Vector = (0.0, 0.0, 0.0),
    depth: int = _DEPTH,
) -> tuple[Obstacle, ...]:
    """Read the occupied space of an octomap as boxes.

    Neighbouring voxels are joined into larger boxes. Unknown space counts as free.

    Args:
        source: A `.bt` or `.ot` file, or an `octomap_msgs/msg/Octomap` message, an object or a dict.
        name: The boxes are `NAME 1`, `NAME 2`, ...
        position: Origin of the map in `base_link` [m].
        rpy_deg: Orientation of the map: roll, pitch and yaw about fixed axes [deg].
        depth: Depth of the smallest voxels, at most 16; one less doubles their size, and every coarse voxel with an
            occupied part is occupied.

    Raises:
        SceneError: The file is missing or malformed, its tree has an unknown type, nothing is occupied, or there are
            too many boxes.
        OptionError: An option of the wrong type or range.

    Examples:
        >>> message = {"binary": True, "id": "OcTree", "resolution": 0.1, "data": [3, 0] * 15 + [2, 0]}
        >>> (box,) = read_octomap(message)
        >>> np.round([*box.center, *box.size], 6).tolist()
        [-3276.75, -3276.75, -3276.75, 0.1, 0.1, 0.1]
    """
    check_integer("depth", depth, 1, _DEPTH)
    text("name", name, "the prefix of the names")
    base = planning_frame(position, rpy_deg, name, "refuse")
    path = None if is_message(source) else file_path("source", source)
    kind, is_binary, edge_m, data = _fields(fields_of(source)) if path is None else _read_file(path)
    if kind not in _NODE_BYTES:
        raise SceneError(f"expected a tree of type {' or '.join(_NODE_BYTES)}, got {kind!r}", path=path)
    if not (np.isfinite(edge_m) and edge_m > 0.0):
        raise SceneError(f"expected a resolution in metres, got {edge_m!r}", path=path)
    try:
        cubes = np.array(list(_binary_leaves(data) if is_binary else _full_leaves(data, _NODE_BYTES[kind])), np.int64)
    except (IndexError, struct.error):
        raise SceneError("the data of the tree end too early", path=path) from None
    if not len(cubes):
        raise SceneError("nothing is occupied", path=path)
    boxes = _merge(_coarsen(cubes, 1 << (_DEPTH - depth)))
    if len(boxes) > MOST_OBSTACLES:
        advice = f"at most {MOST_OBSTACLES:,} can be used; `depth={depth - 1}` gives fewer"
        raise SceneError(f"the map has {len(boxes):,} boxes, {advice}", path=path)
    return tuple(_box(f"{name} {number}", box * edge_m, base) for number, box in enumerate(boxes, start=1))


def _box(name: str, corners_m: Any, base: pin.SE3) -> Obstacle:
    """Box between two (3,) corners in the frame of the map [m]."""
    low, high = corners_m[:3], corners_m[3:]
    return shape(name, "box", (high - low).tolist(), base * pin.SE3(np.eye(3), 0.5 * (low + high)))


def _fields(message: Mapping[str, Any]) -> tuple[str, bool, float, bytes]:
    """Type, whether binary, resolution [m] and data of a message."""
    data = message.get("data", b"")
    if isinstance(data, str):
        raise SceneError(f"expected numbers, got {data!r}: print the message with --full-length", where="data")
    try:
        content = bytes(data) if isinstance(data, bytes | bytearray) else np.asarray(data).astype(np.int8).tobytes()
        kind, is_binary, edge_m = (message[key] for key in ("id", "binary", "resolution"))
        return str(kind), bool(is_binary), float(edge_m), content
    except KeyError as error:
        raise SceneError("this key is missing", where=str(error.args[0])) from error
    except (TypeError, ValueError) as error:
        raise SceneError(f"it is not an octomap message: {error}") from error


def _read_file(path: Path) -> tuple[str, bool, float, bytes]:
    """Type, whether binary, resolution [m] and data of a file."""
    try:
        content = ByteBudget(MOST_SHAPE_BYTES).read(path)
    except OSError as error:
        raise SceneError(error.strerror or str(error), path=path) from error
    except ValueError as error:
        raise SceneError(str(error), path=path) from error
    head, mark, data = content.partition(b"\ndata\n")
    first, *lines = head.decode("latin-1").splitlines() or [""]
    kinds = {"# Octomap OcTree binary file": True, "# Octomap OcTree file": False}
    if first not in kinds or not mark:
        raise SceneError("it is not an octomap file: expected '# Octomap OcTree ... file' first, and data", path=path)
    values = dict(line.split(maxsplit=1) for line in lines if not line.startswith("#") and len(line.split()) > 1)
    try:
        return values["id"].strip(), kinds[first], float(values["res"]), data
    except (KeyError, ValueError) as error:
        raise SceneError(f"expected lines `id TYPE` and `res METRES` before the data: {error}", path=path) from error


def _children(x: int, y: int, z: int, edge: int) -> list[tuple[int, int, int, int]]:
    """Lower corners and edge of the eight children of a cube [voxels]."""
    half = edge >> 1
    if not half:
        raise IndexError
    return [(x + half * (i & 1), y + half * (i >> 1 & 1), z + half * (i >> 2), half) for i in range(8)]


#: The root: its lower corner and its edge [voxels].
_ROOT: Final = (*(-(1 << (_DEPTH - 1)),) * 3, 1 << _DEPTH)


def _binary_leaves(data: bytes) -> Iterator[tuple[int, int, int, int]]:
    """Occupied leaves of binary data: lower corners and edges [voxels]."""
    at, stack = 0, [_ROOT] if data else []
    while stack:
        children = _children(*stack.pop())
        kinds = data[at] | data[at + 1] << 8
        at += 2
        inner = []
        for number, child in enumerate(children):
            kind = kinds >> 2 * number & 3
            if kind == 2:
                yield child
            elif kind == 3:
                inner.append(child)
        stack += reversed(inner)


def _full_leaves(data: bytes, node_bytes: int) -> Iterator[tuple[int, int, int, int]]:
    """Occupied leaves of full data: lower corners and edges [voxels]."""
    at, stack = 0, [_ROOT] if data else []
    while stack:
        cube = stack.pop()
        log_odds, bits = struct.unpack_from("<f", data, at)[0], data[at + node_bytes]
        at += node_bytes + 1
        if bits:
            stack += [child for i, child in reversed([*enumerate(_children(*cube))]) if bits >> i & 1]
        elif log_odds >= 0.0:
            yield cube


def _coarsen(cubes: IntArray, edge: int) -> IntArray:
    """Boxes (n, 6) of the cubes, grown to voxels of an edge [finest voxels]."""
    low, high = cubes[:, :3] // edge * edge, -(-(cubes[:, :3] + cubes[:, 3:]) // edge) * edge
    found: IntArray = np.unique(np.hstack([low, high]), axis=0)
    return found


def _merge(boxes: IntArray) -> IntArray:
    """Join boxes that share a whole face, along x, then y, then z."""
    for axis in range(3):
        others = [column for column in range(6) if column % 3 != axis]
        boxes = boxes[np.lexsort((boxes[:, axis], *boxes[:, others].T))]
        joined = (boxes[1:, others] == boxes[:-1, others]).all(axis=1) & (boxes[1:, axis] == boxes[:-1, axis + 3])
        first = np.flatnonzero(np.append(True, ~joined))
        last = np.append(first[1:], len(boxes)) - 1
        merged = boxes[first].copy()
        merged[:, axis + 3] = boxes[last, axis + 3]
        boxes = merged
    return boxes
