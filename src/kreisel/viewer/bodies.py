"""Shapes to draw, of triangles in the colours of a palette, so that a rotation is visible; shapes from files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kreisel.algebra import Array, axial, hat
from kreisel.errors import InputError
from kreisel.files import place
from kreisel.record.model import Model

SECTORS, AROUND = 6, 60
FIRST, SECOND, METAL, PANEL, DARK, MARK = range(6)  # the palette; the page has its colours
SIDES = FIRST, SECOND, METAL  # of a box, across each axis
# profiles: radii, and heights along the axis
TOP = (  # peg, disc, handle
    (0.0, 0.03, 0.05, 0.10, 0.34, 0.49, 0.535, 0.55, 0.535, 0.48, 0.30, 0.10, 0.06, 0.045, 0.045, 0.03, 0.0),
    (0.0, 0.02, 0.14, 0.26, 0.40, 0.475, 0.51, 0.55, 0.59, 0.62, 0.655, 0.70, 0.74, 0.80, 0.95, 0.985, 1.0),
)
TOP_METAL = (0.27, 0.69)  # outside of these heights
WHEEL = (  # a rim, with points in its middle: `_sector`
    (0.42, 0.58, 0.61, 0.61, 0.61, 0.58, 0.42, 0.42, 0.42),
    (0.47, 0.45, 0.47, 0.55, 0.63, 0.65, 0.63, 0.55, 0.47),
)
HUB = ((0.0, 0.10, 0.12, 0.12, 0.10, 0.0), (0.45, 0.45, 0.47, 0.63, 0.65, 0.65))
AXLE = ((0.0, 0.03, 0.03, 0.02, 0.0), (0.0, 0.04, 0.97, 0.99, 1.0))
DISH = ((0.0, 0.18, 0.30, 0.28, 0.17, 0.0), (0.0, 0.03, 0.12, 0.13, 0.06, 0.03))
CYLINDER = ((0.0, 1.0, 1.0, 1.0, 0.0), (-1.0, -1.0, 0.0, 1.0, 1.0))
SPOKES = 6
THINNEST = 0.12  # semi-axis to the longest
ALIKE = 1e-3  # relative difference of semi-axes below which a body is round


@dataclass(frozen=True)
class Body:
    """Triangles about 0: points (k, 3), faces (f, 3) as indices of points, each with a place in the palette."""

    points: Array
    faces: Array
    colour: Array

    def scaled(self, size: float) -> Body:
        """The body scaled to that distance of its farthest point from 0."""
        far = float(np.linalg.norm(self.points, axis=-1).max(initial=0.0)) or 1.0
        return replace(self, points=self.points * (size / far))

    def moved(self, *by: float) -> Body:
        """The body elsewhere."""
        return replace(self, points=self.points + np.array(by))

    def plain(self) -> Body:
        """The body without the sectors that show a rotation."""
        return replace(self, colour=np.where(self.colour == SECOND, FIRST, self.colour))

    def octants(self) -> Body:
        """The body in two colours that alternate from octant to octant."""
        return replace(self, colour=np.where((self.points[self.faces].mean(1) > 0).sum(1) % 2, FIRST, SECOND))


def joined(*parts: Body) -> Body:
    """Several bodies as one."""
    offsets = np.cumsum([0, *(len(body.points) for body in parts[:-1])])
    faces = [body.faces + offset for body, offset in zip(parts, offsets, strict=True)]
    points, colours = [body.points for body in parts], [body.colour for body in parts]
    return Body(np.concatenate(points), np.concatenate(faces), np.concatenate(colours))


def gyration(model: Model, carried: Array) -> Array | None:
    """The tensor tr(I)/2 - I (3, 3) of the body's inertia I, from M -> Omega of the record; None without an inertia."""
    try:
        vectors = [carried] * (len(model.system.space.letters) - 1)
        columns = [axial(model.call(model.system.velocity, hat(e), *vectors)) for e in np.eye(3)]
        inertia = np.linalg.inv(np.stack(columns, -1))
    except (np.linalg.LinAlgError, ValueError, TypeError):
        return None
    inertia = (inertia + inertia.T) / 2
    return np.trace(inertia) / 2 * np.eye(3) - inertia if np.isfinite(inertia).all() else None


def _semi_axes(tensor: Array | None, thinnest: float = THINNEST) -> tuple[Array, Array]:
    """Semi-axes, the longest 1, and their directions as columns of a rotation."""
    squares, axes = np.linalg.eigh(np.eye(3) if tensor is None else tensor)
    size = np.sqrt(np.maximum(squares, 0))
    size = np.maximum(size / (size.max() or 1.0), thinnest)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return size, axes


def marked_axis(tensor: Array | None, half: Array | None = None) -> tuple[Array, str]:
    """The axis to draw and its name: the axis of symmetry of a flat body, else the longest.

    tensor   gyration tensor (3, 3);  half   half lengths along the axes of the body instead, if its shape is known
    """
    size, axes = _semi_axes(tensor) if half is None else (half, np.eye(3))
    low, middle, high = np.argsort(size, kind="stable")
    flat = size[high] - size[middle] < ALIKE * size[high] < size[high] - size[low]
    return axes[:, low if flat else high], "axis of symmetry" if flat else "long axis"


def ellipsoid(axis: Array, tensor: Array | None, radius: float) -> Body:
    """The ellipsoid with that gyration tensor."""
    size, axes = _semi_axes(tensor)
    angle = np.linspace(0, np.pi, 33)
    ball = _revolved((np.sin(angle), -np.cos(angle))).octants()
    return replace(ball, points=radius * (ball.points * size) @ axes.T)


def _along(axis: Array, tensor: Array | None, length: float) -> Callable[[Body], Body]:
    """A body about the third axis, rotated to another axis and stretched across it by the inertia."""
    third = axis / np.linalg.norm(axis)
    first = np.eye(3)[int(np.abs(third).argmin())]
    first = first - third * (first @ third)
    first /= np.linalg.norm(first)
    across = np.stack([first, np.cross(third, first)], -1)
    if tensor is not None:
        size, turn = np.linalg.eigh(across.T @ tensor @ across)
        size = np.sqrt(np.maximum(size, 0))
        across = across @ turn @ np.diag(np.maximum(size / (size.max() or 1.0), THINNEST)) @ turn.T

    def put(body: Body) -> Body:
        return replace(body, points=length * (body.points[:, :2] @ across.T + body.points[:, 2:] * third))

    return put


def top(axis: Array, tensor: Array | None, length: float) -> Body:
    """A top about the point 0 along `axis`, its disc stretched by the inertia across the axis."""
    shape, (low, high) = _revolved(TOP), TOP_METAL
    height = shape.points[shape.faces][:, :, 2].mean(1)
    colour = np.where((height < low) | (height > high), METAL, np.where(_sector(shape), FIRST, SECOND))
    return _along(axis, tensor, length)(replace(shape, colour=colour))


def gyroscope(axis: Array, tensor: Array | None, length: float) -> Body:
    """A wheel with spokes on an axle from the point 0 along `axis`."""
    rim = _revolved(WHEEL)
    parts = [replace(rim, colour=np.where(_sector(rim), FIRST, SECOND)), _revolved(HUB, METAL), _revolved(AXLE, METAL)]
    for angle in np.arange(SPOKES) * 2 * np.pi / SPOKES:
        c, s = np.cos(angle), np.sin(angle)
        spoke = _box((0.17, 0.022, 0.022), METAL).moved(0.27, 0, 0.55)
        parts.append(replace(spoke, points=spoke.points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])))
    return _along(axis, tensor, length)(joined(*parts))


def box(axis: Array, tensor: Array | None, radius: float) -> Body:
    """The box with that gyration tensor: its half edges go like the semi-axes of the ellipsoid."""
    size, axes = _semi_axes(tensor)
    shape = _box(size, *SIDES)
    return replace(shape, points=shape.points @ axes.T).scaled(radius)


def satellite(axis: Array, tensor: Array | None, radius: float) -> Body:
    """The box with that gyration tensor, with two panels along its middle axis and a dish at the end of the longest.

    Of the two ends, the one towards `axis`.
    """
    size, axes = _semi_axes(tensor, 0.25)
    axes = axes * np.array([-1, 1, -1]) if axes[:, 2] @ axis < 0 else axes
    parts = [_box(size, METAL, METAL, MARK)]
    for side in (-1, 1):
        for number in range(3):  # cells of a panel
            cell = _box((0.03, 0.29, 0.5 * size[2]), PANEL)
            parts.append(cell.moved(0, side * (size[1] + 0.42 + 0.62 * number), 0))
        parts.append(_box((0.02, 0.09, 0.02), DARK).moved(0, side * (size[1] + 0.07), 0))
    shape = joined(*parts, _revolved(DISH, FIRST).moved(0, 0, size[2]))
    return replace(shape, points=shape.points @ axes.T).scaled(radius)


def of_shape(kind: str, half: Array) -> Body | None:
    """A body of known shape, with these half lengths along its axes; None for an unknown kind."""
    if kind == "box":
        return _box(half, *SIDES)
    if kind == "ellipsoid":
        ball = ellipsoid(np.eye(3)[2], None, 1.0)
        return replace(ball, points=ball.points * half)
    if kind == "cylinder":
        round_ = _revolved(CYLINDER)
        return Body(round_.points[:, [2, 0, 1]] * half, round_.faces, np.where(_sector(round_), FIRST, SECOND))
    return None


SHAPES = {"top": top, "gyroscope": gyroscope, "ellipsoid": ellipsoid, "box": box, "satellite": satellite}


def _sector(shape: Body) -> Array:
    """Whether a face lies in an odd sector about the third axis, the other way round on its upper half.

    No face may lie across the middle, or the two triangles of a rectangle would have different colours.
    """
    middle = shape.points[shape.faces].mean(1)
    angle = np.arctan2(middle[:, 1], middle[:, 0]) / (2 * np.pi) % 1.0
    middle_height = np.ptp(shape.points[:, 2]) / 2 + shape.points[:, 2].min()
    return (np.floor(angle * SECTORS) + (middle[:, 2] > middle_height)) % 2 > 0


def _revolved(profile: object, colour: int = FIRST) -> Body:
    """A surface of revolution about the third axis, in one colour."""
    rings = np.asarray(profile, dtype=np.float64)
    angle = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    r, z = rings[0, :, None], np.repeat(rings[1, :, None], AROUND, 1)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], -1).reshape(-1, 3)
    i = np.arange(AROUND)
    j, base = (i + 1) % AROUND, AROUND * np.arange(rings.shape[1] - 1)[:, None]
    a, b, c, d = base + i, base + j, base + AROUND + i, base + AROUND + j
    faces = np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
    faces = faces[area > 1e-12]
    return Body(points, faces, np.full(len(faces), colour))


def _box(half: object, *colours: int) -> Body:
    """A box about 0 of those half edges; a colour for all faces, or for those across each axis."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=np.float64)
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    return Body(signs * np.asarray(half), faces, np.repeat(colours, len(faces) // len(colours)))


# -- files: STL, binary or as text, and OBJ; read as values, checked, never as code ---------------


MOST_FACES = 200_000
LARGEST = 1e9
SUFFIXES = (".stl", ".obj")
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])  # a facet of binary STL


def read_mesh(path: str | os.PathLike[str]) -> Body:
    """The triangles of a file.  Raises `InputError` for another format, a damaged file or too many triangles."""
    file = place(path, "mesh: expected the name of a file")
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"mesh: expected a file that ends in {' or '.join(SUFFIXES)}, got {file.name!r}. Programs that draw "
            "bodies, such as Blender, export glTF, PLY and others as STL."
        )
    try:
        if file.stat().st_size > 400 * MOST_FACES:
            raise InputError(f"mesh: {file.name} is too large; expected at most {MOST_FACES:,} triangles.")
        raw = file.read_bytes()
    except OSError as error:
        raise InputError(f"mesh: {file} cannot be read: {error.strerror or error}.") from error
    try:
        points, faces = _obj(raw) if file.suffix.lower() == ".obj" else _stl(raw)
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise InputError(f"mesh: {file.name} is not a complete {file.suffix[1:].upper()} file: {error}.") from error
    if not 1 <= len(faces) <= MOST_FACES:
        raise InputError(f"mesh: expected 1 to {MOST_FACES:,} triangles in {file.name}, got {len(faces):,}.")
    if not (np.isfinite(points).all() and (abs(points) < LARGEST).all() and abs(points).max() > 0):
        raise InputError(f"mesh: expected finite points below {LARGEST:g}, not all 0, in {file.name}.")
    return Body(points, faces, np.zeros(len(faces), dtype=int)).octants()


def _stl(raw: bytes) -> tuple[Array, Array]:
    count = int(np.frombuffer(raw[80:84], "<u4")[0]) if len(raw) >= 84 else -1
    if len(raw) == 84 + RECORD.itemsize * count:
        corners = np.frombuffer(raw, RECORD, count, 84)["corners"].astype(np.float64)
    elif raw.lstrip()[:5].lower() == b"solid":
        lines = [line.split() for line in raw.decode("ascii", "strict").splitlines()]
        numbers = [line[1:] for line in lines if line[:1] == ["vertex"]]
        if len(numbers) % 3 or any(len(line) != 3 for line in numbers):
            raise ValueError("a facet is not of three points")
        corners = np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)
    else:
        raise ValueError("its length does not fit its facets")
    points, places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return points, places.reshape(-1, 3)


def _obj(raw: bytes) -> tuple[Array, Array]:
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in raw.decode("utf-8").splitlines():
        word, *entries = line.split("#")[0].split() or [""]
        if word == "v":
            x, y, z, *_ = map(float, entries)
            points.append([x, y, z])
        elif word == "f":
            corners = []
            for number in (int(corner.split("/")[0]) for corner in entries):  # from 1 on, or negative, from the end
                if not 0 < abs(number) <= len(points):
                    raise ValueError(f"a face names the point {number} of {len(points)}")
                corners.append(number - 1 if number > 0 else len(points) + number)
            if len(corners) < 3:
                raise ValueError("a face has fewer than three corners")
            faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    return np.array(points, dtype=np.float64).reshape(-1, 3), np.array(faces, dtype=int).reshape(-1, 3)
