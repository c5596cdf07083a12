"""Mass, centre of mass and inertia tensor of a body from a mesh file or a robot description; convex shapes."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, doubt, explained, hint, shown
from kreisel.files import place
from kreisel.physical.measures import finite_floats, in_range, inertia_tensor, si_number, si_numbers

SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".gltf")
LARGEST_MESH, LARGEST_DESCRIPTION = 1 << 30, 16 << 20  # bytes
LARGEST = 1e30  # coordinate
MOST_SHELLS = 64  # of which a face is checked: each costs a pass over all triangles
BELOW = 1e-6  # of the size of a triangle
POINTS = 2000  # of an ellipsoid of facets
DENT = 1e-3  # of the size of a shape: height of a vertex above a facet
ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
PRODUCTS = dict.fromkeys(("ixy", "ixz", "iyz"), "0")  # defaults of SDFormat; its 1 for a moment is read as a mistake
ROTATIONS = ("euler_rpy", "quat_xyzw")


class Part(NamedTuple):
    """Mass, kg, centre of mass (3,), m, and inertia tensor about it (3, 3), kg m^2, along the axes of the file.

    The names are arguments of the bodies: `SubmergedBody(**part._asdict())`, `Satellite(part.inertia, orbit)`,
    `HeavyBody.about_centre(part.mass, part.inertia, arm=part.center_of_mass)` with the pivot at the file's origin.
    """

    mass: float
    center_of_mass: Array
    inertia: Array


@explained
def read_mesh(mesh: str | os.PathLike[str], length: Any = None, density: Any = None, mass: Any = None) -> Part:
    """The homogeneous body whose closed surface is in a mesh file: STL, OBJ, PLY or glTF (extra `mesh`: trimesh).

    length          the unit of the coordinates: "mm", or its size in m; files do not state it
    density, mass   kg/m^3 or kg: one of them

    Cavities are surfaces within, their normals towards the cavity.  Raises `InputError` for a surface with holes or
    with normals that point inwards, and for bodies within one another; overlaps of parts of them may not be noticed.
    """
    return solid(mesh, length, density, mass)[0]


def solid(mesh: Any, length: Any, density: Any, mass: Any) -> tuple[Part, Array]:
    """The body of `read_mesh`, and the triangles (k, 3, 3) of its surface, m."""
    file = _file(mesh, "mesh", LARGEST_MESH)
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"mesh: expected a file that ends in {', '.join(SUFFIXES)}, got {shown(file.name)}.")
    if length is None:
        raise InputError(
            f"length: expected the unit of the coordinates in {file.name}, such as length='mm' (--length), got none. "
            "Mesh files do not state it; most CAD programs write mm."
        )
    unit = si_number(length, "m", "length", positive=True)
    if (density is None) == (mass is None):
        raise InputError(
            f"expected density=..., such as '2700 kg/m^3' for aluminium, or mass=... (--density, --mass), got "
            f"{'neither' if mass is None else 'both'}."
        )
    surface = _surface(file)
    middle = surface.bounds.mean(0)
    surface.apply_translation(-middle)  # integrals far from the origin lose digits
    with np.errstate(all="ignore"):
        _require_closed(surface, file.name)
        sizes = surface.mass_properties
    volume = in_range("The volume", lambda: sizes.volume * unit**3)
    total = (
        in_range("The mass", lambda: volume * si_number(density, "kg/m^3", "density", positive=True))
        if (mass is None)
        else si_number(mass, "kg", "mass", positive=True)
    )
    inertia = in_range("The inertia tensor", lambda: sizes.inertia * (total / sizes.mass * unit**2))
    result = Part(float(total), (sizes.center_mass + middle) * unit, inertia_tensor(inertia / 2 + inertia.T / 2 + 0.0))
    return result, np.asarray(surface.triangles + middle) * unit


def _surface(file: Path) -> Any:
    """The triangles of a file, equal points merged.  Raises `InputError`."""
    try:
        import trimesh
    except ImportError:
        raise InputError(
            "Reading a mesh needs trimesh, which is not installed: pip install 'kreisel[mesh]'. Or give the inertia "
            "tensor and the mass that your CAD program shows."
        ) from None
    log = logging.getLogger("trimesh")  # it would print tracebacks of damaged files
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"):
            surface = trimesh.load_scene(file).to_mesh()
            triangles, points = len(surface.faces), np.asarray(surface.vertices)
            sound = triangles > 0 and points.shape[1:] == (3,) and (abs(points) < LARGEST).all()
            sound = sound and np.ptp(surface.bounds, axis=0).all()
    except Exception as error:  # any exception of the readers for a damaged file
        raise InputError(f"{file}: expected a complete {file.suffix[1:].upper()} file, got {error!r}.") from error
    finally:
        log.setLevel(level)
    if not sound:
        raise InputError(
            f"{file}: expected a surface of triangles around a volume, got {triangles:,} triangles. Usual cause: "
            "a damaged file, or one of points only."
        )
    return surface


def _require_closed(surface: Any, name: str) -> None:
    """Raises `InputError` unless the surface is the boundary of a volume, seen from outside."""
    fix = "In Blender: Mesh > Normals > Recalculate Outside; in MeshLab: Re-Orient All Faces Coherently."
    if not surface.is_watertight:
        edges = np.sort(surface.edges, axis=1)
        open_edges = int((np.unique(edges, axis=0, return_counts=True)[1] != 2).sum())
        raise InputError(
            f"{name}: expected a closed surface, each edge between two triangles, got {open_edges:,} other edges. "
            "Close its holes and join double faces, in Blender by Mesh > Clean Up > Fill Holes and Merge by Distance, "
            "or export it again from CAD as one solid."
        )
    if not surface.is_winding_consistent:
        raise InputError(f"{name}: expected normals that all point outwards, got triangles that disagree. {fix}")
    if not surface.volume > 0:
        raise InputError(f"{name}: expected normals that point outwards, got them inwards: it is inside out. {fix}")
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs, count = surface.face_adjacency, len(surface.faces)
    shells = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)[1]
    largest = np.lexsort((-surface.area_faces, shells))
    faces = largest[np.unique(shells[largest], return_index=True)[1]][:MOST_SHELLS]
    for face in faces if len(faces) > 1 else ():
        below = surface.triangles_center[face] - BELOW * np.sqrt(surface.area_faces[face]) * surface.face_normals[face]
        layers = round(_winding_number(surface.triangles - below))
        if layers != 1:
            fault = "bodies within one another" if layers > 1 else "one of its surfaces inside out"
            raise InputError(
                f"{name}: expected separate bodies, and normals that point out of the material, got {fault}. Join the "
                f"bodies by a Boolean union. {fix}"
            )


def _winding_number(triangles: Array) -> float:
    """The times that triangles (k, 3, 3) enclose the origin: the sum of their solid angles over 4 pi.

    [van Oosterom, Strackee, IEEE Transactions on Biomedical Engineering 30 (1983) 125]
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    x, y, z = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    dots = [(u * v).sum(-1) for u, v in ((a, b), (b, c), (c, a))]
    angles = 2 * np.arctan2((np.cross(a, b) * c).sum(-1), x * y * z + dots[0] * z + dots[1] * x + dots[2] * y)
    return float(angles.sum() / (4 * np.pi))


@explained
def read_robot(robot: str | os.PathLike[str], link: str | None = None) -> Part:
    """The mass, centre of mass and inertia tensor of a link, along the axes of the link, from a URDF or SDF file.

    link   its name, in SDF also "model::link"; not needed if only one link has an inertia

    ixy, ixz, iyz are entries of the tensor, -sum m x y and so on.  Raises `InputError` for other files, and if the
    link is missing or states no inertia.  [ROS, URDF link; Open Robotics, SDFormat 1.12, inertial]
    """
    file = _file(robot, "robot", LARGEST_DESCRIPTION)
    raw = file.read_bytes()
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise InputError(
            f"{file.name}: expected a URDF or SDF file, got a document type or entities, which neither has."
        )
    try:
        root = ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{file.name}: expected a URDF or SDF file, got no XML: {error}.") from None
    if root.tag not in ("robot", "sdf"):
        raise InputError(f"{file.name}: expected <robot> or <sdf> at the top, got <{shown(root.tag)[1:-1]}>.")
    links = dict(_links(root, ""))
    inertials = {name: element.find("inertial") for name, element in links.items()}
    chosen = [k for k in links if k == link or k.endswith(f"::{link}")]
    if link is None:
        chosen = [k for k, inertial in inertials.items() if inertial is not None]
    if len(chosen) != 1:
        raise InputError(
            f"link: expected one of {', '.join(links) or 'none'} of {file.name}, got {shown(link)}.{hint(link, links)}"
        )
    inertial = inertials[chosen[0]]
    if inertial is None or inertial.get("auto") == "true":
        got = "none" if inertial is None else 'auto="true"; read its mesh by read_mesh'
        raise InputError(f"{file.name}: expected <inertial> in the link {chosen[0]}, got {got}.")
    return _of_inertial(inertial, f"{file.name}, link {chosen[0]}", root.tag == "sdf")


def _links(element: ElementTree.Element, prefix: str) -> list[tuple[str, ElementTree.Element]]:
    """The links of a robot, a model or a world, by name; in nested models "model::link"."""
    result = [(prefix + link.get("name", ""), link) for link in element.findall("link")]
    for group in ("world", "model"):
        for model in element.findall(group):
            inner = prefix if group == "world" or element.tag == "sdf" else ""
            result += _links(model, f"{inner}{model.get('name', '')}::" if group == "model" else prefix)
    return result


def _of_inertial(inertial: ElementTree.Element, name: str, sdf: bool) -> Part:
    """The mass properties of an element <inertial>.  Raises `InputError`."""
    if sdf:
        texts = {key: inertial.findtext(f"inertia/{key}", PRODUCTS.get(key)) for key in ENTRIES}
        values = {key: _numbers(text, 1, f"{name}, {key}")[0] for key, text in texts.items()}
        mass = _numbers(inertial.findtext("mass"), 1, f"{name}, mass")
        centre, R = _pose(inertial.find("pose"), name)
    else:
        tensor, weight, origin = (inertial.find(tag) for tag in ("inertia", "mass", "origin"))
        values = {key: _numbers(None if tensor is None else tensor.get(key), 1, f"{name}, {key}")[0] for key in ENTRIES}
        mass = _numbers(None if weight is None else weight.get("value"), 1, f"{name}, mass")
        centre, rpy = (
            _numbers("0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, f"{name}, {key}")
            for key in ("xyz", "rpy")
        )
        R = _rotation(rpy)
    xx, xy, xz, yy, yz, zz = values.values()
    inertia = inertia_tensor([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], name)
    turned = R @ inertia @ R.T
    return Part(
        si_number(mass[0], "kg", f"{name}, mass", positive=True),
        centre,
        inertia_tensor(turned / 2 + turned.T / 2, name),
    )


def _pose(pose: ElementTree.Element | None, name: str) -> tuple[Array, Array]:
    """Position and rotation of an element <pose> of SDF.  Raises `InputError`."""
    if pose is None:
        return np.zeros(3), np.eye(3)
    form, frame = pose.get("rotation_format", "euler_rpy"), pose.get("relative_to")
    if form not in ROTATIONS or frame:
        raise InputError(
            f"{name}, pose: expected a rotation_format of {', '.join(ROTATIONS)} and no relative_to, got "
            f"{shown(form)}, {shown(frame)}."
        )
    x = _numbers(pose.text, 6 + (form == "quat_xyzw"), f"{name}, pose")
    if form == "quat_xyzw":
        from scipy.spatial.transform import Rotation

        if abs(np.linalg.norm(x[3:]) - 1) > 1e-6:
            raise InputError(f"{name}, pose: expected a unit quaternion, got {x[3:].tolist()}.")
        return x[:3], Rotation.from_quat(x[3:]).as_matrix()
    return x[:3], _rotation(np.radians(x[3:]) if pose.get("degrees") == "true" else x[3:])


def _rotation(rpy: Array) -> Array:
    """R = R_z(yaw) R_y(pitch) R_x(roll): about the fixed axes, roll first."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def _numbers(text: str | None, count: int, name: str) -> Array:
    """Finite floats, `count` of them, from text.  Raises `InputError`."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.array([])
    if values.shape != (count,) or not np.isfinite(values).all():
        macro = (
            " Usual cause: a file of xacro; expand it: xacro robot.xacro > robot.urdf." if "$" in (text or "") else ""
        )
        raise InputError(f"{name}: expected {count} number{'s' * (count > 1)}, got {shown(text)}.{macro}")
    return values


def _file(path: Any, name: str, most: int) -> Path:
    """A file that exists and is not too large.  Raises `InputError`."""
    file = place(path, f"{name}: expected the name of a file")
    try:
        size = file.stat().st_size
        with file.open("rb"):
            pass
    except OSError as error:
        raise InputError(f"{name}: {file} cannot be read: {error.strerror or error}.") from None
    if size > most:
        raise InputError(f"{name}: expected a file of at most {most >> 20:,} MiB, got {size >> 20:,} MiB.")
    return file


# -- convex shapes ---------------------------------------------------------------------------------


@explained
class Facets:
    """Convex shape of triangles, for its brightness: `kr.analysis.light_curve`.

    vertices    (k, 3), m or any other unit, along the axes of the body
    faces       (m, 3), the indices of the vertices of each triangle, from 0, anticlockwise seen from outside

    Attributes: also the outward normals (m, 3) and the areas (m,).  Raises `InputError` for a surface that is not
    closed or is inside out; warns if it is not convex: shadows are not computed.
    """

    def __init__(self, vertices: Any, faces: Any) -> None:
        v, f = finite_floats(vertices, "1", "vertices"), np.asarray(faces)
        if v.ndim != 2 or v.shape[1] != 3 or f.ndim != 2 or f.shape[1] != 3 or f.dtype.kind not in "iu":
            raise InputError(
                f"expected vertices (k, 3) and integers faces (m, 3), got the shapes {v.shape} and {f.shape}."
            )
        if f.min(initial=0) < 0 or f.max(initial=0) >= len(v):
            raise InputError(f"faces: expected indices from 0 to {len(v) - 1}, got {f.min()} to {f.max()}.")
        edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]]) @ (len(v), 1)
        back = np.concatenate([f[:, [1, 0]], f[:, [2, 1]], f[:, [0, 2]]]) @ (len(v), 1)
        if len(f) < 4 or len(np.unique(edges)) < len(edges) or set(edges) != set(back):
            raise InputError(
                "faces: expected a closed surface, each edge between two triangles of the same sense, got another. "
                "Usual cause: a facet that is missing, or that is clockwise seen from outside."
            )
        corners = v[f]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
        if not (across * corners[:, 0]).sum() > 0:
            raise InputError("faces: expected triangles anticlockwise seen from outside, got them clockwise.")
        self.vertices, self.faces, self.areas = v, f, np.linalg.norm(across, axis=-1)
        self.normals = across / np.where(self.areas > 0, self.areas, 1)[:, None]
        offsets = (self.normals * corners[:, 0]).sum(-1)
        dent = max(float((v @ n - d).max()) for n, d in zip(self.normals, offsets, strict=True))
        if dent > DENT * np.ptp(v):
            doubt(
                f"Facets: expected a convex shape, got vertices up to {dent / np.ptp(v):.2g} of its size above facets. "
                "Shadows are not computed. Facets.hull(vertices) is convex."
            )

    @classmethod
    def hull(cls, points: Any) -> Facets:
        """The convex hull of points (k, 3).  Raises `InputError`."""
        from scipy.spatial import ConvexHull, QhullError

        x = si_numbers(points, "1", "points")
        try:
            hull = ConvexHull(x)
        except (QhullError, ValueError, IndexError) as error:
            raise InputError(f"points: expected points (k, 3) around a volume, got {shown(points)}.") from error
        f = hull.simplices.copy()
        a, b, c = np.moveaxis(x[f], 1, 0)
        inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(-1) < 0
        f[inward] = f[inward][:, ::-1]
        used, places = np.unique(f, return_inverse=True)
        return cls(x[used], places.reshape(f.shape))

    @classmethod
    def ellipsoid(cls, semi_axes: Any, points: int = POINTS) -> Facets:
        """An inscribed polyhedron of an ellipsoid with that number of vertices.  Raises `InputError`."""
        k = np.arange(int(si_number(points, "1", "points", positive=True))) + 0.5
        z, turn = 1 - 2 * k / len(k), np.pi * (1 + 5**0.5) * k
        sphere = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], -1)
        return cls.hull(sphere * si_numbers(semi_axes, "m", "semi_axes", ((3,),)))

    @classmethod
    def from_damit(cls, path: str | os.PathLike[str]) -> Facets:
        """The shape in a file shape.txt of DAMIT, in its unit of length.

        The file has the counts of vertices and facets, the vertices x y z, and for each facet the indices of its
        vertices, from 1.  Raises `InputError`.  [Durech, Sidorin, Kaasalainen, A&A 513 (2010) A46]
        """
        file = _file(path, "path", LARGEST_MESH)
        words = file.read_bytes().split()
        try:
            count, facets = int(words[0]), int(words[1])
            values = np.array(words[2:], dtype=np.float64)
        except (ValueError, IndexError):
            count = facets = -1
            values = np.empty(0)
        if min(count, facets) < 0 or len(values) != 3 * (count + facets):
            raise InputError(
                f"{file.name}: expected two counts, then as many vertices and triangles of three values each, got "
                f"{len(words)} words. Usual cause: a file with facets of more corners; split them into triangles."
            )
        faces = values[3 * count :].reshape(-1, 3)
        if (faces != np.rint(faces)).any():
            raise InputError(f"{file.name}: expected integers in the lines of facets, got others.")
        return cls(values[: 3 * count].reshape(-1, 3), faces.astype(np.int64) - 1)

    def __repr__(self) -> str:
        return f"<kreisel facets: {len(self.faces):,} triangles, {len(self.vertices):,} vertices>"
