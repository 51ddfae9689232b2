"""Bodies, materials and lights in three.js's JSON format for meshcat's viewer.

They are plain dictionaries for three reasons: meshcat's own classes give every object a random identifier, so that a
page would differ from run to run; they lack half-spheres, shadows and stencils; and their import takes 0.2 s.

Lengths are in metres, colours are `0xrrggbb`, placements 4x4 matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from hplan.base.arrays import FloatArray, IntArray

Json: TypeAlias = dict[str, Any]

#: Meshes are not simplified to fewer triangles.
_FEWEST_TRIANGLES = 12

#: Number of halvings of the interval in which the size of the cells lies.
_BISECTIONS = 12

#: Number of segments around a round body.
_SEGMENTS = 48


def transform(rotation: ArrayLike | None = None, position: ArrayLike | None = None) -> FloatArray:
    """(4, 4) matrix of a (3, 3) rotation and (3,) position [m].

    None gives the identity rotation, or the origin.
    """
    matrix = np.eye(4)
    if rotation is not None:
        matrix[:3, :3] = rotation
    if position is not None:
        matrix[:3, 3] = position
    return matrix


def flatten_numbers(values: ArrayLike) -> list[float]:
    """Flatten values to a list, rounded to 1e-6.

    Rounding to a micrometre keeps the page small and identical on every run.
    """
    flat: list[float] = (np.round(np.ravel(np.asarray(values, dtype=np.float64)), 6) + 0.0).tolist()
    return flat


def color_of(rgb: Sequence[float] | NDArray[np.float64]) -> int:
    """Colour 0xrrggbb of red, green and blue in [0, 1].

    Examples:
        >>> hex(color_of((1.0, 0.5, 0.0)))
        '0xff8000'
    """
    red, green, blue = (round(255.0 * min(max(float(value), 0.0), 1.0)) for value in rgb[:3])
    return (red << 16) | (green << 8) | blue


def rgb(color: int) -> FloatArray:
    """(3,) red, green and blue in [0, 1] of a colour 0xrrggbb."""
    return np.array([(color >> shift & 0xFF) / 255.0 for shift in (16, 8, 0)])


def material(color: int, *, opacity: float = 1.0, kind: str = "MeshStandardMaterial", **properties: Any) -> Json:
    """Create a material.

    Args:
        color: Colour, 0xrrggbb.
        opacity: Opacity in [0, 1].
        kind: Class of the material in three.js.
        properties: Further properties of that class, by their names in three.js.
    """
    see_through = {"transparent": True, "opacity": round(opacity, 3)} if opacity < 1.0 else {}
    gloss = {"roughness": 0.55, "metalness": 0.05} if kind == "MeshStandardMaterial" else {}
    return {"type": kind, "color": color, **gloss, **see_through, **properties}


def dots_material(color: int, size: float) -> Json:
    """Create a material of dots whose apparent size decreases with distance.

    Args:
        color: Colour, 0xrrggbb.
        size: Diameter of a dot [m], for a field of view of 90 degrees.
    """
    return {"type": "PointsMaterial", "color": color, "size": round(size, 6), "sizeAttenuation": True}


def ghost_material(color: int, opacity: float, layer: int) -> Json:
    """Create a translucent material that covers each pixel only once.

    Bodies with the same `layer` do not add up where they overlap in the image.
    """
    # Constants of three.js and WebGL.
    not_equal, replace = 517, 7681
    return material(
        color,
        opacity=opacity,
        kind="MeshLambertMaterial",
        depthWrite=False,
        # Offset the ghost in depth, so that an arm at the same pose does not flicker.
        polygonOffset=True,
        polygonOffsetFactor=1,
        polygonOffsetUnits=8,
        stencilWrite=True,
        stencilRef=layer,
        stencilFunc=not_equal,
        stencilZPass=replace,
    )


class Body:
    """Builder of a viewer object: meshes that share geometries and materials."""

    def __init__(self) -> None:
        self._geometries: list[Json] = []
        self._materials: list[Json] = []
        self._meshes: list[Json] = []

    def __len__(self) -> int:
        return len(self._meshes)

    def add(
        self,
        geometry: Mapping[str, Any],
        surface: Mapping[str, Any],
        placement: FloatArray | None = None,
        *,
        name: str = "",
        kind: str = "Mesh",
        shadow: bool = True,
        order: int = 0,
    ) -> None:
        """Add a mesh.

        Args:
            geometry: Geometry of the mesh, for example `box`.
            surface: Its material.
            placement: (4, 4) pose in the node's frame; None for the identity.
            name: Name of the mesh.
            kind: `Mesh`, `LineSegments`, `Points`, or, set by `add_copies`, `InstancedMesh`.
            shadow: Cast a shadow.
            order: Rendering order of translucent meshes; smaller values are drawn first.
        """
        mesh: Json = {
            "uuid": f"m{len(self._meshes)}",
            "type": kind,
            "name": name,
            "geometry": self._index(self._geometries, geometry, "g"),
            "material": self._index(self._materials, surface, "s"),
            "castShadow": shadow,
            "receiveShadow": True,
            "renderOrder": order,
        }
        if placement is not None:
            mesh["matrix"] = flatten_numbers(placement.T)
        self._meshes.append(mesh)

    def add_copies(
        self, geometry: Mapping[str, Any], surface: Mapping[str, Any], placements: FloatArray, *, name: str = ""
    ) -> None:
        """Add n instances of one shape, drawn in a single call.

        Args:
            geometry: Geometry of the shape.
            surface: Its material.
            placements: (n, 4, 4) transforms in the node's frame; they may scale the shape.
            name: Name of the mesh.
        """
        self.add(geometry, surface, name=name, kind="InstancedMesh")
        columns_first = np.swapaxes(placements, 1, 2)
        # Frustum culling would test the bounds of the shape itself, not of its instances.
        self._meshes[-1] |= {
            "count": len(placements),
            "instanceMatrix": {"array": flatten_numbers(columns_first)},
            "frustumCulled": False,
        }

    def json(self) -> Json:
        """Return the object in the format of three.js's loader."""
        return {
            "metadata": {"version": 4.5, "type": "Object"},
            "geometries": self._geometries,
            "materials": self._materials,
            "object": {"uuid": "root", "type": "Group", "children": self._meshes},
        }

    @staticmethod
    def _index(table: list[Json], item: Mapping[str, Any], prefix: str) -> str:
        for known in table:
            if {key: value for key, value in known.items() if key != "uuid"} == item:
                return str(known["uuid"])
        table.append({"uuid": f"{prefix}{len(table)}", **item})
        return str(table[-1]["uuid"])


#: Transform from three.js's cylinders and hemispheres, whose axis is y, to hplan's, whose axis is z.
Z_UP = transform(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))


def box(size: Sequence[float] | NDArray[np.float64]) -> Json:
    """Box with full edge lengths `size` [m]."""
    width, height, depth = flatten_numbers(np.asarray(size))
    return {"type": "BoxGeometry", "width": width, "height": height, "depth": depth}


def sphere(radius: float) -> Json:
    """Sphere of a radius [m]."""
    return {
        "type": "SphereGeometry",
        "radius": round(radius, 6),
        "widthSegments": _SEGMENTS,
        "heightSegments": _SEGMENTS // 2,
    }


def cylinder(radius: float, length: float, *, open_ended: bool = False) -> Json:
    """Cylinder of a radius and length [m] about the y axis."""
    return {
        "type": "CylinderGeometry",
        "radiusTop": round(radius, 6),
        "radiusBottom": round(radius, 6),
        "height": round(length, 6),
        "radialSegments": _SEGMENTS,
        "openEnded": open_ended,
    }


def facets(vertices: ArrayLike, faces: ArrayLike) -> Json:
    """Triangle mesh with flat shading: (n, 3) vertices [m], (m, 3) indices."""
    corners = np.asarray(vertices, dtype=np.float64)[np.asarray(faces, dtype=np.int64)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    return _buffers(np.arange(3 * len(corners)), position=corners, normal=np.repeat(normals, 3, axis=0))


def simplify_mesh(vertices: FloatArray, faces: IntArray, share: float) -> tuple[FloatArray, IntArray]:
    """Return a mesh with at most a share of the triangles, or 12, by vertex clustering.

    Vertices in a cell of a cubic grid become one, at their mean (Rossignac and Borrel 1993). The cells are the smallest
    ones that leave few enough triangles. Edge collapses would need manifolds, and few meshes of vendors are.

    Args:
        vertices: (n, 3) vertices [m].
        faces: (m, 3) vertex indices.
        share: Fraction of the triangles to keep; 1 returns the mesh itself.
    """
    most = max(_FEWEST_TRIANGLES, round(share * len(faces)))
    if len(faces) <= most:
        return vertices, faces
    low, high = 0.0, float(np.ptp(vertices, axis=0).max())
    offset, found = vertices - vertices.min(axis=0), (vertices, faces)
    for _ in range(_BISECTIONS):
        cell = 0.5 * (low + high)
        x, y, z = np.floor(offset / cell).astype(np.int64).T
        width = int(1 + max(x.max(), y.max(), z.max()))
        cell_of = np.unique((x * width + y) * width + z, return_inverse=True)[1].ravel()
        merged = cell_of[faces]
        a, b, c = np.sort(merged, axis=1).T
        count = int(cell_of.max()) + 1
        kept = np.flatnonzero((a < b) & (b < c))
        merged = merged[kept[np.unique((a[kept] * count + b[kept]) * count + c[kept], return_index=True)[1]]]
        if len(merged) > most:
            low = cell
            continue
        high = cell
        means = np.stack([np.bincount(cell_of, axis) for axis in vertices.T], axis=1)
        found = means / np.bincount(cell_of)[:, None], merged
    return found


def surface(vertices: FloatArray, faces: IntArray) -> Json:
    """Quadrilateral mesh with smooth shading.

    Args:
        vertices: (n, 3) vertices [m].
        faces: (m, 4) vertex indices, counter-clockwise as seen from outside.
    """
    corners = vertices[faces]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normals = np.zeros_like(vertices)
    for corner in range(4):
        np.add.at(normals, faces[:, corner], normal)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-30
    triangles = np.stack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]], axis=1)
    return _buffers(triangles, position=np.round(vertices, 4), normal=np.round(normals, 2))


def label(text: str, height: float) -> Json:
    """Text object that always faces the camera.

    Args:
        text: The text.
        height: Approximate height of its letters [m].
    """
    size = min(60, 420 // max(len(text), 1))  # the text must fit a square of 256 px
    texture = {"uuid": "text", "type": "_text", "text": text, "font_size": size, "font_face": "sans-serif"}
    look = {"uuid": "look", "type": "SpriteMaterial", "map": "text", "transparent": True, "depthWrite": False}
    side = round(height * 256.0 / (0.75 * size), 6)  # letters of 60 px are 45 px tall
    return {
        "metadata": {"version": 4.5, "type": "Object"},
        "textures": [texture],
        "materials": [{**look, "color": 0xFFFFFF}],
        "object": {
            "uuid": "label",
            "type": "Sprite",
            "material": "look",
            "matrix": flatten_numbers(np.diag([side, side, 1.0, 1.0])),
            "renderOrder": 4,
        },
    }


def points(places: FloatArray) -> Json:
    """Points at (n, 3) positions [m]."""
    return _buffers(np.arange(len(places)), position=places)


def line_segments(points: FloatArray, pairs: IntArray, colors: FloatArray) -> Json:
    """Line segments: (n, 3) points [m], (m, 2) indices, (n, 4) colours.

    Colours are red, green, blue and opacity in [0, 1].
    """
    return _buffers(pairs, position=points, color=np.round(colors, 3))


def _buffers(index: ArrayLike, **attributes: FloatArray) -> Json:
    return {
        "type": "BufferGeometry",
        "data": {
            "attributes": {
                name: {
                    "itemSize": values.shape[-1],
                    "type": "Float32Array",
                    "array": flatten_numbers(values),
                    "normalized": False,
                }
                for name, values in attributes.items()
            },
            "index": {"type": "Uint32Array", "array": np.ravel(np.asarray(index, dtype=np.int64)).tolist()},
        },
    }


def add_capsules(
    body: Body, starts: FloatArray, ends: FloatArray, radii: FloatArray, surface: Mapping[str, Any], *, name: str = ""
) -> None:
    """Add capsules as open cylinders with half-spheres.

    Inner walls, which would be visible through translucent surfaces, are omitted.

    Args:
        body: The object to add to.
        starts: (n, 3) first end of each axis [m].
        ends: (n, 3) second end of each axis [m].
        radii: (n,) radii [m].
        surface: Material of the capsules.
        name: Name of the meshes.
    """
    walls, caps = [], []
    segments = 20  # around the axis, fewer than `_SEGMENTS` because there may be hundreds of capsules
    for start, end, radius in zip(starts, ends, radii, strict=True):
        length = float(np.linalg.norm(end - start))
        turn = _turn_y_to((end - start) / length) if length > 0.0 else np.eye(3)
        if length > 0.0:
            walls.append(transform(turn * [radius, length, radius], 0.5 * (start + end)))
        caps += [transform(turn * radius, end), transform(turn * [radius, -radius, -radius], start)]
    if walls:
        wall = {**cylinder(1.0, 1.0, open_ended=True), "radialSegments": segments}
        body.add_copies(wall, surface, np.array(walls), name=name)
    half = {"widthSegments": segments, "heightSegments": segments // 4}
    cap = {**sphere(1.0), **half, "thetaStart": 0.0, "thetaLength": round(0.5 * np.pi, 9)}
    body.add_copies(cap, surface, np.array(caps), name=f"{name} ends")


def _turn_y_to(direction: FloatArray) -> FloatArray:
    """(3, 3) rotation that maps the y axis to a unit vector."""
    across = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(direction, across)
    x /= np.linalg.norm(x)
    return np.column_stack([x, direction, np.cross(x, direction)])


def tube(points: FloatArray, radius: float, colors: FloatArray, *, sides: int = 10) -> Json:
    """Tube of circular cross-section along a curve.

    Args:
        points: (n, 3) points, n >= 2; consecutive points differ [m].
        radius: Radius [m].
        colors: (n, 3) colours along the curve, red, green and blue in [0, 1].
        sides: Number of corners of the cross-section.
    """
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True) + 1e-12
    # Transport the normal from ring to ring, so that the tube does not twist.
    normal = np.cross(tangents[0], np.eye(3)[int(np.argmin(np.abs(tangents[0])))])
    normals = np.empty((len(points), sides, 3))
    angles = 2.0 * np.pi * np.arange(sides) / sides
    for k, tangent in enumerate(tangents):
        normal = normal - tangent * (normal @ tangent)
        normal /= np.linalg.norm(normal) + 1e-12
        other = np.cross(tangent, normal)
        normals[k] = np.cos(angles)[:, None] * normal + np.sin(angles)[:, None] * other
    ring, side = np.meshgrid(np.arange(len(points) - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    c, d = a + sides, b + sides
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)], axis=2)
    return _buffers(
        faces,
        position=points[:, None] + radius * normals,
        normal=np.round(normals, 3),
        color=np.repeat(np.round(colors, 3), sides, axis=0),
    )


def add_shape(
    body: Body,
    shape: coal.CollisionGeometry,
    surface: Mapping[str, Any],
    placement: FloatArray,
    share: float = 1.0,
    **settings: Any,
) -> None:
    """Add a shape of Pinocchio's geometry models, as read from a URDF.

    Args:
        body: The object to add to.
        shape: Box, sphere, cylinder, capsule or mesh; other shapes are ignored.
        surface: Material of the shape.
        placement: (4, 4) pose in the node's frame.
        share: Fraction of a mesh's triangles to keep.
        settings: Keyword arguments of `Body.add`.
    """

    def add(geometry: Json, local: FloatArray | None = None) -> None:
        pose = placement if local is None else placement @ local
        body.add(geometry, surface, pose, **settings)

    if isinstance(shape, coal.Box):
        add(box(2.0 * shape.halfSide))
    elif isinstance(shape, coal.Sphere):
        add(sphere(shape.radius))
    elif isinstance(shape, coal.Cylinder):
        add(cylinder(shape.radius, 2.0 * shape.halfLength), Z_UP)
    elif isinstance(shape, coal.Capsule):
        add(cylinder(shape.radius, 2.0 * shape.halfLength, open_ended=True), Z_UP)
        for side in (-1.0, 1.0):
            add(sphere(shape.radius), transform(position=[0.0, 0.0, side * shape.halfLength]))
    elif isinstance(shape, coal.BVHModelBase):
        triangles = (shape.tri_indices(number) for number in range(shape.num_tris))
        faces = np.array([(triangle[0], triangle[1], triangle[2]) for triangle in triangles])
        add(facets(*simplify_mesh(shape.vertices(), faces, share)))
